"""Torque errors of a hypothesis on rows that its fit has not seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stopset.offline.campaign.hold_out import BLOCK, FOLDS, GUARD
from stopset.offline.diagnose import thresholds as limit
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
    ``halves`` (n,), where blocks of time are held out: the error of either half by a fit of the other one.  Blocks lie between what was
    fitted just before and after them, at the same places of the arm: there any curve interpolates.  ``scale``: how far the description was
    taken to be off, in its tolerance.
    """

    whole: Array
    within: Array
    halves: Array | None = None
    scale: float = 0.0


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
    engine, n = now.engine, now.engine.data.n
    if few_motions(engine):
        whole = _left_out(now, hyper, [by_time(engine, j) for j in range(n)])
        if len(engine.data.trials) >= limit.SCATTERED:
            return HeldOut(whole, whole, None, hyper.scale)
        return HeldOut(whole, whole, _left_out(now, hyper, [by_half(engine, j) for j in range(n)]), hyper.scale)
    return _motions_left_out(now, hyper)


def on_motions(now: Hypothesis, hyper: Hyper) -> HeldOut | None:
    """`held_out` on whole motions where they are few, but three at least; else None.

    What is fitted then lacks most of the places that judge: too much to ask of a claim, not of a finer form of one.
    """
    motions = len(np.unique(now.engine.fold_of_trial))
    return _motions_left_out(now, hyper) if limit.SCATTERED <= motions < FOLDS else None


def _motions_left_out(now: Hypothesis, hyper: Hyper) -> HeldOut:
    engine, view = now.engine, now.view()
    n = engine.data.n
    square, inner = np.zeros(n), np.zeros(n)
    fits = np.zeros((FOLDS, view.engine.size))
    for fold in np.unique(engine.fold_of_trial):
        fits[fold] = _fitted(view, hyper, view.total(hyper, np.arange(FOLDS) != fold)[0])
    for j, rows in enumerate(engine.rows):
        gram, k = view.engine.grams[j], len(rows.take)
        whole, within = gram.left_by_folds(fits[:, gram.index], hyper.sigma[j], hyper.kappa[j])
        square[j], inner[j] = (float(np.sum(rows.whiten.coloured(x[:k]) ** 2)) for x in (whole, within))
    count = np.maximum([len(rows.take) for rows in engine.rows], 1)
    return HeldOut(np.sqrt(square / count), np.sqrt(inner / count), None, hyper.scale)


def _left_out(now: Hypothesis, hyper: Hyper, folds: Sequence[Index]) -> Array:
    """(n,) error of the parts of time that ``folds`` (by joint, (K + P,) of each row; -1: in no part that judges) number, each by a
    fit of all others."""
    engine, view = now.engine, now.view()
    square, count = np.zeros(engine.data.n), np.zeros(engine.data.n)
    for fold in range(max(int(f[: len(r.take)].max(initial=-1)) for f, r in zip(folds, engine.rows, strict=True)) + 1):
        G = np.zeros((view.engine.size, view.engine.size))
        for gram, own, kappa in zip(view.engine.grams, folds, hyper.kappa, strict=True):
            G[np.ix_(gram.index, gram.index)] += _sums(gram, own != fold, kappa)
        theta = _fitted(view, hyper, G)
        for j, rows in enumerate(engine.rows):
            gram, k = view.engine.grams[j], len(rows.take)
            here = (folds[j][:k] == fold) & ~_guarded(engine, j)
            square[j] += float(np.sum(rows.whiten.coloured(gram.times(theta[gram.index])[:k])[here] ** 2))
            count[j] += int(here.sum())
    return np.sqrt(square / np.maximum(count, 1))


def _fitted(view: Hypothesis, hyper: Hyper, G: Array) -> Array:
    """Coefficients of a view's columns, that of the torque first, from sums over some rows."""
    p = project(G, 0, view.nuisance, np.zeros(0, np.intp), view.precision(hyper), view.mean)
    return np.concatenate([[1.0], -p.theta])


def by_half(engine: Engine, joint: int) -> Index:
    """(K + P,) whether a row of a joint lies in the second half of all that was recorded, by time; poses are in neither."""
    rows, d = engine.rows[joint], engine.data
    begun = np.concatenate([[0.0], np.cumsum([t.fine.stop - t.fine.start for t in d.trials])]) * d.kernel.dt
    first = np.array([d.t_fine[t.fine.start] for t in d.trials])
    trial = d.trial[rows.take]
    since = begun[trial] + d.t[rows.take] - first[trial]
    return np.concatenate([(since >= begun[-1] / 2).astype(np.intp), np.full(rows.size - len(rows.take), 2, np.intp)])


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
