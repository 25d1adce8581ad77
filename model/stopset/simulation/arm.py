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
from numba import njit
from numpy.typing import NDArray

from stopset.robot.rigid import Array, Chain, gravity_torque
from stopset.simulation.dynamics import WORK, mass_and_bias
from stopset.simulation.inclusion import first_crossing, solve_inclusion
from stopset.simulation.plant import (
    BRAKE_DELAY,
    BRAKE_RISE,
    BRAKE_TORQUE,
    DRAG,
    ECCENTRICITY,
    ECCENTRICITY_PHASE,
    ELEMENTS,
    ENCODER_OFFSET,
    FC,
    FILM_HEAT,
    FILM_TIME,
    FV,
    GAIN,
    LIMIT,
    PARTNER,
    PRESLIDING,
    REACH,
    RIPPLE,
    RIPPLE_ORDER,
    RIPPLE_PHASE,
    ROTOR,
    SHARES,
    SKEW,
    STIFFNESS,
    TWIST_DAMPING,
    WEAVE,
    Plant,
    coulomb,
    position_torque,
    table,
    viscous,
)  # fmt: skip
from stopset.simulation.stop import SMALLEST_PIECE, SPLITS_PER_JOINT, brake_impulse, crosses

BRAKES_OPEN = -1e9  # [s] since the brakes were told to close


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


class Body(NamedTuple):
    """A plant as the compiled loop sees it."""

    chain: Chain
    pi: Array
    T: Array  # (n, COLUMNS)
    motor: NDArray[np.int64]


class State(NamedTuple):
    """Where the arm is; ``N`` = n + number of elastic joints."""

    x: Array  # (N,) [rad]
    v: Array  # (N,) [rad/s]
    rate: Array  # (N,) [rad/s^2] of the last piece
    slip: Array  # (n, ELEMENTS) [N m] forces of the Maxwell elements
    load: Array  # (n,) [N m] torque the gears transmit to the links
    temp: Array  # (n,) [degC]
    film: Array  # (n,) how much the drives' own losses have warmed their oil, as friction sees it


class Scratch(NamedTuple):
    A: Array
    L: Array
    M: Array
    b: Array
    plus: Array
    minus: Array
    w: Array
    middle: Array
    speed: Array
    bias: Array
    work: Array
    mode: NDArray[np.int64]


def motor_coordinates(plant: Plant) -> NDArray[np.int64]:
    """(n,) the coordinate each joint's motor, friction and encoder belong to."""
    n = len(plant.fc)
    elastic = plant.stiffness > 0.0
    return np.where(elastic, n - 1 + np.cumsum(elastic), np.arange(n))


@njit(cache=True)
def scratch(n: int, N: int) -> Scratch:
    return Scratch(
        np.zeros((N, N)), np.zeros((N, N)), np.zeros((n, n)), np.zeros(N), np.zeros(N), np.zeros(N), np.zeros(N),
        np.zeros(N), np.zeros(N), np.zeros(n), np.zeros((n, WORK)), np.zeros(N, np.int64),
    )  # fmt: skip


def start(plant: Plant, q: Array, dq: Array, temp: Array) -> State:
    """The arm with its *motors* at ``q, dq``; elastic gears carry the gravity torque already."""
    motor = motor_coordinates(plant)
    N = int(max(len(q), motor.max() + 1))
    x, v = np.zeros(N), np.zeros(N)
    g = gravity_torque(plant.chain, plant.pi, q)
    stiff = np.where(plant.stiffness > 0.0, plant.stiffness, np.inf)
    x[: len(q)], v[: len(q)] = q - g / stiff, dq
    x[motor], v[motor] = q, dq
    return State(x, v, np.zeros(N), np.zeros((len(q), ELEMENTS)), np.abs(g), temp.copy(), np.zeros(len(q)))


