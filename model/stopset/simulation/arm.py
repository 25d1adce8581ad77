"""The simulated arm in motion: coupled dynamics, dry friction and brakes as sets, elastic gears, one compiled loop.

Coordinates are the ``n`` link angles followed by one motor angle per elastic joint; friction, brake and encoder of an
elastic joint sit on its motor.  Time stepping as in `stopset.simulation.stop`: midpoint for rigid body and springs,
trapezoid for viscous terms, exact sticking, and a step is split where a joint comes to rest or turns round.

Source: Moreau (1988); Spong (1987), Modeling and control of elastic joint robots; Al-Bender et al. (2005) for the
Maxwell slip elements.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stopset.core.library import check, ffi, given, integers, lib, view
from stopset.robot.rigid import arm_struct, gravity_torque
from stopset.simulation.plant import COLUMNS, ELEMENTS, SimulatedPlant, table
from stopset.types import Array


class Script(NamedTuple):
    """What the controller and the safety circuit do, tick by tick; ``K`` ticks, joint arrays (K, n)."""

    period: float  # [s] of control and recording; the torque is held in between
    feedforward: Array  # [N m] in reported units
    q: Array  # [rad] reference
    dq: Array  # [rad/s]
    kp: Array  # (n,) [N m/rad]
    kd: Array  # (n,) [N m s/rad]
    brake_at: int  # tick at which the brakes are told to close; K for never
    cut_at: int  # tick at which the motors lose power; K for never
    q_noise: Array  # [rad] added to the encoder's reading, in the loop too
    dq_noise: Array  # [rad/s]
    resolution: float  # [rad] of the encoder
    walk: Array  # [N m] wander of dry friction


class ArmState(NamedTuple):
    """Where the arm is; ``N`` = n + number of elastic joints."""

    x: Array  # (N,) [rad]
    v: Array  # (N,) [rad/s]
    rate: Array  # (N,) [rad/s^2] of the last piece
    slip: Array  # (n, ELEMENTS) [N m] forces of the Maxwell elements
    load: Array  # (n,) [N m] torque the gears transmit to the links
    temp: Array  # (n,) [degC]
    film: Array  # (n,) how much the drives' own losses have warmed their oil, as friction sees it


def motor_coordinates(plant: SimulatedPlant) -> NDArray[np.int64]:
    """(n,) the coordinate each joint's motor, friction and encoder belong to."""
    n = len(plant.fc)
    elastic = plant.stiffness > 0.0
    return np.where(elastic, n - 1 + np.cumsum(elastic), np.arange(n))


def start(plant: SimulatedPlant, q: Array, dq: Array, temp: Array) -> ArmState:
    """The arm with its *motors* at ``q, dq``; elastic gears carry the gravity torque already."""
    motor = motor_coordinates(plant)
    N = int(max(len(q), motor.max() + 1))
    x, v = np.zeros(N), np.zeros(N)
    g = gravity_torque(plant.chain, plant.pi, q)
    stiff = np.where(plant.stiffness > 0.0, plant.stiffness, np.inf)
    x[: len(q)], v[: len(q)] = q - g / stiff, dq
    x[motor], v[motor] = q, dq
    return ArmState(x, v, np.zeros(N), np.zeros((len(q), ELEMENTS)), np.abs(g), temp.copy(), np.zeros(len(q)))


def run(
    plant: SimulatedPlant, script: Script, s: ArmState, heating: Array, ambient: float, cooling: float, steps_per_tick: int
) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Play ``script`` on the arm from state ``s`` (which moves along); everything is logged at the start of each tick.

    ``heating`` (n,) [K/J], ``ambient`` [degC], ``cooling`` [1/s]: the joints' thermal balance.  Returns, (K, n) each:
    encoder reading [rad], its velocity [rad/s], motor torque as reported [N m] (held during the tick), temperature
    [degC], link angle [rad] and link velocity [rad/s] (the truth).
    """
    K, n = script.q.shape
    columns, motor = table(plant), motor_coordinates(plant)
    planned = [
        given(x)
        for x in (script.feedforward, script.q, script.dq, script.kp, script.kd, script.q_noise, script.dq_noise, script.walk)
    ]
    state = [view(x) for x in s]
    if columns.shape != (n, COLUMNS) or any(x.shape not in ((K, n), (n,)) for x in planned) or s.slip.shape != (n, ELEMENTS):
        raise ValueError(f"a plant of {columns.shape} and a script of {[x.shape for x in planned]} for {n} joints")
    body = arm_struct(plant.chain, plant.pi)
    arm = ffi.new(
        "StopsetSimArm *", (body[0], len(s.x), view(columns), integers(motor), *state)
    )  # fmt: skip
    f, q, dq, kp, kd, qn, dqn, walk = (view(x) for x in planned)
    played = ffi.new(
        "StopsetSimScript *",
        (K, steps_per_tick, script.period, f, q, dq, kp, kd, script.brake_at, script.cut_at, qn, dqn, walk, script.resolution),
    )  # fmt: skip
    logs, heats = np.empty((6, K, n)), given(heating)
    check(lib.stopset_sim_run(arm, played, ffi.new("StopsetSimHeat *", (view(heats), ambient, cooling)), view(logs)))
    return tuple(logs)  # type: ignore[return-value]
