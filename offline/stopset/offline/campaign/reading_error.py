"""How wrong a reading may be, from the readings alone: what ``V`` holds at least and at most (traps P2, P12).

At least the noise.  At most how far readings were seen from the smooth motion of the positions around them: of a velocity its
distance from their slope.  That is what a rigid arm does not do within `SMOOTH`: vibration, the jolt of a stop, the lag and the
ringing of a filter.  No model is asked, so none can hide its error there; that lasts longer, and goes to ``U``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stopset.sets import Box
from stopset.types import Array

SMOOTH = 0.15  # [s] over which the motion of a rigid arm is a cubic
FEWEST = 5  # samples of that cubic where they come too slowly


@dataclass(frozen=True, slots=True)
class ReadingError:
    """Bounds of ``V`` (2n,) over (q, dq): it encloses ``least`` and lies in ``most``, which encloses ``least``."""

    least: Box
    most: Box

    @classmethod
    def exact(cls, V: Box) -> ReadingError:
        """``V`` itself, no choice left."""
        return cls(V, V)

    @property
    def dim(self) -> int:
        return self.least.dim

    def take(self, states: Sequence[int]) -> ReadingError:
        """Of some of the states."""
        return ReadingError(self.least.take(list(states)), self.most.take(list(states)))


@dataclass(frozen=True, slots=True)
class ReadingResidual:
    """Readings of one trial against the sliding cubic of their positions.

    ``error`` (K, 2n): positions less the cubic, velocities less its slope; ``bend`` (K, n): its curvature [rad/s^2].
    """

    error: Array
    bend: Array

    @property
    def reach(self) -> Array:
        """(2n,) the largest error."""
        return np.asarray(np.abs(self.error).max(axis=0, initial=0.0))

    @property
    def late(self) -> Array:
        """(2, n) numerator and denominator, to add over trials, of the time [s] by which velocities come after the slope."""
        v = self.error[:, self.bend.shape[1] :]
        return np.stack([-(v * self.bend).sum(axis=0), (self.bend**2).sum(axis=0)])


def reading_residual(q: Array, dq: Array, dt: float) -> ReadingResidual:
    """`ReadingResidual` of readings ``q, dq`` (N, n) every ``dt`` [s]; no rows where the trial is shorter than the cubic."""
    half = max(FEWEST // 2, round(SMOOTH / dt / 2.0))
    if len(q) <= 2 * half:
        return ReadingResidual(np.zeros((0, 2 * q.shape[1])), np.zeros((0, q.shape[1])))
    powers = np.vander(dt * np.arange(-half, half + 1), 4, increasing=True)
    value, slope, bend = np.linalg.pinv(powers)[:3]
    at = slice(half, len(q) - half)
    smooth, speed, curved = (np.column_stack([np.convolve(c, w[::-1], "valid") for c in q.T]) for w in (value, slope, 2.0 * bend))
    return ReadingResidual(np.hstack([q[at] - smooth, dq[at] - speed]), curved)