@njit(cache=True)
def assemble(body: Body, s: State, c: Scratch, tau: Array, walk: Array, since: float, h: float) -> None:
    """Set up ``A, b, plus, minus`` of one piece of length ``h`` under motor torque ``tau`` (n,)."""
    T, motor, A, b, M, bias = body.T, body.motor, c.A, c.b, c.M, c.bias
    x, v, rate, slip, load, temp = s.x, s.v, s.rate, s.slip, s.load, s.temp
    plus, minus, middle, speed = c.plus, c.minus, c.middle, c.speed
    n, N = tau.shape[0], x.shape[0]
    for i in range(N):
        middle[i] = x[i] + 0.5 * h * v[i]
        speed[i] = v[i] + 0.5 * h * rate[i]
        plus[i] = minus[i] = 0.0
    mass_and_bias(body.chain, body.pi, middle[:n], speed[:n], c.work, M, bias)
    A[:, :] = 0.0
    A[:n, :n] = M
    for i in range(n):
        A[motor[i], motor[i]] += T[i, ROTOR]
    for i in range(N):
        b[i] = 0.0
        for j in range(N):
            b[i] += A[i, j] * v[j]
    for i in range(n):
        f, p = motor[i], motor[int(T[i, PARTNER])]
        b[i] -= h * (bias[i] + position_torque(T, i, middle[i]))
        ripple = 0.0
        if T[i, RIPPLE] != 0.0:
            angle = T[i, RIPPLE_ORDER] * middle[f] + T[i, RIPPLE_PHASE]
            ripple = T[i, RIPPLE] * (np.sin(angle) + 0.15 * np.sin(2.0 * angle))
        if T[i, WEAVE] != 0.0:
            ripple += T[i, WEAVE] * np.sin(3.0 * middle[f]) * speed[p]
        b[f] += h * (tau[i] - ripple)
        d = 0.5 * h * viscous(T, i, temp[i], speed[f])
        A[f, f] += d
        b[f] -= d * v[f]
        if T[i, DRAG] != 0.0:
            d = 0.5 * h * T[i, DRAG]
            A[f, p] += d
            A[p, f] += d
            b[f] -= d * v[p]
            b[p] -= d * v[f]
        if f != i:  # gear spring, implicit midpoint
            k = 0.25 * h * h * T[i, STIFFNESS] + 0.5 * h * T[i, TWIST_DAMPING]
            twist = h * T[i, STIFFNESS] * (x[f] - x[i]) + k * (v[f] - v[i])
            A[f, f] += k
            A[i, i] += k
            A[f, i] -= k
            A[i, f] -= k
            b[f] -= twist
            b[i] += twist
        force = coulomb(T, i, temp[i], speed[f], load[i], walk[i])
        reach = T[i, PRESLIDING]
        if reach > 0.0:
            for m in range(ELEMENTS):
                b[f] -= h * slipped(slip[i, m], middle[f] - x[f], force * SHARES[m], reach * REACH[m])
            force = 0.0
        grip = brake_impulse(since, h, T[i, BRAKE_DELAY], T[i, BRAKE_RISE], T[i, BRAKE_TORQUE])
        plus[f] = h * force * (1.0 + T[i, SKEW]) + grip
        minus[f] = h * force * (1.0 - T[i, SKEW]) + grip


@njit(cache=True)
def slipped(force: float, displacement: float, limit: float, reach: float) -> float:
    """Force [N m] of a spring-slider element after a displacement [rad]; it slides at ``limit``, after ``reach``."""
    return min(max(force + displacement * limit / reach, -limit), limit)


@njit(cache=True)
def advance(body: Body, s: State, c: Scratch, tau: Array, walk: Array, since: float, h: float) -> None:
    """Move the arm on by ``h`` [s] under constant motor torque; ``since`` [s]: when the brakes were told to close."""
    T, motor, mode, w = body.T, body.motor, c.mode, c.w
    x, v, rate, slip, load = s.x, s.v, s.rate, s.slip, s.load
    n, N = tau.shape[0], x.shape[0]
    left, splits = h, 0
    while left > 0.0:
        piece, event = left, -1
        while True:
            assemble(body, s, c, tau, walk, since, piece)
            for i in range(N):
                if v[i] != 0.0:
                    mode[i] = 1 if v[i] > 0.0 else -1
            solve_inclusion(c.A, c.b, c.plus, c.minus, mode, w, c.L)
            if event >= 0 or splits >= SPLITS_PER_JOINT * N or not crosses(v, w, c.plus, c.minus):
                break
            share, event = first_crossing(c.A, c.b, c.plus, c.minus, v, w, c.L, mode)
            splits = splits + 1 if event >= 0 else SPLITS_PER_JOINT * N
            piece = max(share, SMALLEST_PIECE) * left
        if event >= 0:
            w[event], mode[event] = 0.0, 0
        for i in range(n):
            reach = T[i, PRESLIDING]
            if reach > 0.0:
                f = motor[i]
                force = coulomb(T, i, s.temp[i], w[f], load[i], walk[i])
                moved = 0.5 * piece * (v[f] + w[f])
                for m in range(ELEMENTS):
                    slip[i, m] = slipped(slip[i, m], moved, force * SHARES[m], reach * REACH[m])
        for i in range(N):
            x[i] += 0.5 * piece * (v[i] + w[i])
            rate[i] = (w[i] - v[i]) / piece
            v[i] = w[i]
        for i in range(n):
            load[i] = c.bias[i]
            for j in range(n):
                load[i] += c.M[i, j] * rate[j]
        since += piece
        left = 0.0 if left - piece < SMALLEST_PIECE * h else left - piece


