"""The measurement noise: from standstill where there is any, and never below the encoder's resolution.

Without it the noise of every restart would be swallowed by ``U`` and integrated (trap P2).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stopset.recording import Recording
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


def _residual(x: Array) -> Array:
    """Residual of ``x`` (N, n) at the middle of a sliding parabola of `WINDOW` samples, scaled to unit noise gain."""
    return np.asarray(np.lib.stride_tricks.sliding_window_view(x, WINDOW, axis=0) @ _parabola_weights())


class NoiseEstimate:
    """Running estimate of the noise of (q, dq), fed trial by trial.

    The deviation from a parabola over seven samples is noise, not motion; its spread is taken by the median absolute
    deviation within a trial and the median over trials, so that a jerk here and there does not count.
    """

    def __init__(self) -> None:
        self._spread: list[Array] = []
        self._quantum: Array | None = None

    def add(self, r: Recording) -> None:
        """Take one trial in."""
        x = np.hstack([r.q, r.dq])
        quantum = resolution(x)
        if len(x) >= WINDOW:
            self._spread.append(1.4826 * np.median(np.abs(_residual(x)), axis=0))
            known = quantum > 0
            if self._quantum is None:
                self._quantum = quantum
            else:
                both = known & (self._quantum > 0)
                self._quantum = np.where(both, np.minimum(self._quantum, quantum), np.maximum(self._quantum, quantum))

    def box(self) -> Box:
        """(2n,) symmetric: half-width = max(quantum / 2, `COVERAGE` robust standard deviations)."""
        if self._quantum is None:
            raise ValueError("no trial of seven samples was seen")
        return Box.symmetric(np.maximum(self._quantum / 2.0, COVERAGE * np.median(self._spread, axis=0)))
