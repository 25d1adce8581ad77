"""Recordings of the independent arm: random arms, motions, sensors and phases in the shape of a commissioning session.

Phases: ``static`` poses approached from both sides, ``closed_loop`` slow and fast point-to-point and Fourier motions while the
arm warms up, ``open_loop`` suites replaying equal torques, ``stop0`` and ``stop1``.  Noise and rates as in the project's
labelled sets: 250 Hz, encoder 2^-14 rad, speed 0.003 rad/s, torque 3.7 % of a joint's Coulomb friction, friction that differs
by 2 % from trial to trial in its Coulomb and its viscous part, temperature in steps of 0.25 K.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from independent_arm import Arm, Array, about_origin, centred, torques
from independent_motions import Generator, fourier, point_to_point
from independent_plant import (
    BUMP_WIDTH,
    COLUMNS,
    DAHL,
    DT,
    FC_NEG,
    FC_POS,
    FV,
    RES_WIDTH,
    STIFF,
    STIFFEN,
    T_REF,
    V_S,
    friction,
    position_torque,
    simulate,
)
from scipy.signal import lfilter

Columns = dict[str, Array]


@dataclass(frozen=True)
class Truth:
    """What really is: ``arm`` with what was hidden in it, ``described`` what the description says, laws of friction and sensors."""

    arm: Arm
    described: Arm
    T: Array  # (n, COLUMNS)
    C: Array  # (n, n) viscous coupling
    gain: Array  # (n,) true over reported torque
    delay: Array  # (n,) [s]
    walk: Array  # (n, 2) deviation [N m] and correlation time [s]
    noise: Array  # (n,) torque [N m]
    hot: Array  # (n,) warming [K]
    reach: Array  # (n,) range of motion +- [rad]
    seed: int
    faults: dict[str, Array] = field(
        default_factory=dict
    )  # (n,) each: push [N m], wear, frozen, saturation, lag [s], slow_sensor

    def fault(self, name: str) -> Array:
        """(n,) size of a fault at every joint."""
        return self.faults.get(name, np.zeros(self.arm.n))


def _scaled(arm: Arm, s: float) -> Arm:
    """A larger or smaller sister: lengths by ``s``, masses by s^2.5, torques to match."""
    pi = arm.pi * np.array([1.0, *[s] * 3, *[s * s] * 6]) * s**2.5
    return replace(arm, name=f"{arm.name}_x{s:.2f}", p=arm.p * s, pi=pi, rotor=arm.rotor * s**3.5, limit=arm.limit * s**3.3)


def _with_twist(arm: Arm, k: int) -> Arm:
    """One joint more: link ``k`` is cut in half and turns about its own length there."""
    axis_of_link = arm.p[k + 1] / np.linalg.norm(arm.p[k + 1])
    m, c, J = centred(arm.pi[k])
    near = about_origin(m / 2, c / 2, J / 3)
    far = about_origin(m / 2, c / 2, J / 3)
    half = arm.p[k + 1] / 2
    p = np.concatenate([arm.p[: k + 1], [half, half], arm.p[k + 2 :]])
    pi = np.concatenate([arm.pi[:k], [near, far], arm.pi[k + 1 :]])
    twin = {name: np.insert(getattr(arm, name), k + 1, 0.7 * getattr(arm, name)[k]) for name in ("rotor", "limit")}
    return replace(
        arm, name=arm.name + "_7", joints=(*arm.joints[: k + 1], f"{arm.joints[k]}_twist", *arm.joints[k + 1 :]),
        R0=np.insert(arm.R0, k + 1, np.eye(3), axis=0), p=p, axis=np.insert(arm.axis, k + 1, axis_of_link, axis=0), pi=pi,
        gear=np.insert(arm.gear, k + 1, arm.gear[k]), **twin,
    )  # fmt: skip


def random_truth(template: Arm, seed: int, other_arm: bool) -> Truth:
    """A healthy arm like the template, or (``other_arm``) of other size or with a joint more; its description may be wrong."""
    rng = np.random.default_rng([seed, 1])
    arm = template
    if other_arm:
        arm = _scaled(arm, float(rng.uniform(0.75, 1.3)))
        if arm.n == 6 and rng.random() < 0.4:
            arm = _with_twist(arm, 1)
    arm = jittered(arm, rng, 0.08, 0.005, 0.08)
    described = arm if rng.random() < 0.7 else jittered(arm, rng, 0.0, 0.0, 0.04, wrong=True)
    T = np.zeros((arm.n, COLUMNS))
    fc = 0.42 * arm.limit**0.65 * rng.uniform(0.8, 1.25, arm.n)
    T[:, FC_POS] = T[:, FC_NEG] = fc
    T[:, FV] = fc * rng.uniform(1.05, 1.9, arm.n)
    T[:, [V_S, RES_WIDTH, BUMP_WIDTH]] = 1.0
    reach = np.where(arm.limit > 0.9 * arm.limit.max(), rng.uniform(1.0, 1.25, arm.n), rng.uniform(1.35, 2.2, arm.n))
    return Truth(
        arm, described, T, np.zeros((arm.n, arm.n)), np.ones(arm.n), np.zeros(arm.n), np.zeros((arm.n, 2)),
        0.037 * fc * rng.uniform(0.88, 1.15, arm.n), rng.uniform(13, 23, arm.n), reach, seed,
    )  # fmt: skip


def jittered(arm: Arm, rng: Generator, mass: float, centre: float, rotor: float, wrong: bool = False) -> Arm:
    """Masses, centres and rotors that differ; ``wrong``: as a description is off, 2 to 5 % in mass and 3 mm in centre."""
    pi = []
    for row in arm.pi:
        m, c, J = centred(row)
        if wrong:
            f, shift = 1 + rng.choice([-1, 1]) * rng.uniform(0.02, 0.05), rng.normal(0, 0.0018, 3)
        else:
            f, shift = rng.uniform(1 - mass, 1 + mass), rng.normal(0, centre, 3)
        pi.append(about_origin(m * f, c + shift, J * f))
    return replace(arm, pi=np.array(pi), rotor=arm.rotor * rng.uniform(1 - rotor, 1 + rotor, arm.n))


# -- trials -------------------------------------------------------------------------------------------------------------


def _gains(truth: Truth) -> tuple[Array, Array]:
    kp = 10.0 * truth.arm.limit
    return kp, 1.4 * np.sqrt(kp * 2 * truth.arm.rotor)


def _run(
    truth: Truth, q: Array, temp: Array, sc: Array, sv: Array, extra: Array, start: Array | None = None
) -> tuple[Array, ...]:
    """Closed-loop trial along the reference ``q`` (N, n), feed-forward from the description and nominal friction."""
    dq = np.gradient(q, DT, axis=0)
    ddq = np.gradient(dq, DT, axis=0)
    described, T = truth.described, truth.T
    ff = torques(described, q, dq, ddq) + T[:, FC_POS] * np.tanh(dq / 0.02) + T[:, FV] * dq
    kp, kd = _gains(truth)
    dq0 = dq[0] if start is None else start
    return _simulate(truth, temp, sc, sv, extra, ff, q, dq, kp, kd, q[0], dq0)


def _simulate(truth: Truth, temp, sc, sv, extra, ff, qd, dqd, kp, kd, q0, dq0):  # type: ignore[no-untyped-def]
    a = truth.arm
    return simulate(
        a.R0, a.p, a.axis, a.pi, a.rotor, a.gravity, truth.T, truth.C, sc, sv, temp, extra, np.ascontiguousarray(ff),
        np.ascontiguousarray(qd), np.ascontiguousarray(dqd), kp, kd, q0.copy(), dq0.copy(),
    )  # fmt: skip


def _trial(truth: Truth, rng: Generator, warm: float, N: int, worn: float = 1.0) -> tuple[Array, Array, Array, Array]:
    """Temperature (N, n), friction scales (n,), and torque from outside (N, n) of one trial; ``worn``: how far wear has gone."""
    n = truth.arm.n
    start = 23.5 + warm * truth.hot + rng.normal(0, 0.5, n)
    temp = start + np.linspace(0, 0.4 * max(0.0, 1 - warm), N)[:, None]
    sc, sv = 1 + 0.02 * rng.normal(size=(2, n))
    extra = np.zeros((N, n))
    for j in range(n):
        sigma, tau = truth.walk[j]
        e = rng.normal(size=N)
        if sigma > 0:
            x = sigma * e[0]
            for k in range(N):
                x += -x * DT / tau + sigma * np.sqrt(2 * DT / tau) * e[k]
                extra[k, j] = x
    sc = sc * (1 + worn * truth.fault("wear"))
    for j in np.flatnonzero(truth.fault("push")):
        extra[:, j] += truth.fault("push")[j] * _contact(rng, N)
    return temp, sc, sv, extra


def _contact(rng: Generator, N: int) -> Array:
    """(N,) one push of up to a second at some time of two trials in three."""
    at, wide, sense = rng.uniform(0, N), rng.uniform(0.1, 0.3) / DT, rng.choice([-1.0, 0.0, 1.0])
    return np.asarray(sense * np.exp(-(((np.arange(N) - at) / wide) ** 4)))


def _measured(truth: Truth, rng: Generator, q: Array, dq: Array, tau: Array, temp: Array) -> Columns:
    """What the sensors say: gain and delay of the torque, noise, quantisation."""
    t = np.arange(len(q)) * DT
    tau = tau / (1 - truth.fault("saturation") * (tau / truth.arm.limit) ** 2)  # a motor constant that falls with the current
    late = np.stack([np.interp(t - d, t, tau[:, j] / truth.gain[j]) for j, d in enumerate(truth.delay)], axis=1)
    for j in np.flatnonzero(truth.fault("lag")):
        a = np.exp(-DT / truth.fault("lag")[j])
        late[:, j] = lfilter([1 - a], [1, -a], late[:, j], zi=[a * late[0, j]])[0]
    for j in np.flatnonzero(truth.fault("frozen")):
        late[:, j] = _held(late[:, j], rng, truth.fault("frozen")[j])
    temp = temp - truth.fault("slow_sensor") * (temp - 23.5) * np.exp(-np.maximum(temp - 23.5, 0.0) / 8)
    lsb = np.where(truth.arm.limit < 30, 2**-5, 2**-4)
    noisy = late + truth.noise * rng.normal(size=q.shape)
    return {
        "t": t,
        "q": np.round((q + 0.35 * 2**-14 * rng.normal(size=q.shape)) * 2**14) / 2**14,
        "dq": np.round((dq + 0.003 * rng.normal(size=q.shape)) * 2**10) / 2**10,
        "tau": np.round(noisy / lsb) * lsb,
        "temp": np.round((temp + 0.1 * rng.normal(size=q.shape)) * 4) / 4,
    }


def _held(x: Array, rng: Generator, share: float) -> Array:
    """A reading that stands still for 40 to 200 ms, ``share`` of the time."""
    out, k = x.copy(), 0
    while k < len(x):
        wide = int(rng.integers(10, 50))
        if rng.random() < share:
            out[k : k + wide] = out[k]
        k += wide
    return out


def closed_loop(truth: Truth) -> list[tuple[int, int, Columns]]:
    """Twelve trials of 6 s: suite 0 slow and 2 fast point to point, 1 slow and 3 fast Fourier, in random order, warming."""
    rng = np.random.default_rng([truth.seed, 2])
    out = []
    for k, kind in enumerate(rng.permutation(np.repeat(np.arange(4), 3))):
        make = point_to_point if kind % 2 == 0 else fourier
        q = make(truth.reach, 0.4 if kind < 2 else 1.2, 6.0, rng)
        temp, sc, sv, extra = _trial(truth, rng, 1 - np.exp(-k / 5), len(q), k / 52)
        out.append((int(kind), k, _measured(truth, rng, *_run(truth, q, temp, sc, sv, extra), temp)))
    return out


def open_loop(truth: Truth) -> list[tuple[int, int, Columns]]:
    """Two motions, four start points each, the same torques five times from cold to warm."""
    rng = np.random.default_rng([truth.seed, 3])
    n, out = truth.arm.n, []
    for motion in range(2):
        q = point_to_point(truth.reach, 1.2, 6.0, rng)
        still = np.full((len(q), n), T_REF), np.ones(n), np.ones(n), np.zeros((len(q), n))
        Q, V, U = _run(truth, q, *still)
        for part in range(4):
            first, N = 75 * part, int(rng.integers(510, 690))
            here = slice(first, first + N)
            for k in range(5):
                temp, sc, sv, extra = _trial(truth, rng, k / 4, N, (12 + 20 * motion + 5 * part + k) / 52)
                z = np.zeros(n)
                got = _simulate(truth, temp, sc, sv, extra, U[here], Q[here], V[here], z, z, Q[first], V[first])
                near = (np.abs(got[0] - Q[here]).max(axis=1) <= 0.8) & (np.abs(got[1]).max(axis=1) <= 3.0)
                off = np.flatnonzero(~near)  # also where it ran away beyond numbers
                cut = int(off[0]) if len(off) else N
                out.append((4 * motion + part, k, _measured(truth, rng, *(x[:cut] for x in (*got, temp)))))
    return out


def stops(truth: Truth, category: int) -> list[tuple[int, int, Columns]]:
    """Power cut (0: brakes fall in, the drive's torque is gone) or controlled (1), 20 regular and 5 at extreme temperature."""
    rng = np.random.default_rng([truth.seed, 4 + category])
    n, out = truth.arm.n, []
    for k in range(25):
        warm = rng.uniform(0, 1.1) if k < 20 else rng.choice([-0.25, 1.4])
        v = rng.uniform(-1, 1, n)
        v *= rng.choice([0.35, 0.66, 1.0]) * 1.2 / np.abs(v).max()
        ramp, hold = (0.38, 25) if category else (0.06, 0)
        s = np.concatenate([np.ones(25), np.linspace(1, 0, round(ramp / DT)), np.zeros(hold)])
        q = rng.uniform(-0.7, 0.7, n) * truth.reach + np.cumsum(s)[:, None] * DT * v
        temp, sc, sv, extra = _trial(truth, rng, warm, len(q))
        got = [np.asarray(x) for x in _run(truth, q, temp, sc, sv, extra, v)]
        off = 25 if category == 0 else len(q) - 1
        rest = 25 if category == 0 else 15
        parts = [np.concatenate([x, np.repeat(x[-1:] * keep, rest, axis=0)]) for x, keep in zip(got, (1, 0, 0), strict=True)]
        parts[2][off:] = 0.0
        c = _measured(truth, rng, *parts, np.concatenate([temp, np.repeat(temp[-1:], rest, axis=0)]))
        c["stop_trigger"] = np.arange(len(c["t"])) >= 25
        out.append((k // 20, k % 20, c))
    return out


def static(truth: Truth) -> list[tuple[int, int, Columns]]:
    """150 poses, each approached from below and from above: the controller leaves nearly the whole static friction."""
    rng = np.random.default_rng([truth.seed, 6])
    n, out = truth.arm.n, []
    kp, _ = _gains(truth)
    for k in range(150):
        pose = rng.uniform(-1, 1, n) * truth.reach
        for side, sense in enumerate((1.0, -1.0)):
            temp, sc, _, extra = _trial(truth, rng, 0.45 + 0.5 * k / 150, 4, 0.0)
            built = 1 - 0.03 * rng.exponential(size=n)
            link, z = pose.copy(), np.zeros(n)
            for _round in range(20):
                load = torques(truth.arm, link[None], z[None], z[None])[0]
                stiff = truth.T[:, STIFF] * (1 + truth.T[:, STIFFEN] * (pose - link) ** 2)
                link = np.where(truth.T[:, STIFF] > 0, pose - load / np.maximum(stiff, 1e-9), pose)
            tau, held = np.empty(n), np.empty(n)
            for j in range(n):
                row = truth.T[j].copy()
                row[[FV, DAHL]] = 0.0
                held[j] = built[j] * friction(row, 0.012 * sense, pose[j], 0.0, load[j], sc[j], 1.0, 0.0)[0]
                tau[j] = load[j] + held[j] + position_torque(row, pose[j])
            q = np.tile(pose - held / kp, (4, 1))
            out.append((k, side, _measured(truth, rng, q, np.zeros((4, n)), tau + extra, temp)))
    return out


# -- files --------------------------------------------------------------------------------------------------------------


def write_set(truth: Truth, folder: Path) -> None:
    """``recording.parquet``, ``robot.urdf`` and ``robot.json``."""
    folder.mkdir(parents=True, exist_ok=True)
    phases = {
        "static": static(truth), "closed_loop": closed_loop(truth), "open_loop": open_loop(truth),
        "stop0": stops(truth, 0), "stop1": stops(truth, 1),
    }  # fmt: skip
    rows: dict[str, list[object]] = {}
    for phase, trials in phases.items():
        for suite, trial, c in trials:
            N = len(c["t"])
            fixed = {"suite": np.full(N, suite, np.int16), "trial": np.full(N, trial, np.int16), "phase": np.full(N, phase)}
            named = {f"{k}_{j}": c[k][:, i] for k in ("q", "dq", "tau", "temp") for i, j in enumerate(truth.arm.joints)}
            stop = c.get("stop_trigger", np.zeros(N, bool))
            for key, value in {**fixed, "t": c["t"], **named, "stop_trigger": stop}.items():
                rows.setdefault(key, []).append(value)
    table = {k: np.concatenate(v) for k, v in rows.items()}  # type: ignore[arg-type]
    single = {k: v.astype(np.float32) if "_" in k and k != "stop_trigger" else v for k, v in table.items()}
    pq.write_table(pa.table(single), folder / "recording.parquet")
    (folder / "robot.urdf").write_text(urdf(truth.described))
    joints = {
        name: {"gear_ratio": int(a.gear[j]), "motor_inertia_kgm2": float(a.rotor[j] / a.gear[j] ** 2), "torque_limit_Nm": float(a.limit[j])}
        for a in (truth.described,) for j, name in enumerate(a.joints)
    }  # fmt: skip
    (folder / "robot.json").write_text(
        json.dumps({"robot": truth.described.name, "sample_rate_Hz": 250, "joints": joints}, indent=1)
    )


def urdf(arm: Arm) -> str:
    """The arm's description as text."""
    text = [f'<?xml version="1.0"?>\n<robot name="{arm.name}">\n  <link name="link_0"/>']
    for j, name in enumerate(arm.joints):
        m, c, J = centred(arm.pi[j])
        R = arm.R0[j]
        rpy = np.arctan2(R[2, 1], R[2, 2]), np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0])), np.arctan2(R[1, 0], R[0, 0])
        words = {k: " ".join(f"{x:.9g}" for x in v) for k, v in (("p", arm.p[j]), ("a", arm.axis[j]), ("c", c), ("rpy", rpy))}
        inertia = " ".join(f'i{"xyz"[a]}{"xyz"[b]}="{J[a, b]:.9g}"' for a in range(3) for b in range(a, 3))
        text.append(
            f'  <joint name="{name}" type="revolute">\n    <parent link="link_{j}"/>\n    <child link="link_{j + 1}"/>\n'
            f'    <origin xyz="{words["p"]}" rpy="{words["rpy"]}"/>\n    <axis xyz="{words["a"]}"/>\n'
            f'    <limit lower="-2.9" upper="2.9" effort="{arm.limit[j]:.6g}" velocity="1.2"/>\n  </joint>\n'
            f'  <link name="link_{j + 1}">\n    <inertial>\n      <origin xyz="{words["c"]}" rpy="0 0 0"/>\n'
            f'      <mass value="{m:.9g}"/>\n      <inertia {inertia}/>\n    </inertial>\n  </link>'
        )
    return "\n".join([*text, "</robot>\n"])
