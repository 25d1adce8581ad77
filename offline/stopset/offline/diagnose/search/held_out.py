"""Torque errors of a hypothesis on rows that its fit has not seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stopset.offline.campaign.hold_out import BLOCK, FOLDS, GUARD
from stopset.offline.diagnose.evidence.engine import Engine
from stopset.offline.diagnose.evidence.evidence import JointGram, project
from stopset.offline.diagnose.evidence.hypothesis import Hyper, Hypothesis
from stopset.types import Array, Index, Mask

WHOLE = "motions left out in turn"
BLOCKS = f"every sixth {BLOCK:g} s in turn, {GUARD:g} s away from what was fitted: this speaks of the same motion only"


@dataclass(frozen=True, slots=True)
class HeldOut:
    """Torque error [N m] on rows that the fit has not seen: ``whole`` (n,), and ``within`` (n,) each motion, whatever scale its friction has.

    Friction scales from motion to motion, which nothing foretells.  Where motions are few that scatter is most of the whole error, and
    hides what a law says of every one of them; what differs between motions shows in the whole error only.
    """

    whole: Array
    within: Array


def judged_on(engine: Engine) -> str:
    """What held-out errors are taken on, in words."""
    return BLOCKS if few_motions(engine) else WHOLE


def few_motions(engine: Engine) -> bool:
    """Whether blocks of time are held out, for want of motions."""
    return len(np.unique(engine.fold_of_trial)) < FOLDS


def held_out(now: Hypothesis, hyper: Hyper) -> HeldOut:
    """Torque error of ``now``, RMS over motions that the fit has not seen.

    Where there are fewer motions than folds, blocks of time are held out in turn, with a guard interval at their ends: a motion
    left out alone would then leave nothing to fit.  Such errors speak of these motions only.
    """
    engine, view = now.engine, now.view()
    n = engine.data.n
    few = few_motions(engine)
    folds = [by_time(engine, j) if few else view.engine.grams[j].row_fold for j in range(n)]
    square, inner, count = np.zeros(n), np.zeros(n), np.zeros(n)
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
            here = folds[j][:k] == fold
            if few:
                here &= ~_guarded(engine, j)
            whole = gram.times(theta[gram.index])
            within = whole if few else gram.residual(theta[gram.index], hyper.sigma[j], hyper.kappa[j])
            square[j] += float(np.sum(rows.whiten.coloured(whole[:k])[here] ** 2))
            inner[j] += float(np.sum(rows.whiten.coloured(within[:k])[here] ** 2))
            count[j] += int(here.sum())
    count = np.maximum(count, 1)
    return HeldOut(np.sqrt(square / count), np.sqrt(inner / count))


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
