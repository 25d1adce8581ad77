"""Torques that stand out for one sample while the arm goes on as before: readings of nothing that happened.

A reading that a bus garbled or a logger misplaced lasts one sample.  So does the torque with which a programme that is broken off is
brought to rest, or a blow; but then some joint's speed steps there, or the joint stands and its friction holds what it was pushed with.
Only a peak in the middle of a motion that no joint answers is left out, as a lost sample.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stopset.recording.repetition import POWERED
from stopset.recording.types import Recording, Spike
from stopset.types import Array

FEWEST = 300  # samples of a trial that tell what is usual
RARE = 0.001  # share of a trial's samples; where more stand out it is how the signal is
# times the peaks that all but a hundredth of samples stay below.  Of real and simulated recordings 1.8 is reached (benchmarks/spikes.py)
OUT = 8.0
SEEN = 0.2  # of what the joint's torque spans, all but its outermost hundredths: less widens nothing
FLAT = 0.2  # of a peak, up to which the samples before and after it agree; what happened leaves more than one
LEVEL = 3  # of these to each side
BESIDE = 5  # samples to both sides that the joint must be moving
MOVING = 0.02  # [rad/s]
ANSWER = 3  # samples to both sides within which a speed would step
AROUND = 50  # samples to both sides that tell how much speeds bend there anyway
ANSWERED = 1.5  # times that


@dataclass(frozen=True, slots=True)
class Peak:
    """Of ``joint`` at sample ``k``: by ``size`` [N m] off both neighbours."""

    k: int
    joint: int
    size: float

    def at(self, r: Recording) -> Spike:
        return Spike(float(r.t[self.k]), self.joint, self.size)


def without_spikes(r: Recording) -> Recording:
    """A powered trial without the samples at which a torque is none; ``spikes``: what was left out."""
    found = [p for p, _ in standing_out(r) if goes_on(r, p)]
    out = np.unique([p.k for p in found])
    if not len(out) or len(out) > max(1.0, RARE * len(r.t)):
        return r
    return replace(r.rows(np.delete(np.arange(len(r.t)), out)), spikes=tuple(p.at(r) for p in found))


def peaks(r: Recording) -> tuple[Spike, ...]:
    """Torques of a powered trial that stand out for one sample and have a reason in the motion, or may have: they stay in it."""
    return tuple(p.at(r) for p, _ in standing_out(r))


def standing_out(r: Recording, by: float = OUT) -> list[tuple[Peak, float]]:
    """Samples of a powered trial that stand out of both neighbours by more than ``by`` times what is usual of such; with the times."""
    if r.phase not in POWERED or len(r.t) < FEWEST:
        return []
    before, after = r.tau[1:-1] - r.tau[:-2], r.tau[1:-1] - r.tau[2:]
    size = np.where(before * after > 0, np.where(np.abs(before) < np.abs(after), before, after), 0.0)
    usual = np.maximum(np.percentile(np.abs(size), 99, axis=0), 1e-12)
    span = np.subtract(*np.percentile(r.tau, [99, 1], axis=0))
    out = np.abs(size) > np.maximum(by * usual, SEEN * span)
    return [(Peak(int(k) + 1, int(j), float(size[k, j])), float(abs(size[k, j]) / usual[j])) for k, j in np.argwhere(out)]


def goes_on(r: Recording, p: Peak) -> bool:
    """Whether the arm moves through a peak as before and after it: then no torque of that size was there."""
    beside = np.delete(r.tau[max(p.k - LEVEL, 0) : p.k + LEVEL + 1, p.joint], min(p.k, LEVEL))
    return bool(np.ptp(beside) < FLAT * abs(p.size)) and _moves(r, p) and not _answered(r.dq, p.k)


def _moves(r: Recording, p: Peak) -> bool:
    """Whether the joint moves on one way all around its peak: at rest friction may hold anything."""
    dq = r.dq[max(p.k - BESIDE, 0) : p.k + BESIDE + 1, p.joint]
    return bool(dq.min() > MOVING or dq.max() < -MOVING)


def _answered(dq: Array, k: int) -> bool:
    """Whether some joint's speed (N, n) bends at sample ``k`` more sharply than anywhere around."""
    bend = np.zeros(dq.shape)
    bend[2:-2] = np.abs(dq[4:] - 2 * dq[2:-2] + dq[:-4])
    here, around = _near(len(dq), k, ANSWER), _near(len(dq), k, AROUND) & ~_near(len(dq), k, ANSWER + 2)
    return bool((bend[here].max(axis=0) > ANSWERED * bend[around].max(axis=0)).any())


def _near(length: int, k: int, by: int) -> NDArray[np.bool_]:
    return np.asarray(np.abs(np.arange(length) - k) <= by)
