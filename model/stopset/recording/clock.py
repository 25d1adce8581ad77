"""The clock of a recording: where a trial begins when no column says so, and stamps that were printed too short."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stopset.types import Array

PAUSE = 1.0  # [s] between samples from which on nobody was recording
SLOWER = 10.0  # times the usual distance of samples, of a slow clock's pause
FEWEST_STAMPS = 30  # of a trial whose clock is looked at
PRINTED = (0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001, 0.0005, 0.0002, 0.0001)  # [s] what stamps are printed to
WIDE = 1.5  # periods, and times the way of its neighbours: a step over a sample that was lost
ROUGH = 0.05  # of the period: stamps printed to less are as good as exact


def anew(t: Array, before: float) -> NDArray[np.bool_]:
    """Where stamps (N,) that follow ``before`` [s] begin a trial: the clock went back, or nothing was recorded for a while."""
    dt = np.diff(t, prepend=before)
    return (dt < 0) | (dt >= max(PAUSE, SLOWER * float(np.nanmedian(dt)) if len(t) > 1 else 0.0))


def evened(t: Array, q: Array) -> tuple[Array, float]:
    """Stamps (N,), and what they were printed to: where that hides an even clock (all lie on one within a print), the clock itself.

    Printed to the period, one lost sample looks like it; but over such a step the angles ``q`` (N, n) [rad] go on for two.
    """
    if len(t) < FEWEST_STAMPS:
        return t, 0.0
    h, first = (float(x) for x in np.polyfit(np.arange(len(t)), t, 1))
    printed = next((g for g in PRINTED if np.abs(t / g - np.round(t / g)).max() < 1e-4), 0.0)
    even = first + h * np.arange(len(t))
    off = t - even
    if not ROUGH * h < printed or np.abs(np.diff(t) - h).max() <= ROUGH * h or np.ptp(off) > 1.02 * printed:
        return t, 0.0
    travel = np.abs(np.diff(q, axis=0)).sum(axis=1)
    wide = 1 + np.flatnonzero(np.diff(t)[1:-1] > WIDE * h)
    if travel[wide].sum() > WIDE * 0.5 * (travel[wide - 1] + travel[wide + 1]).sum():
        return t, 0.0
    return even + 0.5 * (off.max() + off.min()), printed
