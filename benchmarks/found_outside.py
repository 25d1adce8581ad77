"""Recordings as found, as somebody else's simulator makes them: other plants, controllers, sensors, motions and arms than `found_pairs.py` has.

Arms of four, six and seven joints of the independent simulator, which shares no code with stopset (`independent_arm`), described with masses 5 to
10 % off, under one of three controllers (feed-forward and PD, computed torque, a velocity loop within a position loop) that run at 500 Hz
on what encoders of a certain step read; a logger of 100 or 125 Hz writes CSV: motor torque in steps, filtered or not, speeds derived.  A
production program (pick and place, some paths again and again), circles, sweeps or one trajectory.  Friction warms within the file; torque
constants are off one by one; weeks later friction is another by some percent.

    python benchmarks/found_outside.py ask --seed 117000 --count 14 --out OUT [--healthy | --others]
    python benchmarks/found_outside.py rate --out OUT
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from found_pairs import FRICTION, NONE, Case, judged, rate
from independent_arm import Arm, Array, about_origin, centred, frames, mass_matrix, newton_euler
from independent_effects import EFFECTS
from independent_hidden import Hidden, between, put
from independent_motions import Generator
from independent_outside import OUTSIDE
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

from stopset.errors import StopsetError
from stopset.offline.campaign.source import Campaign
from stopset.offline.description import load_robot
from stopset.offline.diagnose import diagnose_model
from stopset.offline.identify.pipeline import Settings, identified
from stopset.progress import silent
from stopset.recording import Recordings, read_recordings

Z, Y, X = (0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)
TICK, SUBSTEPS = 0.002, 4  # [s] a controller's cycle, and steps of the plant in it
CONTROLLERS = ("forward", "computed", "velocity")
KINDS = ("program", "circles", "sweep", "trajectory")
HEALTHY, PAIR, ODDS, PEDESTALS = 0.35, 0.6, 0.35, 0.15
WARMS = 120.0  # [s] a drive's time constant
WARM = ("self_heating", "warm_up")  # what warms is no false name of that
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


# -- cases --------------------------------------------------------------------------------------------------------------

# hardware sizes for the independent simulator's own laws: of (truth, joint, u in 0..1)
SIZES: dict[str, Callable[[Truth, int, float], float]] = {
    "stribeck": lambda t, j, u: (0.25 + 0.35 * u) * float(t.T[j, FC_POS]),
    "load_coulomb": lambda t, j, u: 0.06 + 0.08 * u,
    "asymmetric_coulomb": lambda t, j, u: 0.1 + 0.15 * u,
    "payload": lambda t, j, u: (0.06 + 0.08 * u) * float(t.arm.pi[:, 0].sum()) * 0.6,
    "elasticity": lambda t, j, u: 1 / ((30 + 50 * u) * float(t.arm.limit[j])),
    "torque_ripple": lambda t, j, u: (0.15 + 0.2 * u) * float(t.T[j, FC_POS]),
    "hysteresis": lambda t, j, u: 0.008 + 0.012 * u,
    "torque_gain": lambda t, j, u: 0.08 + 0.08 * u,
    "delay": lambda t, j, u: 0.01 + 0.012 * u,
    "base_tilt": lambda t, j, u: 0.025 + 0.03 * u,
    "spring": lambda t, j, u: (0.25 + 0.35 * u) * float(t.T[j, FC_POS]),
    "coupling": lambda t, j, u: (0.2 + 0.2 * u) * float(t.T[j, FC_POS]),
}


def _worn(t: Truth, j: int, x: float, u: Array) -> Truth:
    return put(t, j, **{k: x * float(t.T[j, c]) for k, c in (("FC_POS", FC_POS), ("FC_NEG", FC_NEG), ("FV", FV))})


def _much(t: Truth, j: int, u: float) -> float:
    return 1.25 + 0.3 * u


WORN = Hidden(_worn, lambda t, j: 1.2, lambda t, j: 1.6)


def _play(t: Truth, j: int, x: float, u: Array) -> Truth:
    K = 800.0 * float(t.arm.limit[j])
    return put(t, j, PLAY=x, STIFF=K, DAMP=0.4 * np.sqrt(K * t.arm.rotor[j]))


def _hidden(apply: Callable[[Truth, int, float, Array], Truth]) -> Hidden:
    return Hidden(apply, *between(0.0, 1.0))


# what `SIZES` lack, as ``--others`` draws them: law and size
OTHERS: dict[str, tuple[Hidden, Callable[[Truth, int, float], float]]] = {
    "counterbalance": (
        _hidden(lambda t, j, x, u: put(t, j, GAS=x, GAS_Q0=2.0 + 2.2 * u[0], GAS_R=0.2 + 0.3 * u[1])),
        lambda t, j, u: (0.1 + 0.15 * u) * float(t.arm.limit[j])),
    "cable": (
        _hidden(lambda t, j, x, u: put(t, j, SPRING=x, SPRING_Q0=0.6 * (u[0] - 0.5), HARDEN=1.5)),
        lambda t, j, u: (0.25 + 0.35 * u) * float(t.T[j, FC_POS])),
    "quadratic_load": (
        _hidden(lambda t, j, x, u: put(t, j, LOAD_2=x)), lambda t, j, u: (0.06 + 0.08 * u) / (0.2 * float(t.arm.limit[j]))),
    "cubic_viscous": (EFFECTS["cubic_viscous"], lambda t, j, u: 0.25 + 0.35 * u),
    "offset": (_hidden(lambda t, j, x, u: put(t, j, OFFSET=x * (1 if u[0] < 0.5 else -1))), lambda t, j, u: (0.2 + 0.3 * u) * float(t.T[j, FC_POS])),
    "play": (_hidden(_play), lambda t, j, u: 1e-3 * (0.6 + 1.2 * u)),
    "bump": (OUTSIDE["bump"], lambda t, j, u: (0.3 + 0.4 * u) * float(t.T[j, FC_POS])),
    "uneven": (OUTSIDE["uneven"], lambda t, j, u: (0.2 + 0.2 * u) * float(t.T[j, FC_POS])),
    "pedestal": (
        _hidden(lambda t, j, x, u: put(t, 0, ROCKS=x, ROCKS_ABOUT=3.14 * u[0])), lambda t, j, u: 5.0 + 7.0 * u),
}  # fmt: skip
LOADED = ("load_coulomb", "torque_gain", "elasticity", "counterbalance", "quadratic_load", "play")
SAYS = {"offset": ("asymmetric_coulomb",)}  # a constant torque
NAMELESS = {
    "play": ("none", "unknown"),
    "pedestal": ("none", "unknown"),
    "bump": ("unknown",),
    "uneven": ("unknown",),
    "offset": ("missing", "changed", "none"),
}


def drawn(seed: int, healthy: bool = False, others: bool = False) -> tuple[Truth, Truth, Cell, Cell, Case, int]:
    """An arm, the same one changed, cells of the first and of the later file, what is right, and the joint."""
    rng = np.random.default_rng([seed, 5])
    name = str(rng.choice(list(ARMS)))
    truth = truth_of(name, seed)
    n, fc = truth.arm.n, truth.T[:, FC_POS]
    on, pair = rng.random(8) < ODDS, bool(rng.random() < PAIR)
    gain = 1 + 0.04 * rng.normal() * on[0] + 0.02 * rng.normal(size=n) * on[1]
    lsb = fc * (0.05 if on[2] else 0.005)
    cell = Cell(
        str(rng.choice(CONTROLLERS)), str(rng.choice(KINDS)), float(rng.choice([100.0, 125.0])),
        float(10 ** rng.uniform(-5, -3.7)), lsb, 20.0 * on[3], gain, 1e-3 * float(rng.random()) * on[4],
        0.04 * float(rng.random()) * on[5], float(rng.uniform(0.05, 0.15)) * on[6], np.zeros(n), (0.03 + 0.04 * rng.random()) * fc,
    )  # fmt: skip
    drift = float(rng.uniform(0.05, 0.15)) * on[7] * (np.arange(n) == rng.integers(n)) * fc
    says = ("delay", "drive_lag") if cell.cut and not pair else ()
    joint, u = int(rng.integers(n)), rng.random(4)
    later = replace(cell, kind=str(rng.choice(KINDS)))
    T = truth.T.copy()
    if pair:
        T[:, [FC_POS, FC_NEG]] *= np.exp(rng.normal(0, 0.03, (n, 1)))
        T[:, FV] *= np.exp(rng.normal(0, 0.03, n))
    aged = replace(truth, T=T)
    words = f"{name} {cell.controller} {cell.kind}{f' {later.kind}' * pair}"
    words += f"{' filtered' * bool(cell.cut)}{' warms' * bool(cell.warms)}{' steps' * bool(on[2])}{' one by one' * bool(on[1])}"
    if healthy or (not others and rng.random() < HEALTHY):
        later = replace(later, drift=drift)
        right = ("none", "unknown", *(("missing",) if cell.warms else ())) if drift.any() or cell.warms else NONE
        right = (*right, "missing") if says else right
        return truth, aged, cell, later, Case(f"{'later ' * pair}healthy, {words}", pair, verdicts=right, says=says), joint
    choice = str(rng.choice([*OTHERS][:-1] if others else [*SIZES, *["worn"] * (3 if pair else 0)]))
    choice = [*OTHERS][-1] if others and np.random.default_rng([seed, 7]).random() < PEDESTALS else choice
    where = int(np.argmax(truth.arm.limit)) + 1 if choice in LOADED else joint
    kind, size_of, at = (*OTHERS[choice], where) if others else (EFFECTS.get(choice, WORN), SIZES.get(choice, _much), joint)
    size = size_of(aged, at, float(rng.random()))
    joint = min(where, n - 2) if kind.pair else where
    changed = kind.apply(aged, joint, size, u)
    says = (*(FRICTION if choice == "worn" else SAYS.get(choice, () if choice in NAMELESS else (choice,))), *says)
    place = "arm" if kind.whole_arm else str(joint)
    effect = "" if choice == "worn" or choice in NAMELESS else choice
    told = ("missing", "changed")
    verdicts = told if pair and choice == "offset" else NAMELESS.get(choice, told)
    case = Case(
        f"{'later ' * pair}{choice} at {place} of {size:.3g}, {words}",
        pair,
        effect=effect,
        place=place,
        verdicts=verdicts,
        says=says,
    )
    return truth, changed, cell, later, case, joint


def files(seed: int, healthy: bool, folder: Path, others: bool = False) -> tuple[Path, Path, Path | None, Case, int]:
    """Description, first file, and the later one of a pair."""
    truth, changed, cell, later, case, joint = drawn(seed, healthy, others)
    rng = np.random.default_rng([seed, 6])
    urdf_path = described(truth, folder)
    if not case.pair:
        return urdf_path, recorded(changed, later, folder, "first", rng), None, case, joint
    first = recorded(truth, cell, folder, "first", rng)
    return urdf_path, first, recorded(changed, later, folder, "later", rng), case, joint


def made(seed: int, healthy: bool, folder: Path, others: bool = False) -> tuple[Any, Any, Recordings, Case, int]:
    """Robot, model, what is diagnosed, what is right, and the joint."""
    urdf_path, first_path, later_path, case, joint = files(seed, healthy, folder, others)
    robot = load_robot(urdf_path)
    first = read_recordings(first_path, robot)
    model = identified(robot, Campaign(first.meta, lambda: iter(first.trials)), Settings(), silent, None, (), None).model
    return robot, model, first if later_path is None else read_recordings(later_path, robot), case, joint


def asked(seed: int, healthy: bool = False, others: bool = False) -> dict[str, Any]:
    """The answer to one set, and whether it is right."""
    with tempfile.TemporaryDirectory() as name:
        try:
            robot, model, data, case, joint = made(seed, healthy, Path(name), others)
            found, _ = diagnose_model(model, data)
        except StopsetError as error:  # a refusal is an answer, too
            case = drawn(seed, healthy, others)[4]
            return {"case": case.name, "right": False, "false": [], "verdict": f"{type(error).__name__}: {error}", "named": []}
    answer: dict[str, Any] = judged(found, case, robot, joint)
    # what all joints do is no false name: warm up, or weigh by constants that are off one by one, of which a model of the same arm says nothing
    true = (*(WARM * (" warms" in case.name)), *("torque_gain:",) * (" one by one" in case.name and not case.pair))
    answer["false"] = [x for x in answer["false"] if not x.startswith(true)]
    return answer


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=("ask", "rate"))
    parser.add_argument("--seed", type=int, default=117000)
    parser.add_argument("--count", type=int, default=14)
    parser.add_argument("--healthy", action="store_true", help="healthy arms, no other")
    parser.add_argument("--others", action="store_true", help="gas springs, cables, offsets, play and what else `SIZES` lacks")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args(argv)
    args.out.mkdir(parents=True, exist_ok=True)
    for seed in range(args.seed, args.seed + args.count) if args.command == "ask" else ():
        file = args.out / f"{seed}{'_healthy' * args.healthy}{'_others' * args.others}.json"
        if not file.exists():
            file.write_text(json.dumps(asked(seed, args.healthy, args.others), default=str))
        answer = json.loads(file.read_text())
        print("right" if answer["right"] else "WRONG", file.stem, answer["case"], answer["verdict"], answer["named"], flush=True)
    rate(args.out)


if __name__ == "__main__":
    main()