@njit(cache=True)
def encoder(T: Array, i: int, x: float) -> float:
    """What the encoder of joint ``i`` says at motor angle ``x`` (link side) before noise and resolution."""
    out = x + T[i, ENCODER_OFFSET]
    if T[i, ECCENTRICITY] != 0.0:
        out += T[i, ECCENTRICITY] * np.sin(x + T[i, ECCENTRICITY_PHASE])
    return float(out)


def run(
    plant: Plant, script: Script, s: State, heating: Array, ambient: float, cooling: float, steps_per_tick: int
) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Play ``script`` on the arm from state ``s`` (which moves along); everything is logged at the start of each tick.

    ``heating`` (n,) [K/J], ``ambient`` [degC], ``cooling`` [1/s]: the joints' thermal balance.  Returns, (K, n) each:
    encoder reading [rad], its velocity [rad/s], motor torque as reported [N m] (held during the tick), temperature
    [degC], link angle [rad] and link velocity [rad/s] (the truth).
    """
    body = Body(plant.chain, plant.pi, table(plant), motor_coordinates(plant))
    return _run(body, script, s, heating, ambient, cooling, steps_per_tick)


@njit(cache=True)
def _run(
    body: Body, script: Script, s: State, heating: Array, ambient: float, cooling: float, steps_per_tick: int
) -> tuple[Array, Array, Array, Array, Array, Array]:
    K, n = script.q.shape
    T, motor = body.T, body.motor
    cold = T[:, FC : FV + 1].copy()
    c = scratch(n, s.x.shape[0])
    q_log, dq_log, tau_log = np.empty((K, n)), np.empty((K, n)), np.empty((K, n))
    temp_log, link_log, speed_log = np.empty((K, n)), np.empty((K, n)), np.empty((K, n))
    tau = np.zeros(n)
    h = script.period / steps_per_tick
    for k in range(K):
        for i in range(n):
            T[i, FC], T[i, FV] = cold[i] / (1.0 + s.film[i])
            f = motor[i]
            reading = encoder(T, i, s.x[f]) + script.q_noise[k, i]
            if script.resolution > 0.0:
                reading = np.round(reading / script.resolution) * script.resolution
            scale = 1.0 + T[i, ECCENTRICITY] * np.cos(s.x[f] + T[i, ECCENTRICITY_PHASE])
            speed = s.v[f] * scale + script.dq_noise[k, i]
            command = script.feedforward[k, i]
            command += script.kp[i] * (script.q[k, i] - reading) + script.kd[i] * (script.dq[k, i] - speed)
            command = min(max(command, -T[i, LIMIT]), T[i, LIMIT])
            if k >= script.cut_at:
                command = 0.0
            tau[i] = command * T[i, GAIN]
            q_log[k, i], dq_log[k, i], tau_log[k, i] = reading, speed, command
            temp_log[k, i], link_log[k, i], speed_log[k, i] = s.temp[i], s.x[i], s.v[i]
        since = (k - script.brake_at) * script.period if k >= script.brake_at else BRAKES_OPEN
        for step in range(steps_per_tick):
            advance(body, s, c, tau, script.walk[k], since + step * h, h)
        for i in range(n):
            v = abs(s.v[motor[i]])
            power = v * (T[i, FC] + T[i, FV] * v)
            s.temp[i] += script.period * (heating[i] * power - cooling * (s.temp[i] - ambient))
            s.film[i] += script.period / T[i, FILM_TIME] * (T[i, FILM_HEAT] * power - s.film[i])
    return q_log, dq_log, tau_log, temp_log, link_log, speed_log
