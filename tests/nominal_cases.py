"""A three-joint arm with known truth, its motions by formula and its torques by inverse dynamics."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from stopset.offline.description import robot_from_text
from stopset.recording import Meta, Recording, Recordings
from stopset.robot import Robot
from stopset.robot.rigid import gravity_torques, torques
from stopset.types import Array

JOINTS = ("base", "shoulder", "elbow")
RATE = 250.0
F_C, F_V, ROTOR = np.array([6.0, 9.0, 5.0]), np.array([9.0, 12.0, 7.0]), np.array([0.9, 1.1, 0.6])
NOISE = np.array([0.15, 0.2, 0.1])  # [N m]
ENCODER = 2 * np.pi / 2**17  # [rad]
LINKS = ((4.0, (0.0, 0.01, -0.05)), (5.0, (0.02, 0.0, 0.2)), (2.5, (0.01, 0.02, 0.18)))


def _link(k: int, mass: float, com: Sequence[float]) -> str:
    xyz = " ".join(f"{c:.9g}" for c in com)
    return (
        f'<link name="l{k + 1}"><inertial><origin xyz="{xyz}"/><mass value="{mass:.9g}"/>'
        '<inertia ixx="0.04" iyy="0.04" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )


def arm(mass: float = 1.0, shift: float = 0.0, sheet: bool = True) -> Robot:
    """The arm as its CAD has it: masses wrong by a factor ``mass``, centres by ``shift`` [m] in each direction."""
    parts = ['<robot name="three"><link name="l0"/>']
    for k, ((m, com), joint) in enumerate(zip(LINKS, JOINTS, strict=True)):
        axis = "0 0 1" if k == 0 else "0 1 0"
        parts.append(_link(k, m * mass, [c + shift for c in com]))
        parts.append(
            f'<joint name="{joint}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/>'
            f'<origin xyz="0 0 {(0.2, 0.1, 0.4)[k]}"/><axis xyz="{axis}"/>'
            '<limit lower="-2.9" upper="2.9" velocity="1.5" effort="120"/></joint>'
        )
    rows = {j: {"gear_ratio": 100, "reflected_motor_inertia_kgm2": float(r)} for j, r in zip(JOINTS, ROTOR, strict=True)}
    return robot_from_text("".join(parts) + "</robot>", {"joints": rows} if sheet else {})


@dataclass(frozen=True)
class Truth:
    """What the recordings are made with; ``friction(dq, load)`` [N m] on the arrays of a motion."""

    robot: Robot
    friction: Callable[[Array, Array], Array] = lambda dq, load: F_C * np.sign(dq) + F_V * dq
    noise: Array = field(default_factory=NOISE.copy)
    encoder: float = ENCODER
    delay: float = 0.0  # [s] the torque column is this late


def fourier(seconds: float, speed: float, rng: np.random.Generator, n: int = 3, rate: float = RATE) -> tuple[Array, ...]:
    """A multisine from rest to rest: ``t, q, dq, ddq``; exact derivatives."""
    t = np.arange(0.0, seconds, 1 / rate)
    k = np.arange(1, 6)
    w = 2 * np.pi * k * 0.15
    a, p = rng.normal(size=(5, n)) / w[:, None], rng.uniform(0, 2 * np.pi, (5, n))

    def series(d: int) -> Array:
        phase = w[:, None, None] * t[None, :, None] + p[:, None, :]
        return np.sum(a[:, None, :] * w[:, None, None] ** d * np.sin(phase + d * np.pi / 2), axis=0)

    q, dq, ddq = series(0), series(1), series(2)
    scale = speed / np.abs(dq).max(axis=0)
    return t, scale * q, scale * dq, scale * ddq


def moving(
    truth: Truth, suite: int, seconds: float, speed: float, seed: int, phase: str = "closed_loop", rate: float = RATE
) -> Recording:
    """One closed-loop trial along a multisine."""
    rng = np.random.default_rng([seed, suite])
    t, q, dq, ddq = fourier(seconds, speed, rng, rate=rate)
    r = truth.robot
    load = gravity_torques(r.chain, r.pi, q)
    tau = torques(r.chain, r.pi, q, dq, ddq) + r.rotor * ddq + truth.friction(dq, load)
    tau = np.column_stack([np.interp(t - truth.delay, t, x) for x in tau.T])
    tau = tau + truth.noise * rng.normal(size=tau.shape)
    measured = np.round(q / truth.encoder) * truth.encoder if truth.encoder > 0 else q
    return Recording(phase, suite, 0, suite, t, measured, dq + 0.002 * rng.normal(size=dq.shape), tau)


def poses(truth: Truth, count: int, seed: int, sides: int = 2) -> list[Recording]:
    """Static poses approached from below and above."""
    rng = np.random.default_rng(seed)
    r, out = truth.robot, []
    t = np.arange(4) * 0.004
    for k in range(count):
        q = rng.uniform(-1.5, 1.5, 3)
        for trial, direction in list(enumerate((1.0, -1.0)))[:sides]:
            rows = np.tile(q + 0.01 * direction, (4, 1))
            load = gravity_torques(r.chain, r.pi, rows)
            tau = load + truth.friction(np.full_like(rows, direction * 1e-9), load) + 0.1 * rng.normal(size=rows.shape)
            out.append(Recording("static", k, trial, 2 * k + trial, t, rows, 0 * rows, tau))
    return out


def campaign(truth: Truth, seed: int = 1, seconds: float = 12.0, static: int = 40) -> Recordings:
    """Poses, fast and slow motions."""
    speeds = (1.2, 1.2, 0.8, 0.5, 0.3, 0.12)
    trials = poses(truth, static, seed) + [moving(truth, k, seconds, s, seed) for k, s in enumerate(speeds)]
    return Recordings(Meta(joints=JOINTS, robot="three"), tuple(trials))


def wrong_cad() -> tuple[Robot, Robot]:
    """(the true arm, what its CAD says): masses 4 % light, centres 3 mm off."""
    return arm(), arm(mass=0.96, shift=0.003)


def fresh_torque(truth: Truth, robot: Robot, seed: int = 99) -> tuple[Array, Array]:
    """True rigid-body and rotor torque of a motion not recorded, and that of ``robot``."""
    _, q, dq, ddq = fourier(10.0, 1.2, np.random.default_rng(seed))
    r = truth.robot
    return (
        torques(r.chain, r.pi, q, dq, ddq) + r.rotor * ddq,
        torques(robot.chain, robot.pi, q, dq, ddq) + robot.rotor * ddq,
    )


def shaken(recording: Recording, spread: float, seed: int = 3) -> Recording:
    """The same signals read at irregular instants: ``spread`` of the period, and the stamps say so."""
    rng = np.random.default_rng(seed)
    h = float(recording.t[1])
    t = recording.t + spread * h * rng.uniform(-0.5, 0.5, len(recording.t))
    t[0] = recording.t[0]

    def at(x: Array) -> Array:
        return np.column_stack([np.interp(t, recording.t, c) for c in x.T])

    return replace(recording, t=t, q=at(recording.q), dq=at(recording.dq), tau=at(recording.tau))
