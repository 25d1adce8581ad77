"""The measurement noise: from standstill where there is any, and never below the encoder's resolution.

Without it the noise of every restart would be swallowed by ``U`` and integrated (trap P2).
"""

from __future__ import annotations

from collections.abc import Collection
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from stopset.errors import RecordingError
from stopset.recording import Recording, SuiteKey
from stopset.sets import Box

Array = NDArray[np.float64]

WINDOW = 7  # samples of the local parabola: short against any motion, long enough to average
COVERAGE = 4.0  # half-width in robust standard deviations of the local residual
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


class NoiseEstimate:
    """Running estimate of the noise of (q, dq), fed trial by trial.

    The deviation from a parabola over seven samples is noise, not motion; its spread is taken by the median absolute
    deviation within a trial and the median over trials, so that a jerk here and there does not count.
    """

    def __init__(self) -> None:
        self._spread: dict[SuiteKey, list[Array]] = {}
        self._quantum: dict[SuiteKey, Array] = {}

    def add(self, r: Recording) -> None:
        """Take one trial in."""
        x = np.hstack([r.q, r.dq])
        quantum = resolution(x)
        if len(x) >= WINDOW:
            self._spread.setdefault(r.suite_key, []).append(spread(x))
            self._quantum[r.suite_key] = _finest(self._quantum.get(r.suite_key, quantum), quantum)

    def kept(self) -> tuple[dict[SuiteKey, list[Array]], dict[SuiteKey, Array]]:
        """Spreads (2n,) of all trials and quantum (2n,) by suite."""
        return self._spread, self._quantum

    @classmethod
    def of(cls, spread: dict[SuiteKey, list[Array]], quantum: dict[SuiteKey, Array]) -> NoiseEstimate:
        """The estimate that `kept` was taken from."""
        out = cls()
        out._spread, out._quantum = spread, quantum
        return out

    def box(self, without: Collection[SuiteKey] = ()) -> Box:
        """(2n,) symmetric: half-width = max(quantum / 2, `COVERAGE` robust standard deviations), ``without`` some suites.

        Raises `RecordingError` if no trial is long enough.
        """
        suites = [s for s in self._spread if s not in without]
        if not suites:
            raise RecordingError(f"no trial has {WINDOW} samples, so the noise is unknown; expected longer trials: record again")
        quantum = reduce(_finest, (self._quantum[s] for s in suites))
        spread = np.vstack([x for s in suites for x in self._spread[s]])
        return Box.symmetric(np.maximum(quantum / 2.0, COVERAGE * np.median(spread, axis=0)))
