"""Which recorded variables an unexplained error depends on: one alone, or two whose product it follows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.evidence.hypothesis import Hyper, Hypothesis
from stopset.offline.diagnose.explain.residual import Dependence, predicted, whitened
from stopset.types import Array


@dataclass(frozen=True, slots=True)
class Pattern:
    """Variables that an error at a joint depends on, most telling first; ``share`` of its variance that they explain."""

    variables: tuple[str, ...]
    share: float
    together: bool  # the error follows the first variable's steps times the second variable


def pattern(now: Hypothesis, theta: Array, hyper: Hyper, joint: int, alone: Sequence[Dependence], least: float) -> Pattern | None:
    """What the leftover of ``joint`` depends on; None where no variable reaches a gain of ``least``.

    ``alone``: the single variables, best first.
    """
    best = alone[0] if alone else None
    pair = _best_product(now, theta, hyper, joint)
    if pair is not None and pair.gain > max(least, limit.TOGETHER * (best.gain if best else 0.0)):
        return Pattern(tuple(pair.variable.split(" * ")), pair.share, together=True)
    if best is None or best.gain <= least:
        return None
    strong = [d for d in alone if d.gain > least and d.share > limit.NAMED_BESIDE * best.share][: limit.VARIABLES]
    names = dict.fromkeys(part for d in strong for part in d.variable.split(" * "))
    return Pattern(tuple(names), best.share, together=False)


def _best_product(now: Hypothesis, theta: Array, hyper: Hyper, joint: int) -> Dependence | None:
    """The pair of variables, steps of the one times the other, that predicts most of the leftover on held-out motions."""
    rows, d = now.engine.rows[joint], now.engine.data
    take = rows.take
    r, fold = whitened(now, theta, hyper, joint)
    states = [(f"q_{name}", d.q[take, k]) for k, name in enumerate(d.joints)]
    states += [(f"dq_{name}", d.dq[take, k]) for k, name in enumerate(d.joints)]
    found = []
    for (a, x), (b, w) in product(states, states):
        if a != b and np.ptp(x) > 0 and np.ptp(w) > 0:
            share = predicted(r, x, w / float(np.sqrt(np.mean(w**2))), fold)
            found.append(Dependence(joint, f"{a} * {b}", share, share * len(take)))
    return max(found, key=lambda f: f.share, default=None)
