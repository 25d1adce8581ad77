"""The measurement noise: from standstill where there is any, and never below the encoder's resolution.

Without it the noise of every restart would be swallowed by ``U`` and integrated (trap P2).
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import reduce

import numpy as np

from stopset.errors import RecordingError
from stopset.offline.campaign.reading_error import ReadingError, ReadingResidual, reading_residual
from stopset.recording import Recording, SuiteKey
from stopset.sets import Box
from stopset.types import Array

WINDOW = 7  # samples of the local parabola: short against any motion, long enough to average
COVERAGE = 4.0  # half-width in robust standard deviations of the local residual
TELLING = 1.5  # times its noise: a slower reading does not tell which way a joint moves, and its friction would jump by chance
FLOAT32_STEP = 5e-7  # files hold float32: values up to 2 pi have steps of 4.8e-7 of their own


def resolution(x: Array) -> Array:
    """Smallest step each column of ``x`` (N, n) makes, an upper guess of the encoder's quantum; 0 where it never moves."""
    steps = np.abs(np.diff(x, axis=0))
    steps[steps < FLOAT32_STEP] = np.inf
    quantum = steps.min(axis=0, initial=np.inf)
    return np.where(np.isfinite(quantum), quantum, 0.0)


def _parabola_weights() -> Array:
    half = WINDOW // 2
    k = np.arange(-half, half + 1)
    hat = np.vander(k, 3) @ np.linalg.pinv(np.vander(k, 3))
    weights = -hat[half]
    weights[half] += 1.0
    return np.asarray(weights / np.sqrt(weights @ weights))


_WEIGHTS = _parabola_weights()


def _residual(x: Array) -> Array:
    """Residual of ``x`` (N, n) at the middle of a sliding parabola of `WINDOW` samples, scaled to unit noise gain."""
    inner = len(x) - WINDOW + 1
    return np.asarray(sum(w * x[k : k + inner] for k, w in enumerate(_WEIGHTS)))


def spread(x: Array) -> Array:
    """Robust standard deviation of the noise of each column of ``x`` (N, n); zero where there are too few samples."""
    if len(x) < WINDOW:
        return np.zeros(x.shape[1])
    by_column = np.ascontiguousarray(np.abs(_residual(x)).T)  # a median along rows takes half the time
    return np.asarray(1.4826 * np.median(by_column, axis=1))


def _finest(a: Array, b: Array) -> Array:
    """The smaller of two quanta; 0 says nothing."""
    return np.where((a > 0) & (b > 0), np.minimum(a, b), np.maximum(a, b))


@dataclass(frozen=True, slots=True)
class RetainedNoise:
    """What the estimate holds of each suite: spreads (2n,) of its trials, quantum (2n,), largest distance (2n,) of its powered
    readings from smooth motion, and sums (2, n) of their lateness."""

    spread: dict[SuiteKey, list[Array]]
    quantum: dict[SuiteKey, Array]
    reach: dict[SuiteKey, Array]
    late: dict[SuiteKey, Array]


class NoiseEstimate:
    """Running estimate of the error of (q, dq), fed trial by trial.

    The deviation from a parabola over seven samples is noise, not motion; its spread is taken by the median absolute
    deviation within a trial and the median over trials, so that a jerk here and there does not count.  What such jerks do
    to the readings of powered motion is the most that their error may be, see `ReadingError`.
    """

    def __init__(self, retained: RetainedNoise | None = None) -> None:
        self.retained = retained or RetainedNoise({}, {}, {}, {})
        self._spread, self._quantum = self.retained.spread, self.retained.quantum

    def add(self, r: Recording, dt: float = 0.0) -> None:
        """Take one trial in; ``dt`` [s]: the grid it is on if it counts for what the sets are found from."""
        x = np.hstack([r.q, r.dq])
        quantum = resolution(x)
        if len(x) >= WINDOW:
            self._spread.setdefault(r.suite_key, []).append(spread(x))
            self._quantum[r.suite_key] = _finest(self._quantum.get(r.suite_key, quantum), quantum)
        if dt > 0.0:
            self._powered(r.suite_key, reading_residual(r.q, r.dq, dt))

    def _powered(self, suite: SuiteKey, seen: ReadingResidual) -> None:
        reach, late = self.retained.reach, self.retained.late
        reach[suite] = np.maximum(reach.get(suite, seen.reach), seen.reach)
        late[suite] = late.get(suite, 0.0) + seen.late

    def late(self, without: Collection[SuiteKey] = ()) -> Array:
        """(n,) time [s] by which velocities come after the slope of their positions; 0 where nothing moves."""
        late = [x for s, x in self.retained.late.items() if s not in without]
        above, below = np.sum(late, axis=0) if late else np.zeros((2, 1))
        return np.divide(above, below, out=np.zeros_like(above), where=below > 0.0)

    def error(self, without: Collection[SuiteKey] = ()) -> ReadingError:
        """(2n,) symmetric bounds of ``V``, ``without`` some suites: noise at least, what was seen in motion at most.

        The noise is max(quantum / 2, `COVERAGE` robust standard deviations).  Raises `RecordingError` if no trial is long
        enough.
        """
        least = self._noise(without)
        reach = [x for s, x in self.retained.reach.items() if s not in without]
        most = np.maximum(least, np.max(reach, axis=0)) if reach else least
        return ReadingError(Box.symmetric(least), Box.symmetric(most))

    def _noise(self, without: Collection[SuiteKey]) -> Array:
        suites = [s for s in self._spread if s not in without]
        if not suites:
            raise RecordingError(f"no trial has {WINDOW} samples, so the noise is unknown; expected longer trials: record again")
        quantum = reduce(_finest, (self._quantum[s] for s in suites))
        spread = np.vstack([x for s in suites for x in self._spread[s]])
        return np.asarray(np.maximum(quantum / 2.0, COVERAGE * np.median(spread, axis=0)))
