"""Laws with a place and levers of their own, as a gas spring's: sought all over their ranges, and told from all that pulls alike."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stopset.effects.base import Shape
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.evidence.candidate import Candidate, Scored
from stopset.offline.diagnose.evidence.hypothesis import Hyper, Hypothesis
from stopset.offline.diagnose.evidence.scores import score_new
from stopset.offline.diagnose.search.settled import Settled, refines, refitted
from stopset.types import Array

ALONG = 8  # values of a lever
CLIMB = 80  # columns tried on the path to one top
SEARCHES = 3  # of levers at the noise that is left, which then falls: they settle in two
FALLS = 2.0  # times, by which noise that falls tells other levers: by 689 and more where they were wrong, by 1.2 where nothing was gained


def geared(settled: list[Settled], now: Hypothesis, hyper: Hyper) -> list[Settled]:
    """The contenders, those with levers of their own at the noise that the likeliest leaves, which falls as they come to explain more.

    ``hyper``: at which they were sought; where the likeliest leaves almost as much, other levers would be no better.
    """

    def sought(x: Settled, least: Hyper) -> Settled:
        c = x.candidate
        falls = _geometric(c) and any(hyper.kappa[j] > FALLS * least.kappa[j] for j in c.joints)
        return _sought_again(now, x, least) if falls else x

    for _ in range(SEARCHES):
        likeliest = max(settled, key=lambda x: x.evidence)
        again = [sought(x, likeliest.hyper) for x in settled]
        if max(x.evidence - y.evidence for x, y in zip(again, settled, strict=True)) < 1.0:
            break
        settled = again
    return settled


def _sought_again(now: Hypothesis, x: Settled, hyper: Hyper) -> Settled:
    """A contender with levers of its own, which are sought again all over their ranges at the noise of ``hyper``.

    Where a large effect is not known yet all that is unexplained counts as noise, beside which one shape is as good as another.  Each top
    along the place is climbed: levers that stretch the other way have one of their own.
    """
    c = x.candidate
    first, *rest = c.effect.shapes
    along = []
    for place in first.grid:
        tried = (
            {first.symbol: place} | dict(zip([p.symbol for p in rest], v, strict=True))
            for v in itertools.product(*map(_starts, rest))
        )
        scored = [score_new(now, c.effect, c.joints, shapes, hyper, quick=True) for shapes in tried]
        along.append(max((s for s in scored if s is not None and s.admissible), key=lambda s: s.score, default=None))
    heights = np.array([-np.inf, *(-np.inf if s is None else s.score for s in along), -np.inf])
    tops = [s for k, s in enumerate(along, 1) if s is not None and heights[k] >= max(heights[k - 1], heights[k + 1])]
    again = [refitted(now, replace(_summit(now, s, hyper), score=x.scored.score), hyper) for s in tops]
    return max((x, *(s for s in again if s.inside)), key=lambda s: s.evidence)  # a top at an end was not found


def _summit(now: Hypothesis, start: Scored, hyper: Hyper) -> Scored:
    """The shapes of most evidence near ``start``'s, whose ridge may run askew to each of them."""
    from scipy.optimize import minimize  # half a second, for what few recordings need

    c, best = start.candidate, start

    def lost(values: Array) -> float:
        nonlocal best
        shapes = dict(zip(symbols, values.tolist(), strict=True))
        s = score_new(now, c.effect, c.joints, shapes, hyper, quick=True)
        if s is None or not s.admissible:
            return np.inf
        best = max(best, s, key=lambda x: x.score)
        return -s.score

    symbols = [p.symbol for p in c.effect.shapes]
    at = np.array([c.shapes[k] for k in symbols])
    steps = np.diag([0.1 * (p.hi - p.lo) / (len(p.grid) if len(p.grid) > 1 else 1) for p in c.effect.shapes])
    minimize(
        lost, at, method="Nelder-Mead", bounds=[(p.lo, p.hi) for p in c.effect.shapes],
        options={"initial_simplex": np.vstack([at, at + 3 * steps]), "maxfev": CLIMB, "xatol": 1e-3, "fatol": 0.1},
    )  # fmt: skip
    return best


def _starts(p: Shape) -> Sequence[float]:
    """Where a shape is sought from: its grid; all over the range of one that has a single value."""
    return p.grid if len(p.grid) > 1 else np.linspace(p.lo, p.hi, ALONG).tolist()


def distinct(finer: Settled, settled: Sequence[Settled]) -> bool:
    """Whether a law with levers of its own is clearly likelier than all that it refines, whose forms pay for being off, and than their
    other forms; its levers pay for having been sought.

    A curve that bends as it likes takes up what any form leaves, and says only that a plainer law is not quite true; a place and levers
    say more.  A curve that pushes somewhere, or bends as its own law cannot, is none of a spring's forms.
    """
    c = finer.candidate
    if not (_geometric(c) and finer.possible and finer.inside):
        return False
    plainer = [x.evidence + x.taken_up for x in settled if refines(c, x.candidate) and x.possible]
    others = [x.evidence for x in settled if _other_form(c, x.candidate) and x.inside and x.pulls]
    return finer.evidence - limit.SWING_PRICE > max([*plainer, *others], default=-np.inf) + limit.THRESHOLD


def _other_form(a: Candidate, b: Candidate) -> bool:
    """Whether two laws refine the same plainer one, at the same joints."""
    return a.key != b.key and a.joints == b.joints and bool(set(a.effect.refines) & set(b.effect.refines))


def _geometric(c: Candidate) -> bool:
    """Whether a law has a place and levers of its own, and refines a plainer one."""
    return bool(c.effect.shapes and c.effect.refines)
