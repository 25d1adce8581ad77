"""Torque errors of a hypothesis on rows that its fit has not seen."""

from __future__ import annotations

import numpy as np

from stopset.offline.campaign.hold_out import BLOCK, FOLDS, GUARD
from stopset.offline.diagnose.evidence.engine import Engine
from stopset.offline.diagnose.evidence.evidence import JointGram, project
from stopset.offline.diagnose.evidence.hypothesis import Hyper, Hypothesis
from stopset.types import Array, Index, Mask

WHOLE = "motions left out in turn"
BLOCKS = f"every sixth {BLOCK:g} s in turn, {GUARD:g} s away from what was fitted: this speaks of the same motion only"


def judged_on(engine: Engine) -> str:
    """What held-out errors are taken on, in words."""
    return BLOCKS if few_motions(engine) else WHOLE


def few_motions(engine: Engine) -> bool:
    """Whether blocks of time are held out, for want of motions."""
    return len(np.unique(engine.fold_of_trial)) < FOLDS


def held_out(now: Hypothesis, hyper: Hyper) -> Array:
    """(n,) torque error [N m] of ``now``, RMS over motions that the fit has not seen.

    Where there are fewer motions than folds, blocks of time are held out in turn, with a guard interval at their ends: a motion
    left out alone would then leave nothing to fit.  Such errors speak of these motions only.
    """
    engine, view = now.engine, now.view()
    n = engine.data.n
    few = few_motions(engine)
    folds = [by_time(engine, j) if few else view.engine.grams[j].row_fold for j in range(n)]
    square, count = np.zeros(n), np.zeros(n)
    for fold in range(FOLDS):
        if few:
            G = np.zeros((view.engine.size, view.engine.size))
            for gram, row_fold, kappa in zip(view.engine.grams, folds, hyper.kappa, strict=True):
                G[np.ix_(gram.index, gram.index)] += _sums(gram, row_fold != fold, kappa)
        else:
            G, _ = view.total(hyper, np.arange(FOLDS) != fold)
        p = project(G, 0, view.nuisance, np.zeros(0, np.intp), view.precision(hyper), view.mean)
        theta = np.concatenate([[1.0], -p.theta])
        for j, rows in enumerate(engine.rows):
            gram, k = view.engine.grams[j], len(rows.take)
            e = rows.whiten.coloured((gram.X @ theta[gram.index])[:k])
            here = folds[j][:k] == fold
            if few:
                here &= ~_guarded(engine, j)
            square[j] += float(np.sum(e[here] ** 2))
            count[j] += int(here.sum())
    out: Array = np.sqrt(square / np.maximum(count, 1))
    return out


def by_time(engine: Engine, joint: int) -> Index:
    """(K + P,) fold of each row of a joint by the second it lies in; poses are never held out."""
    rows, d = engine.rows[joint], engine.data
    block = (d.t[rows.take] / BLOCK).astype(np.intp) + d.trial[rows.take]  # trials begin with different folds
    return np.concatenate([block % FOLDS, np.full(rows.size - len(rows.take), FOLDS, np.intp)])


def _guarded(engine: Engine, joint: int) -> Mask:
    """(K,) rows of a joint within the guard interval of a block's end."""
    part = np.mod(engine.data.t[engine.rows[joint].take], BLOCK)
    return np.asarray((part < GUARD) | (part > BLOCK - GUARD))


def _sums(gram: JointGram, chosen: Array, kappa: float) -> Array:
    """(c, c) Gram over some rows, friction taken as the same in all of them."""
    X = gram.X[chosen]
    out: Array = X.T @ X / kappa
    return out
