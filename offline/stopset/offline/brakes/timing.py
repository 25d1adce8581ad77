"""When, how fast and how hard each brake closed in one recorded stop, as far as that stop tells it.

An impulse curve is a straight line (what the drive still gave, and the error of friction and gravity) plus the brake's ramp.
The line and the brake's torque are linear and solved for; delay and rise are searched on a grid, so there is no start value
to be wrong about.  A joint that came to rest before its brake engaged fits every late delay alike: it tells nothing of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stopset.offline.brakes.impulse import Impulse
from stopset.types import Array

GRID = 1e-3  # [s] of delays
RISES = np.arange(2e-3, 41e-3, 3e-3)  # [s]
TORQUE_PRIOR = 0.3  # relative standard deviation of a brake's torque around what is assumed of it
FADING = 6e-3  # [s] a drive's torque may last after the cut, one sigma
EARLY = 0.016  # [s] after the cut, in which no brake closes and power is gone
SIGNIFICANT = 9.0  # squared misfit: three standard deviations of one parameter
SHARP = 0.006  # [s] a delay known no better than this is not counted, nor a rise
TELLING = 0.08  # relative standard deviation of a torque that counts
CREDIBLE = (0.35, 2.0)  # times the torque assumed; what lies beyond is a wrong friction or an elastic joint, not a brake
MISFIT = 2.5  # squared misfit per sample beyond which no ramp explains the curve


@dataclass(frozen=True, slots=True)
class BrakeEstimate:
    """What one joint told in one stop; nan where it told nothing.

    ``delay``, ``rise`` [s]; ``torque`` [N m]; ``impulse`` [N m s] the drive still gave along the motion; ``torque_error``
    [N m] along the motion, of friction and gravity before the brake, and its standard deviation ``torque_error_std``.
    """

    delay: float
    rise: float
    torque: float
    impulse: float
    torque_error: float
    torque_error_std: float


def brake_estimate(c: Impulse, torque: float, friction_spread: float) -> BrakeEstimate:
    """The best ramp of one curve; ``torque``: [N m] assumed, ``friction_spread``: [N m] one sigma."""
    delays = np.arange(0.0, float(c.t[-1]) + 0.5 * RISES[-1], GRID)
    size = np.array([np.hypot(c.noise, FADING * c.drive), friction_spread])
    line = np.stack([np.ones_like(c.t), c.t], axis=1) * size / c.noise  # columns with unit priors
    gain = np.linalg.solve(np.eye(2) + line.T @ line, line.T)
    rest = np.eye(len(c.t)) - line @ gain
    y = c.taken / c.noise
    R = unit_ramps(c.t, delays, RISES) / c.noise
    RQ = R @ rest
    weight = 1.0 / (TORQUE_PRIOR * torque) ** 2
    curvature, slope = np.sum(RQ * R, axis=2), RQ @ y
    level = (slope + weight * torque) / (curvature + weight)
    cost = y @ rest @ y - 2.0 * level * slope + level**2 * curvature + weight * (level - torque) ** 2
    d, r = np.unravel_index(int(np.argmin(cost)), cost.shape)
    none = float(y @ rest @ y)  # misfit without any brake
    if min(cost[d, r], none) > MISFIT * len(c.t):  # an elastic joint, say: what it does right after the cut counts as given
        early = c.taken[c.t <= EARLY]
        return BrakeEstimate(np.nan, np.nan, np.nan, -float(early[np.argmax(np.abs(early))]), np.nan, np.inf)
    spread = size * np.sqrt(np.diag(np.linalg.inv(np.eye(2) + line.T @ line)))
    if none < cost[d, r] + 2.0 * SIGNIFICANT:
        x = size * (gain @ y)
        return BrakeEstimate(np.nan, np.nan, np.nan, -float(x[0]), -float(x[1]), float(spread[1]))
    alike = delays[cost.min(axis=1) < cost.min() + SIGNIFICANT]
    rises = RISES[cost.min(axis=0) < cost.min() + 0.5 * SIGNIFICANT]
    credible = CREDIBLE[0] * torque <= level[d, r] <= CREDIBLE[1] * torque
    sharp = credible and np.ptp(alike) <= SHARP and float(alike[-1]) < float(c.t[-1])
    mean, std = _level(cost, level, curvature + weight)
    x = size * (gain @ (y - level[d, r] * R[d, r]))
    return BrakeEstimate(
        delay=float(delays[d]) if sharp else np.nan,
        rise=float(RISES[r]) if sharp and np.ptp(rises) <= SHARP else np.nan,
        torque=mean if sharp and std <= TELLING * torque else np.nan,
        impulse=-float(x[0]), torque_error=-float(x[1]), torque_error_std=float(spread[1]) if sharp else np.inf,
    )  # fmt: skip


def _level(cost: Array, level: Array, precision: Array) -> tuple[float, float]:
    """Mean and standard deviation [N m] of a torque over all delays and rises (D, R), by how well each fits."""
    weight = np.exp(-0.5 * (cost - cost.min())) / np.sqrt(precision)
    weight /= weight.sum()
    mean = float(np.sum(weight * level))
    return mean, float(np.sqrt(np.sum(weight * ((level - mean) ** 2 + 1.0 / precision))))


def unit_ramps(t: Array, delays: Array, rises: Array) -> Array:
    """(D, R, K) impulse of a brake of 1 N m at ``t`` (K,), for every delay (D,) and rise (R,)."""
    x = np.maximum(t[None, None, :] - delays[:, None, None], 0.0)
    rise = rises[None, :, None]
    return np.where(x < rise, 0.5 * x * x / rise, x - 0.5 * rise)
