"""What a model leaves over: the variables that the rest depends on, and its slow wander."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stopset.offline.campaign.hold_out import FOLDS
from stopset.offline.diagnose.evidence.engine import Engine
from stopset.offline.diagnose.evidence.hypothesis import Hyper, Hypothesis
from stopset.offline.diagnose.search.held_out import by_time, few_motions
from stopset.types import Array, Index

BINS, FEW_BINS = 24, 4
BLOCK = 25  # rows of half a second of motion: short against a wander of friction, long against what sensors and lags leave


@dataclass(frozen=True, slots=True)
class Dependence:
    """How much of a joint's leftover variance a function of one variable explains, from held-out motions."""

    joint: int
    variable: str
    share: float
    gain: float = 0.0  # as 2 log likelihood over the joint's rows


def whitened(now: Hypothesis, theta: Array, hyper: Hyper, joint: int) -> tuple[Array, Index]:
    """(K,) whitened residual of a joint's moving rows, friction scales of the trials taken out, and the rows' folds."""
    gram, k = now.view().engine.grams[joint], len(now.engine.rows[joint].take)
    full = np.concatenate([[1.0], -theta])
    return gram.residual(full[gram.index], hyper.sigma[joint], hyper.kappa[joint])[:k], gram.row_fold[:k]


def dependences(now: Hypothesis, theta: Array, hyper: Hyper, joint: int) -> list[Dependence]:
    """Variables ranked by the share of the joint's leftover that a step function of them predicts on held-out motions."""
    engine, d = now.engine, now.engine.data
    take = engine.rows[joint].take
    r, fold = whitened(now, theta, hyper, joint)
    direction, bins = d.direction[take, joint], BINS
    if few_motions(engine):  # blocks of time are held out, and steps of time must be longer than they are
        fold, bins = by_time(engine, joint)[: len(take)], FEW_BINS
    found = []
    for name, x in _variables(engine, joint, take):
        for suffix, weight in (("", np.ones(len(take))), (f" * direction of dq_{d.joints[joint]}", direction)):
            share = predicted(r, x, weight, fold, bins)
            found.append(Dependence(joint, name + suffix, share, share * len(take)))
    return sorted(found, key=lambda f: -f.share)


def slow_excess(now: Hypothesis, theta: Array, hyper: Hyper, joint: int) -> float:
    """Variance of the whitened residual's half-second sums, 1 for noise: what wanders slowly shows here long before in single rows."""
    rows = now.engine.rows[joint]
    r, _ = whitened(now, theta, hyper, joint)
    sums = [0.0]
    trial = now.engine.data.trial[rows.take]
    for part in np.split(r, np.flatnonzero(np.diff(trial)) + 1):
        whole = len(part) // BLOCK * BLOCK
        sums.extend(part[:whole].reshape(-1, BLOCK).sum(axis=1))
    return float(np.sum(np.square(sums))) / (BLOCK * max(1, len(sums) - 1))


def _variables(engine: Engine, joint: int, take: Index) -> list[tuple[str, Array]]:
    d = engine.data
    out = [(f"q_{name}", d.q[take, k]) for k, name in enumerate(d.joints)]
    out += [(f"dq_{name}", d.dq[take, k]) for k, name in enumerate(d.joints)]
    out.append((f"load of {d.joints[joint]}", engine.source.gravity[take, joint]))
    out.append(("time in the trial", d.t[take]))
    out.append(("place in the session", d.warm[take]))
    if d.temp is not None:
        out.append((f"temp_{d.joints[joint]}", d.temp[take, joint]))
    return out


def predicted(r: Array, x: Array, weight: Array, fold: Index, bins: int = BINS) -> float:
    """Share of the variance of ``r`` that bin means over ``x`` (times ``weight``) predict on folds they have not seen."""
    edges = np.unique(np.quantile(x, np.linspace(0, 1, bins + 1)[1:-1]))
    b = np.searchsorted(edges, x)
    m = len(edges) + 1
    num = np.stack([np.bincount(b[fold == k], (r * weight)[fold == k], m) for k in range(FOLDS)])
    den = np.stack([np.bincount(b[fold == k], (weight**2)[fold == k], m) for k in range(FOLDS)])
    gained = 0.0
    for k in range(FOLDS):
        mean = (num.sum(axis=0) - num[k]) / (den.sum(axis=0) - den[k] + 1.0)
        here = fold == k
        gained += float(np.sum(r[here] ** 2 - (r[here] - mean[b[here]] * weight[here]) ** 2))
    return gained / max(float(np.sum(r**2)), 1e-300)
