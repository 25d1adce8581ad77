"""Readings that a logger took at its own pace: it asks a robot that publishes at another, and stamps what it gets by its own clock.

Where it is ahead, it writes the last reading again; where it is behind, a reading is skipped and the next step is twice as long.  Under stamps
that are even throughout that is an arm that stands for a sample and leaps with the next: accelerations of a hundred times what was there.
The steps themselves tell how many periods they took.  A reading that was written again is left out, one that was skipped is a lost sample, and
the stamps are those of the robot's own clock.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from stopset.recording.repetition import POWERED
from stopset.recording.spikes import MOVING
from stopset.recording.types import Recording
from stopset.types import Array

FEWEST_READINGS = 100  # of a trial whose steps are looked at
STEADY = 0.2  # of the period, by which stamps that were made up differ at most
LEAST = 3  # steps that took another number of periods; fewer are a stumble, not a pace
MOST = 0.1  # share of all steps; where more do, dq is not the derivative of q or the rate is another
LONGEST = 4  # periods that a step is told to have taken; longer ones are pauses
WHOLE = 0.25  # of a period, by which such a step, of all joints together, may miss a whole number of them
AROUND = 5  # steps to both sides, whose mean is how fast an arm moves of which nobody recorded speeds
REST = 3  # steps of no length before or after: the arm stands there
PLAIN = 5.0  # times the usual distance between steps and speeds (its 90th percentile) that an arm's step must be to be counted
BETTER = 0.7  # times what steps and speeds differ by, that they do on the robot's clock at most
ITS = (3.0, 1.0)  # the same, and for one that should be there, once a logger is known to ask at its own pace


def on_its_clock(r: Recording, *, derived: bool = False) -> Recording:
    """A powered trial on the clock of the robot that was asked; ``again`` and ``skipped`` count what the logger made of it.

    ``derived``: its speeds were made from angles and these stamps; they are made anew.
    """
    if r.phase not in POWERED or len(r.t) < FEWEST_READINGS:
        return r
    h = float(np.median(np.diff(r.t)))
    if np.abs(np.diff(r.t) - h).max() > STEADY * h:
        return r
    speed = _usual_steps(r.q) / h if derived else 0.5 * (r.dq[1:] + r.dq[:-1])
    took = periods(r, h, speed)
    odd = took != 1
    # where nobody recorded speeds only a reading that was written again is plain to see: long steps alone may be what the arm did
    sure = took == 0 if derived else odd
    if sure.sum() < LEAST or odd.sum() > MOST * len(took):
        return r
    took = periods(r, h, speed, *ITS)  # of such a logger smaller steps tell, too
    new = np.r_[True, took > 0]
    clock = np.r_[0, np.cumsum(took)]
    t = r.t[0] + (r.t[-1] - r.t[0]) / clock[-1] * clock[new]
    out = replace(r.rows(np.flatnonzero(new)), t=t, again=int((took == 0).sum()), skipped=int(np.maximum(took - 1, 0).sum()))
    if derived:
        return replace(out, dq=np.gradient(out.q, t, axis=0))
    # of a logger that is slower throughout, and stamps what it reads, no time is missing: most of its steps are shorter than its period
    return out if _missed(out) < BETTER * _missed(r) else r


def _missed(r: Recording) -> float:
    """[rad] by which steps of the angles miss those of the speeds, root mean square."""
    return float(np.sqrt(np.mean((np.diff(r.q, axis=0) - 0.5 * (r.dq[1:] + r.dq[:-1]) * np.diff(r.t)[:, None]) ** 2)))


def periods(r: Recording, h: float, speed: Array, plain_at: float = PLAIN, repeats: float = PLAIN) -> NDArray[np.intp]:
    """(N - 1,) how many periods ``h`` [s] each step took, by mean ``speed`` (N - 1, n) [rad/s] over it: 1 where the arm moves too little to tell.

    A reading counts as written again where angles and torques are the same to the last bit over what should be a step.
    ``plain_at``, ``repeats``: how plain a step must be, in usual misses, to be counted, and to be missed.
    """
    step = np.diff(r.q, axis=0)
    moves = np.abs(speed).max(axis=1) > MOVING
    if not moves.any():
        return np.ones(len(step), np.intp)
    error = np.percentile(np.abs(step - speed * h)[moves], 90, axis=0)  # steps of other lengths are fewer
    weight = 1.0 / np.maximum(error, 1e-9) ** 2
    expected = ((speed * h) ** 2 * weight).sum(axis=1)
    plain = moves & (expected > plain_at**2 * r.q.shape[1])
    ratio = (step * speed * h * weight).sum(axis=1) / np.where(plain, expected, 1.0)
    # all joints alike: a joint that hits something is not a step of two periods
    difference = (((step - ratio[:, None] * speed * h) ** 2 * weight).sum(axis=1) / np.where(plain, expected, 1.0)) ** 0.5
    count = np.round(ratio).astype(np.intp)
    whole = plain & (np.abs(ratio - count) < WHOLE) & (difference < WHOLE) & (count <= LONGEST)
    same = np.logical_and.reduce([(x[1:] == x[:-1]).all(axis=1) for x in (r.q, r.tau)])
    took = np.where(whole & (count > 1), count, 1)
    return np.where(moves & same & (expected > repeats**2 * r.q.shape[1]), 0, took)


def _usual_steps(q: Array) -> Array:
    """(N - 1, n) mean of the steps of angles (N, n) around each: what was passed over there is about what was written again; 0 beside a rest."""
    step = np.diff(q, axis=0)
    k = np.arange(len(step))
    lo, hi = np.maximum(k - AROUND, 0), np.minimum(k + 1 + AROUND, len(step))
    moved = np.r_[0, np.cumsum((step != 0).any(axis=1))]
    before, after = moved[k] > moved[np.maximum(k - REST, 0)], moved[np.minimum(k + 1 + REST, len(step))] > moved[k + 1]
    usual: Array = (q[hi] - q[lo]) / (hi - lo)[:, None]
    usual[~(before & after)] = 0.0
    return usual
