"""Plants made by hand for the core's stop proofs, and whole stops asked of the core itself."""

from __future__ import annotations

from typing import Any

import numpy as np

from stopset.core.library import ffi, given, lib, view
from stopset.reach.stops.expansion import curvature
from stopset.reach.stops.tube import Plant, plant_struct
from stopset.robot.rigid import Chain
from stopset.types import Array

UPRIGHT, LYING = (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)  # axes: gravity along them, or across


def bodies(mass: Array, at: Array, inertia: Array) -> Array:
    """(n, 10) of bodies with their centres ``at`` [m] along the link's x axis, ``inertia`` [kg m^2] about all axes of its frame."""
    pi = np.zeros((len(mass), 10))
    pi[:, 0], pi[:, 1] = mass, mass * at
    pi[:, 4] = pi[:, 6] = pi[:, 9] = inertia
    return pi


def chain_of(links: Array, axis: tuple[float, float, float]) -> Chain:
    """Parallel axes, ``links`` (n - 1,) [m] apart."""
    n = len(links) + 1
    p = np.zeros((n, 3))
    p[1:, 0] = links
    return Chain(np.tile(np.eye(3), (n, 1, 1)), p, np.tile(axis, (n, 1)), np.array([0.0, 0.0, -9.81]))


def plant_of(
    chain: Chain,
    pi: Array,
    rotor: Array,
    brake: Array,
    delay: float,
    rise: float,
    dry: float = 0.1,
    u: float = 0.0,
    spread: float = 0.0,
) -> Plant:
    """All known to ``spread``, torques u within +-``u`` [N m]."""
    n = len(rotor)

    def known(x: Array) -> tuple[Array, Array]:
        return x * (1.0 - spread), x * (1.0 + spread)

    none, push = np.zeros(n), np.full(n, u)
    return Plant(
        chain, pi, 0.0 * pi, rotor, none, *known(np.full(n, dry)), none, none, -push, push, *known(brake),
        *known(np.full(n, delay)), *known(np.full(n, rise)), curvature(chain, pi),
    )  # fmt: skip


def planar(seed: int) -> tuple[Plant, Array, Array, float, float]:
    """An arm of two or three parallel upright axes, heavy links on light rotors; pose, speeds, their radius, and a time step."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 4))
    chain = chain_of(0.3 * rng.uniform(0.3, 3.0, n - 1), UPRIGHT)
    mass, at = rng.uniform(0.2, 5.0, n), rng.uniform(0.05, 0.4, n)
    pi = bodies(mass, at, mass * at * at * rng.uniform(1.0, 1.6, n))
    rotor, brake, spread = 10.0 ** rng.uniform(-2.0, 0.5, n), 10.0 ** rng.uniform(-0.5, 1.3, n), rng.choice([0.0, 1e-3])
    delay = 10.0 ** rng.uniform(-4.0, -2.0)
    plant = plant_of(chain, pi, rotor, brake, delay, delay * rng.uniform(0.1, 1.0), u=rng.choice([0.0, 1e-3, 0.3]), spread=spread)
    q, dq, radius, h = (
        rng.uniform(-3.0, 3.0, n),
        rng.uniform(-2.0, 2.0, n),
        rng.choice([0.0, 1e-3]),
        10.0 ** rng.uniform(-3.0, -2.0),
    )
    return plant, q, dq, float(radius), float(h)


def power_off(plant: Plant, q: Array, dq: Array, radius: float = 0.0) -> Any:
    """The core's bound of one whole stop, (4, n): time, forward, back, speed; its code where there is none."""
    n = len(q)
    struct, held = plant_struct(plant)
    tool, work = np.zeros(3), np.empty(lib.stopset_stop_room(n))
    stops = ffi.new("StopsetStops *", (struct[0], ffi.NULL, -1.0, view(tool), ffi.NULL))
    out, two = np.empty((4, n)), np.empty(2)
    box = [given(x) for x in (q, dq, 0.0 * q, np.full(n, radius))]
    bound = ffi.new("StopsetBound *", (*(view(x) for x in out), view(two)))
    states = ffi.new("StopsetStates *", tuple(view(x) for x in box))
    code = lib.stopset_power_off(stops, states, view(work), bound)
    assert held
    return int(code) if code else out
