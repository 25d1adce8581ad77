"""A cell of somebody else's simulator, as its logger writes it: arms, controllers, motions, sensors, a pedestal, and the description of it all.

Arms of four, six and seven joints of the independent simulator, which shares no code with stopset (`independent_arm`), described with masses 5 to
10 % off, under one of three controllers (feed-forward and PD, computed torque, a velocity loop within a position loop) that run at 500 Hz
on what encoders of a certain step read; a logger writes CSV: motor torque in steps, filtered or not, speeds derived.  A production program
(pick and place, some paths again and again), circles, sweeps or one trajectory.  Friction warms within the file.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from independent_arm import Arm, Array, about_origin, centred, frames, mass_matrix, newton_euler
from independent_motions import Generator
from independent_plant import (
    BUMP_WIDTH,
    COLUMNS,
    DAHL,
    DAMP,
    FC_NEG,
    FC_POS,
    FV,
    OFFSET,
    PLAY,
    RES_WIDTH,
    ROCKS,
    ROCKS_ABOUT,
    STIFF,
    V_S,
    friction,
    position_torque,
    solve,
)
from independent_sets import Truth, urdf
from numba import njit

Z, Y, X = (0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)
TICK, SUBSTEPS = 0.002, 4  # [s] a controller's cycle, and steps of the plant in it
CONTROLLERS = ("forward", "computed", "velocity")
KINDS = ("program", "circles", "sweep", "trajectory")
WARMS = 120.0  # [s] a drive's time constant
# arms: per joint axis, way from the joint before [m], mass [kg], centre [m], torque limit [N m], gear ratio
ARMS = {
    "bench": ((Z, (0, 0, 0.09), 1.1, (0, 0, 0.05), 22, 100), (Y, (0, 0, 0.1), 1.6, (0, 0.03, 0.11), 22, 100),
              (Y, (0, 0, 0.22), 1.0, (0, -0.02, 0.1), 14, 80), (Y, (0, 0, 0.2), 0.5, (0.01, 0, 0.05), 6, 80)),
    "six": ((Z, (0, 0, 0.15), 6.5, (0, 0.02, 0.06), 150, 100), (Y, (0, 0.1, 0.1), 10.5, (0, 0.06, 0.19), 150, 100),
            (Y, (0, 0, 0.42), 5.2, (0, -0.03, 0.17), 110, 100), (Y, (0, 0, 0.38), 2.2, (0, 0.03, 0.01), 40, 100),
            (Z, (0, 0.1, 0), 2.0, (0, 0.01, 0.02), 32, 100), (Y, (0, 0, 0.1), 0.8, (0, 0.03, 0), 28, 100)),
    "cobot": ((Z, (0, 0, 0.33), 3.9, (0, -0.02, -0.05), 87, 100), (Y, (0, 0, 0), 3.1, (0, -0.02, 0.09), 87, 100),
              (Z, (0, 0, 0.3), 3.2, (0.03, 0.03, -0.05), 87, 100), (Y, (0.08, 0, 0), 3.0, (-0.04, 0.03, 0.06), 87, 100),
              (Z, (-0.08, 0, 0.38), 2.4, (0, 0.03, -0.1), 40, 100), (Y, (0, 0, 0), 1.7, (0.05, 0, 0.02), 40, 100),
              (Z, (0.09, 0, 0), 0.9, (0.01, 0, 0.09), 40, 100)),
}  # fmt: skip


@dataclass(frozen=True)
class Cell:
    """How an arm is moved and recorded: ``tick`` [rad] of an encoder, ``lsb`` [N m] (n,) of the torque, which ``cut`` [Hz] filters (0: not),
    ``gain`` (n,) true over recorded torque, stamps that ``scatter`` [s], a ``lost`` share, ``warms``: the share of viscous friction that is gone
    once it is warm, ``drift`` (n,) [N m] of the torque sensor."""

    controller: str
    kind: str
    rate: float
    tick: float
    lsb: Array
    cut: float
    gain: Array
    scatter: float
    lost: float
    warms: float
    drift: Array
    noise: Array


def arm_of(name: str, rng: Generator) -> Arm:
    """One of the arms, of another size and build each time."""
    rows, s = ARMS[name], float(rng.uniform(0.85, 1.2))
    pi, limit, gear = [], [], []
    for k, (_, _, mass, centre, most, ratio) in enumerate(rows):
        m, c = mass * s**2.5 * float(rng.uniform(0.9, 1.1)), s * np.array(centre) + rng.normal(0, 0.003, 3)
        far = s * np.array(rows[k + 1][1] if k + 1 < len(rows) else (0, 0, 0.06))
        wide = 0.05 * s + 0.25 * np.linalg.norm(far)
        pi.append(about_origin(m, c, m * np.diag([wide**2, wide**2, (0.05 * s) ** 2]) * 0.6))
        limit.append(most * s**3)
        gear.append(ratio)
    limits = np.array(limit)
    return Arm(
        name, tuple(f"{name}_{k + 1}" for k in range(len(rows))), np.tile(np.eye(3), (len(rows), 1, 1)),
        s * np.array([r[1] for r in rows], float), np.array([r[0] for r in rows]), np.array(pi),
        0.006 * limits * rng.uniform(0.7, 1.4, len(rows)), limits, np.array(gear, float), np.array([0.0, 0.0, -9.81]),
    )  # fmt: skip


def truth_of(name: str, seed: int) -> Truth:
    """A healthy arm, with a little Stribeck friction, and a description whose masses are 5 to 10 % off."""
    rng = np.random.default_rng([seed, 1])
    arm = arm_of(name, rng)
    off = []
    for row in arm.pi:
        m, c, J = centred(row)
        f = 1 + rng.choice([-1, 1]) * rng.uniform(0.05, 0.1)
        off.append(about_origin(m * f, c + rng.normal(0, 0.003, 3), J * f))
    described = replace(arm, pi=np.array(off), rotor=arm.rotor * rng.uniform(0.9, 1.1, arm.n))
    T = np.zeros((arm.n, COLUMNS))
    fc = 0.05 * arm.limit * rng.uniform(0.7, 1.4, arm.n)
    T[:, FC_POS] = T[:, FC_NEG] = fc
    T[:, FV] = fc * rng.uniform(0.5, 1.5, arm.n)
    T[:, [V_S, RES_WIDTH, BUMP_WIDTH]] = 1.0
    n = arm.n
    return Truth(arm, described, T, np.zeros((n, n)), np.ones(n), np.zeros(n), np.zeros((n, 2)), 0.01 * fc, np.zeros(n),
                 np.full(n, 1.4), seed)  # fmt: skip


# -- motions ------------------------------------------------------------------------------------------------------------


def motion(kind: str, n: int, fast: float, rng: Generator, seconds: float = 30.0) -> Array:
    """(N, n) positions at 500 Hz."""
    t = np.arange(round(seconds / TICK)) * TICK
    rise = np.clip(t / 1.5, 0, 1)[:, None]
    rise = rise**3 * (10 - 15 * rise + 6 * rise * rise)
    middle = rng.uniform(-0.5, 0.5, n)
    if kind == "program":
        return _program(n, fast, rng, len(t))
    if kind == "circles":  # two circles of the tool, one after the other: every joint a sine and its second harmonic
        w = np.repeat(rng.uniform(1.0, 1.8, 2), len(t) // 2)
        turn = np.cumsum(w)[:, None] * TICK
        a, b, p = rng.uniform(0.25, 0.6, n), rng.uniform(0.02, 0.12, n), rng.uniform(0, 6.28, (2, n))
        return np.asarray(middle + fast * rise * (a * np.sin(turn + p[0]) + b * np.sin(2 * turn + p[1])))
    if kind == "sweep":  # one slow to fast sine, joints out of step
        f0, f1 = rng.uniform(0.05, 0.1), rng.uniform(0.3, 0.6)
        phase = 2 * np.pi * (f0 * t + (f1 - f0) / (2 * seconds) * t * t)
        ratio, p = rng.uniform(0.6, 1.3, n), rng.uniform(0, 6.28, n)
        a = fast * rng.uniform(0.6, 1.0, n) / (1.0 + 4.0 * f1 * np.linspace(0, 1, len(t)))[:, None]
        return np.asarray(middle + rise * a * np.sin(phase[:, None] * ratio + p))
    k = np.arange(1, 6)[:, None]
    a, b = rng.normal(size=(2, 5, n)) / k
    angle = 2 * np.pi * 0.1 * k.T * t[:, None]
    f = np.sin(angle) @ a + np.cos(angle) @ b - b.sum(axis=0)
    f /= np.abs(f).max(axis=0)
    return np.asarray(middle + rise * fast * rng.uniform(0.5, 1.0, n) * f)


def _program(n: int, fast: float, rng: Generator, samples: int) -> Array:
    """Pick and place: above, down, up, across, down, up; the same four to six places in turn, short waits."""
    places = [rng.uniform(-1.1, 1.1, n) for _ in range(int(rng.integers(2, 4)))]
    downs = [p + rng.uniform(-0.25, 0.25, n) for p in places]
    way = [q for p, d in zip(places, downs, strict=True) for q in (p, d, p)]
    q = [np.repeat(way[0][None], 150, axis=0)]
    total, k = 150, 0
    while total < samples:
        a, b = way[k % len(way)], way[(k + 1) % len(way)]
        far = float(np.abs(b - a).max())
        k += 1
        if far < 1e-9:
            continue
        steps = max(150, round(1.9 * far / (1.4 * fast) / TICK))
        x = np.linspace(0, 1, steps)[:, None]
        q.append(a + (b - a) * x**3 * (10 - 15 * x + 6 * x * x))
        wait = int(rng.integers(40, 200))
        q.append(np.repeat(b[None], wait, axis=0))
        total += steps + wait
    return np.concatenate(q)[:samples]


# -- controller and plant -----------------------------------------------------------------------------------------------


@njit(cache=True)
def run(mode, R0, p, axis, pi, rotor, gravity, T, C, known, drotor, fc, fv, limit, qd, tick, warm, cutoff):  # type: ignore[no-untyped-def]
    """(N, n) what the controller reads as positions and speeds, and the torque that its motors give; ``known``: links as described."""
    N, n = qd.shape
    h = TICK / SUBSTEPS
    q, dq, th, dth = qd[0].copy(), np.zeros(n), qd[0].copy(), np.zeros(n)
    F, total, speed, last = np.zeros(n), np.zeros(n), np.zeros(n), np.round(qd[0] / tick) * tick
    Q, V, U = np.empty((N, n)), np.empty((N, n)), np.empty((N, n))
    R, W, M, B = np.empty_like(R0), np.empty((10 + 2 * n, 3)), np.empty((n, n)), np.empty((n, 10))
    zero, bias, load, tau, want = np.zeros(n), np.empty(n), np.zeros(n), np.zeros(n), np.zeros(n)
    frames(R0, axis, q, R)
    mass_matrix(R, p, axis, known, M, W, B)
    inertia = np.empty(n)
    for i in range(n):
        inertia[i] = M[i, i] + drotor[i]
    newton_euler(R, p, axis, pi, gravity, zero, zero, total, W)
    for i in range(n):
        if T[i, STIFF] > 0:
            q[i] = th[i] - total[i] / T[i, STIFF]
    for k in range(N):
        a, b = max(k - 1, 0), min(k + 1, N - 1)
        read = np.round(th / tick) * tick
        speed += cutoff * ((read - last) / TICK - speed)
        last = read
        v, acc = (qd[b] - qd[a]) / (TICK * max(b - a, 1)), (qd[b] - 2 * qd[k] + qd[a]) / TICK**2
        if mode == 1:  # computed torque
            want[:] = acc + 400.0 * (qd[k] - read) + 36.0 * (v - speed)
            frames(R0, axis, read, R)
            newton_euler(R, p, axis, known, gravity, speed, want, tau, W)
            tau += drotor * want + fc * np.tanh(v / 0.02) + fv * v
        elif mode == 0:  # feed-forward and PD
            frames(R0, axis, qd[k], R)
            newton_euler(R, p, axis, known, gravity, v, acc, tau, W)
            tau += drotor * acc + fc * np.tanh(v / 0.02) + inertia * (600.0 * (qd[k] - read) + 40.0 * (v - speed))
        else:  # a velocity loop with an integral within a position loop; no model
            e = v + 12.0 * (qd[k] - read) - speed
            total += 40.0 * inertia * 12.0 * e * TICK
            tau[:] = 40.0 * inertia * e + total
        for i in range(n):
            tau[i] = min(max(tau[i], -limit[i]), limit[i])
        Q[k], V[k], U[k] = read, speed, tau
        for _ in range(SUBSTEPS):
            frames(R0, axis, q, R)
            newton_euler(R, p, axis, pi, gravity, zero, zero, load, W)
            newton_euler(R, p, axis, pi, gravity, dq, zero, bias, W)
            mass_matrix(R, p, axis, pi, M, W, B)
            net = -bias
            for i in range(n):
                f, slope = friction(T[i], dth[i], th[i], 0.0, load[i], 1.0, warm[k], F[i])
                f += position_torque(T[i], th[i])
                for j in range(n):
                    f += C[i, j] * dth[j]
                if T[i, STIFF] > 0:
                    bend = th[i] - q[i]
                    bend -= min(max(bend, -0.5 * T[i, PLAY]), 0.5 * T[i, PLAY])
                    g = T[i, STIFF] * bend + T[i, DAMP] * (dth[i] - dq[i])
                    dth[i] += h * (tau[i] - f - g) / (rotor[i] + h * slope)
                    net[i] += g
                else:
                    net[i] += tau[i] - f
                    M[i, i] += rotor[i] + h * slope
            solve(M, net)
            for i in range(n):
                dq[i] += h * net[i]
                q[i] += h * dq[i]
                if T[i, STIFF] > 0:
                    th[i] += h * dth[i]
                else:
                    th[i], dth[i] = q[i], dq[i]
                if T[i, DAHL] > 0:
                    side = np.sign(dth[i])
                    F[i] = side * T[i, FC_POS] + (F[i] - side * T[i, FC_POS]) * np.exp(
                        -T[i, DAHL] / T[i, FC_POS] * abs(dth[i]) * h
                    )
    return Q, V, U


FOOT, PEDESTAL = 0.5, 15.0  # [m] below the arm's base, where its pedestal rocks, and the pedestal's mass [kg]


def on_a_pedestal(truth: Truth) -> tuple[Arm, Arm, Array, Array]:
    """The arm, as it is and as its controller knows it, with a first joint that nothing moves but what bends it; tables of friction and coupling.

    Its motor is one that nothing turns, its gear what gives: `ROCKS` [Hz] with the arm's mass at 0.8 m, damped by 4 %.
    """
    rocks, about = truth.T[0, [ROCKS, ROCKS_ABOUT]]
    mass = PEDESTAL + float(truth.arm.pi[:, 0].sum())
    own = about_origin(PEDESTAL, np.array([0, 0, FOOT / 2]), PEDESTAL * 0.03 * np.eye(3))
    row = np.zeros(COLUMNS)
    row[[V_S, RES_WIDTH, BUMP_WIDTH]] = 1.0
    K = (2 * np.pi * rocks) ** 2 * mass * 0.8**2
    row[[STIFF, DAMP]] = K, 0.08 * K / (2 * np.pi * rocks)

    def above(a: Arm) -> Arm:
        p = np.insert(a.p, 0, 0.0, axis=0)
        p[1, 2] += FOOT
        return replace(
            a, joints=("foot", *a.joints), R0=np.insert(a.R0, 0, np.eye(3), axis=0), p=p, pi=np.insert(a.pi, 0, own, axis=0),
            axis=np.insert(a.axis, 0, (np.cos(about), np.sin(about), 0.0), axis=0), rotor=np.insert(a.rotor, 0, 1e9),
            limit=np.insert(a.limit, 0, 1.0), gear=np.insert(a.gear, 0, 1.0),
        )  # fmt: skip

    return above(truth.arm), above(truth.described), np.insert(truth.T, 0, row, axis=0), np.pad(truth.C, ((1, 0), (1, 0)))


def recorded(truth: Truth, cell: Cell, folder: Path, name: str, rng: Generator) -> Path:
    """One file: what a logger wrote of 30 s, and the description it was driven by."""
    a, d = truth.arm, truth.described
    fast = float(rng.uniform(0.6, 1.0)) * (1.0 if a.n < 6 else 0.9)
    q = motion(cell.kind, a.n, fast, rng)
    warm = 1 - cell.warms * (1 - np.exp(-np.arange(len(q)) * TICK / WARMS))
    T, C, first = truth.T, truth.C, 0
    if T[0, ROCKS]:
        (a, d, T, C), q, first = on_a_pedestal(truth), np.insert(q, 0, 0.0, axis=1), 1
    Q, V, U = run(
        CONTROLLERS.index(cell.controller), a.R0, a.p, a.axis, a.pi, a.rotor, a.gravity, T, C, d.pi, d.rotor,
        0.8 * T[:, FC_POS], 0.8 * T[:, FV], a.limit, q, cell.tick, warm, 1 - np.exp(-2 * np.pi * 60 * TICK),
    )  # fmt: skip
    Q, V, U, q, a = Q[:, first:], V[:, first:], U[:, first:], q[:, first:], truth.arm
    if not np.abs(Q - q).max() < 0.3:
        raise RuntimeError(f"the controller lost the arm: {np.abs(Q - q).max(axis=0)}")
    t = np.arange(len(Q)) * TICK
    tau = np.stack([np.interp(t - late, t, U[:, j]) for j, late in enumerate(truth.delay)], axis=1) / (truth.gain * cell.gain)
    tau = tau + truth.T[:, OFFSET]
    if cell.cut:
        share = 1 - np.exp(-2 * np.pi * cell.cut * TICK)
        for k in range(1, len(tau)):
            tau[k] = tau[k - 1] + share * (tau[k] - tau[k - 1])
    tau = tau + cell.noise * rng.normal(size=tau.shape) + cell.drift * (t[:, None] / t[-1] - 0.5)
    tau = np.round(tau / cell.lsb) * cell.lsb
    here = slice(None, None, round(1 / (cell.rate * TICK)))
    keep = rng.random(len(t[here])) >= cell.lost
    stamps = np.maximum.accumulate(t[here] + cell.scatter * rng.normal(size=len(t[here])))[keep] + 1e-9 * np.arange(keep.sum())
    columns = np.column_stack([stamps, Q[here][keep], V[here][keep], tau[here][keep]])
    head = ["t", *(f"{k}_{j}" for k in ("q", "dq", "tau") for j in a.joints)]
    path = folder / f"{name}.csv"
    np.savetxt(path, columns, "%.9g", ",", header=",".join(head), comments="")
    return path


def described(truth: Truth, folder: Path) -> Path:
    """``robot.urdf`` and, as data sheets have it, rotors in ``robot.json``."""
    d = truth.described
    (folder / "robot.urdf").write_text(urdf(d))
    joints = {
        name: {"gear_ratio": int(d.gear[j]), "motor_inertia_kgm2": float(d.rotor[j] / d.gear[j] ** 2), "torque_limit_Nm": float(d.limit[j])}
        for j, name in enumerate(d.joints)
    }  # fmt: skip
    (folder / "robot.json").write_text(json.dumps({"robot": d.name, "joints": joints}))
    return folder / "robot.urdf"
