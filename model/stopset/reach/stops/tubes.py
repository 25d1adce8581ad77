"""Tubes of STOP 0 for a measured state: the time step, the cutting into pieces, and when each joint has stopped."""

from __future__ import annotations

import numpy as np

from stopset.core.library import lib
from stopset.reach.stops.parts import ALL_PARTS, Parts
from stopset.reach.stops.plant import Setting
from stopset.reach.stops.split import certify
from stopset.reach.stops.tube import OK, UNBOUNDED, Plant, Tube, march
from stopset.reach.stops.windows import windows
from stopset.robot.rigid import Array, gravity_torque
from stopset.sets import Box

KNOTS = 200  # time steps over the expected stop; the bound's time is coarse by one of them
FAST_KNOTS: int = lib.STOPSET_STOP_KNOTS  # of a certificate that a fast loop renews: bounds under 1 % wider, in half the time
FAST_ENERGY_KNOTS: int = (
    lib.STOPSET_STOP_ENERGY_KNOTS
)  # where the kinetic energy has to help in a fast loop: a third wider, in a fifth of the time
FAST_WINDOWS: int = (
    lib.STOPSET_STOP_WINDOWS
)  # of the brakes' common delay in a fast loop: half the angle of one where the energy has to help
REGIONS = 4  # that a tube is tried in, each larger than what the last led to
PATIENCE: int = lib.STOPSET_STOP_PATIENCE  # times the expected stop before a tube is called endless
MORE_PATIENCE: int = lib.STOPSET_STOP_MORE_PATIENCE  # where the kinetic energy bounds it: that takes longer


def expected_stop(plant: Plant, q: Array, speed: Array) -> float:
    """Rough length of a stop [s], to choose the time step: engagement plus the slowest joint's deceleration."""
    engaged = float(np.max(plant.delay_hi + plant.rise_hi))
    M = plant.rotor + np.maximum(1e-3, np.abs(plant.pi[:, 0]) * 0.1)
    authority = plant.brake_lo + plant.coulomb_lo - np.abs(gravity_torque(plant.chain, plant.pi, q))
    authority = np.maximum(authority, 0.2 * plant.brake_lo + 1e-6)
    return engaged + float(np.min([0.5, np.max(np.abs(speed) * M / authority)]))


def march_box(
    setting: Setting, plant: Plant, q: Array, dq: Array, q_radius: Array, dq_radius: Array, energetic: bool,
    parts: Parts = ALL_PARTS, knots: int = KNOTS,
) -> Tube:  # fmt: skip
    """One tube of ``plant`` from the box ``q +- q_radius, dq +- dq_radius`` (angles [rad], speeds [rad/s], (n,) each).

    Where effects depend on pose or speed, they are those of a region that the stop must not leave: a continuous motion that
    stays inside while it has not left cannot leave.  So a tube counts once it lies inside its region, else that grows.
    """
    fast = np.abs(dq) + dq_radius
    lasts = expected_stop(setting.plant, q, fast)
    steps = knots * (MORE_PATIENCE if energetic else PATIENCE)
    way, known = 1.1 * lasts * fast + 0.01, setting.torques.speed
    fast = np.where(fast < known, np.minimum(1.05 * fast + 0.05, known), 1.05 * fast + 0.05)
    for _ in range(REGIONS):
        region = setting.near(plant, Box(q - q_radius - way, q + q_radius + way), fast)
        tube: Tube = march(
            region, q - q_radius, q + q_radius, dq - dq_radius, dq + dq_radius, lasts / knots, steps, parts, energetic
        )
        if setting.torques.settled or tube.end != OK:
            return tube
        moved = np.maximum(tube.d_hi.max(axis=0), -tube.d_lo.min(axis=0))
        if np.all(moved < way) and np.all(fastest(tube) < fast):
            return tube
        way, fast = np.maximum(way, 1.3 * moved), np.maximum(fast, 1.1 * fastest(tube))
    return tube._replace(end=UNBOUNDED)


def fastest(tube: Tube) -> Array:
    """(n,) [rad/s] largest speed of a tube, between its knots too."""
    knots = np.maximum(np.abs(tube.v_lo), np.abs(tube.v_hi)).max(axis=0)
    out: Array = np.maximum(knots, np.maximum(np.abs(tube.e_lo), np.abs(tube.e_hi)).max(axis=0))
    return out


def tube_of(
    setting: Setting, q: Array, dq: Array, q_radius: Array, dq_radius: Array, parts: Parts = ALL_PARTS, knots: int = KNOTS,
) -> Tube:  # fmt: skip
    """The STOP 0 tube from a box, as tight as one tube gets; it may not come to rest."""
    return march_box(setting, setting.plant, q, dq, q_radius, dq_radius, False, parts, knots)


def tubes_of(
    setting: Setting, q: Array, dq: Array, q_radius: Array, dq_radius: Array, pieces: int, parts: Parts = ALL_PARTS,
    last_resort: bool = True, fast: bool = False,
) -> list[Tube]:  # fmt: skip
    """Tubes that together hold all stops from the box; the last is not OK if that failed.

    Up to ``pieces`` of them, for every window of the brakes' common delay; with one piece the delays are taken as independent.
    ``last_resort``: whether the kinetic energy may have to bound it; ``fast``: few windows and coarse steps, for a loop.
    """
    lasts = expected_stop(setting.plant, q, np.abs(dq) + dq_radius)

    knots = (FAST_KNOTS, FAST_ENERGY_KNOTS) if fast else (KNOTS, KNOTS)

    def one(plant: Plant, energetic: bool) -> Tube:
        return march_box(setting, plant, q, dq, q_radius, dq_radius, energetic, parts, knots[energetic])

    out: list[Tube] = []
    # the latest brakes are the hardest: what cannot be proved is known at once
    apart = setting.apart if pieces > 1 or fast else None
    for plant in reversed(windows(setting.plant, apart, setting.lag, FAST_WINDOWS if fast else None)):
        out += certify(one, plant, q, lasts, pieces, last_resort)
        if out[-1].end != OK:
            break
    return out


def stopped_after(tube: Tube) -> Array:
    """(n,) [s]: the first knot from which each joint's speed bounds are zero."""
    moving = (tube.v_lo != 0.0) | (tube.v_hi != 0.0)
    # the momenta may show that a joint rests at a knot, having moved since the one before
    moving[:-1] |= (tube.e_lo != 0.0) | (tube.e_hi != 0.0)
    last = np.where(moving.any(axis=0), len(tube.t) - 1 - np.argmax(moving[::-1], axis=0), -1)
    after: Array = tube.t[np.minimum(last + 1, len(tube.t) - 1)]
    return after
