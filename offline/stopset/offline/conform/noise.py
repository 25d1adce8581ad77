"""The measurement noise set ``V_y``: from standstill where there is any, and never below the encoder's resolution.

Without it the noise of every restart would be swallowed by ``U`` and integrated (trap P2).
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from stopset.recording import Recording
from stopset.sets import Box

Array = NDArray[np.float64]

WINDOW = 7  # samples of the local parabola: short against any motion, long enough to average
COVERAGE = 4.0  # half-width in robust standard deviations of the local residual


def resolution(x: Array) -> Array:
    """Smallest step each column of ``x`` (N, n) makes, an upper guess of the encoder's quantum; 0 where it never moves."""
    steps = np.abs(np.diff(x, axis=0))
    # float32 storage of values up to pi has steps of 2.4e-7 of its own
    steps[steps < 5e-7] = np.inf
    quantum = steps.min(axis=0, initial=np.inf)
    return np.where(np.isfinite(quantum), quantum, 0.0)


def _residual(x: Array) -> Array:
    """Residual of ``x`` (N, n) at the middle of a sliding parabola of `WINDOW` samples, scaled to unit noise gain."""
    half = WINDOW // 2
    k = np.arange(-half, half + 1)
    hat = np.vander(k, 3) @ np.linalg.pinv(np.vander(k, 3))
    weights = -hat[half]
    weights[half] += 1.0
    windows = np.lib.stride_tricks.sliding_window_view(x, WINDOW, axis=0)
    return np.asarray(windows @ weights / np.sqrt(weights @ weights))


def measurement_noise(trials: Iterable[Recording]) -> Box:
    """``V_y`` (2n,) over (q, dq): symmetric, half-width = max(quantum / 2, 4 robust standard deviations).

    The deviation from a parabola over seven samples is noise, not motion; its spread is taken by the median absolute
    deviation over all trials of at least seven samples, so that a jerk here and there does not count.
    """
    spread: list[Array] = []
    quantum: list[Array] = []
    for r in trials:
        x = np.hstack([r.q, r.dq])
        quantum.append(resolution(x))
        if len(x) >= WINDOW:
            spread.append(1.4826 * np.median(np.abs(_residual(x)), axis=0))
    half = np.max(quantum, axis=0) / 2.0
    if spread:
        half = np.maximum(half, COVERAGE * np.median(spread, axis=0))
    return Box.symmetric(half)
