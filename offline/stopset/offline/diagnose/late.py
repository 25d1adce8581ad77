"""Rows that a late torque spoils: for as long as the lag, it shows what friction held at rest or before a reversal.

How much of its Coulomb torque a joint at rest holds is in no channel, so no column of a delay can be right there, and what is
left looks like friction that builds up.  Where a delay is in question its joint is judged without these rows; a true delay
shows in the others too.
"""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import replace

import numpy as np

from stopset.offline.diagnose.engine import FOLDS, Candidate, Engine, Hyper, Scored
from stopset.offline.diagnose.evidence import JointGram
from stopset.offline.diagnose.noise import coloured, whiten
from stopset.offline.diagnose.prepare import CREEP, Array, Mask
from stopset.offline.diagnose.refine import refined
from stopset.offline.diagnose.rows import JointRows
from stopset.offline.diagnose.scores import scores
from stopset.offline.diagnose.wanted import LOUD

LOOKS_LATE = frozenset({"delay", "hysteresis", "stribeck"})  # what a late torque looks like after rest and reversals
FEW_ROWS = 200  # rows of a joint below which nothing is said of a delay

Kept = tuple[JointRows, JointGram]


def in_question(engine: Engine, top: Scored, left: Sequence[Scored], asked: Set[int], hyper: Hyper) -> Scored | None:
    """The best delay of those ``left`` at the joint of the ``top`` contender, where that may be one; each joint is asked once."""
    joints = top.candidate.joints
    if top.candidate.effect.name not in LOOKS_LATE or asked & set(joints):
        return None
    late = (s for s in left if s.candidate.effect.enters == "input_delay" and s.candidate.joints == joints)
    return next(iter(refined(engine, [s for s in late if s.score > 0], hyper)), None)


def shows_in_motion(engine: Engine, late: Scored, candidates: Sequence[Candidate], hyper: Hyper, threshold: float) -> bool:
    """Whether a delay also shows where its joint was in motion before; then the joint keeps those rows only."""
    (joint,) = late.candidate.joints
    kept = without(engine, joint, spoilt(engine, joint, late.candidate.shapes["d0"]))
    if len(engine.rows[joint].take) > FEW_ROWS:
        again, _ = engine.fit(hyper)
        own = [c for c in candidates if c.key == late.candidate.key and ("exact" not in c.shapes or again.kappa[joint] > LOUD)]
        if any(s.score > threshold for s in refined(engine, scores(engine, own, again), again)):
            return True
    restore(engine, joint, kept)
    return False


def spoilt(engine: Engine, joint: int, lag: float) -> Mask:
    """(K,) moving rows of ``joint`` whose torque, ``lag`` [s] late (early where negative), stems from rest or another direction."""
    d = engine.data
    centre, trial = d.centre[engine.rows[joint].take], d.trial[engine.rows[joint].take]
    first = np.array([t.fine.start for t in d.trials])[trial]
    last = np.array([t.fine.stop for t in d.trials])[trial] - 1
    slow = np.abs(d.dq_fine[:, joint]) < CREEP
    late, reach = -round(lag / d.kernel.dt), d.kernel.half // 2
    out = np.zeros(len(centre), bool)
    for k in range(min(0, late) - reach, max(0, late) + reach + 1):
        at = np.clip(centre + k, first, last)
        out |= slow[at] | (d.way_fine[at, joint] != d.way_fine[centre, joint])
    return out


def without(engine: Engine, joint: int, drop: Mask) -> Kept:
    """Take rows (K,) of ``joint`` out of all columns; what was there before, for `restore`."""
    rows, gram = engine.rows[joint], engine.grams[joint]
    k, kept = len(rows.take), np.flatnonzero(~drop)
    take = rows.take[kept]
    start = (np.diff(take, prepend=-9) != 1) | (np.diff(engine.data.trial[take], prepend=-1) != 0)
    trial = np.concatenate([rows.trial[:k][kept], rows.trial[k:]])

    def again(w: Array) -> Array:
        plain = np.column_stack([coloured(np.ascontiguousarray(c), rows.start, rows.a, rows.sd)[kept] for c in w[:k].T])
        return np.concatenate([whiten(plain, start, rows.a, rows.sd), w[k:]])

    fewer = replace(rows, take=take, start=start, trial=trial)
    folds = engine.fold_of_trial
    restore(engine, joint, (fewer, JointGram.of(again(gram.X), again(gram.f), trial, folds, FOLDS, gram.index)))
    return rows, gram


def restore(engine: Engine, joint: int, kept: Kept) -> None:
    """Give ``joint`` these rows; what was computed from others is forgotten."""
    engine.rows[joint], engine.grams[joint] = kept
    engine.forget(joint)
