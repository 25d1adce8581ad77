"""What stamps that are not even mean: an even clock that they scatter about, or samples that were taken when they say.

A logger stamps what it receives, so that stamps may scatter by a millisecond where the drives sampled on a clock.  A position read a
millisecond off is a milliradian off at 1 rad/s, in the acceleration far more than an encoder's noise.  Which of the two it is the
positions tell: they are smoother as they were taken.
"""

from __future__ import annotations

import numpy as np

from stopset.types import Array

FOLLOW = 0.05  # share of a stamp's scatter that the clock follows
NEAR = 0.1  # of a period that the clock's own may be off the usual time between stamps
GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)  # multiples of it, modulo 1, fill the unit interval evenly


def even_clock(t: Array, dt: float, near: float = NEAR) -> tuple[Array | None, int]:
    """(N,) times on the even clock of about ``dt`` [s] that the stamps ``t`` scatter about, None where there is none; lost samples."""
    # plain numbers: of an array each would take ten times as long to look up
    stamps, places, now = t.tolist(), [0] * len(t), float(t[0])
    for k in range(1, len(stamps)):
        steps = round((stamps[k] - now) / dt)
        if steps < 1 and k > 1 and places[k - 1] - places[k - 2] > 1:  # the stamp before came late: nothing was lost before it
            places[k - 1] -= 1
            now -= dt
        steps = max(1, steps)
        places[k] = places[k - 1] + steps
        now += steps * dt
        now += FOLLOW * (stamps[k] - now)
    place = np.array(places, float)
    for _ in range(2):
        period, begin = np.polyfit(place, t, 1)
        place = _distinct((t - begin) / period)
    even = bool(abs(period - dt) < near * dt)
    lost = int(place[-1] - place[0]) + 1 - len(place) if even else lost_between(t, dt)
    return (begin + period * place if even else None), lost


def lost_between(t: Array, dt: float) -> int:
    """Samples that are lost where those there are were taken when their stamps say, about every ``dt`` [s]."""
    return int(np.sum(np.maximum(np.round(np.diff(t) / dt) - 1, 0)))


def _distinct(x: Array) -> Array:
    """Places of samples, whole numbers that rise, nearest to ``x`` (N,) in the mean square: stamps half a period off share no place."""
    from scipy.optimize import isotonic_regression  # half a second, for what few recordings need

    least = np.arange(len(x))
    return np.asarray(least + np.round(isotonic_regression(x - least).x))


def roughness(q: Array) -> float:
    """How noisy positions are in the mean over joints, as a logarithm: of two readings of the stamps the smoother one is the true one."""
    return float(np.sum(np.log(np.maximum(white(q), 1e-12))))


def white(x: Array) -> Array:
    """White noise (n,) of a signal from its fourth differences, which a motion hardly reaches; robust to a few jumps.

    A reading comes in steps, and so does the median of its differences: a step too low or too high would make the noise half or
    twice as large.  So every difference is spread evenly over the step it stands for, and the spread is taken off again.
    """
    step = np.array([step_of(c) for c in x.T])
    d = np.diff(x, 4, axis=0)
    even = np.mod(np.arange(len(d)) * GOLDEN, 1.0) - 0.5
    square = np.median((d + np.outer(even, step)) ** 2, axis=0) / 0.4549  # the median of chi2_1
    return np.sqrt(np.maximum((square - step**2 / 12) / 70.0, step**2 / 12))  # 70: sum of squared binomials


def step_of(x: Array) -> float:
    """The step of a reading; next to nothing where it has none."""
    return float(np.min(np.diff(np.unique(x)))) if np.ptp(x) > 0 else 0.0
