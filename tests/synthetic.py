"""Recordings of known linear systems, simulated by the closed formula of one lag, independent of the code under test."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from stopset.offline.description import robot_from_text
from stopset.recording import Recording
from stopset.robot import Robot
from stopset.robot.arm import standard_parameters
from stopset.types import Array

DT = 0.004


def urdf(joints: Sequence[str]) -> str:
    """A planar arm with 0.3 m links of 2 kg, axes along y."""
    parts = ['<robot name="planar"><link name="l0"/>']
    for k, j in enumerate(joints):
        parts.append(
            f'<link name="l{k + 1}"><inertial><origin xyz="0 0 0.15"/><mass value="2"/>'
            '<inertia ixx="0.02" iyy="0.02" izz="0.005" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="{j}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/>'
            f'<origin xyz="0 0 {0.3 if k else 0.0}"/><axis xyz="0 1 0"/>'
            '<limit lower="-3" upper="3" velocity="3" effort="100"/></joint>'
        )
    return "".join(parts) + "</robot>"


def arm(joints: Sequence[str]) -> Robot:
    return robot_from_text(urdf(joints))


def with_payload(robot: Robot, mass: float, com: Array, inertia: Array | None = None) -> Robot:
    """The same arm with a rigid load in the last link: ``mass`` [kg], ``com`` (3,) [m] in the last link frame.

    ``inertia``: (3, 3) about the load's centre of mass [kg m^2], zero if left out (a point mass).
    """
    pi = robot.pi.copy()
    pi[-1] += standard_parameters(mass, np.asarray(com, float), np.zeros((3, 3)) if inertia is None else inertia)
    return replace(robot, pi=pi)


def names(n: int) -> tuple[str, ...]:
    return tuple(f"axis_{k + 1}" for k in range(n))


def lag(J: float, v: float, dt: float, q: float, dq: float, f: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``J ddq + v dq = f`` with ``f`` held over each step: the solution written out, step by step."""
    qs, ds = np.empty(len(f)), np.empty(len(f))
    for k, force in enumerate(f):
        qs[k], ds[k] = q, dq
        end = force / v  # the speed it tends to
        fade = np.exp(-v / J * dt)
        q, dq = q + end * dt + (dq - end) * J / v * (1.0 - fade), end + (dq - end) * fade
    return qs, ds


def torques(rng: np.random.Generator, N: int, n: int, size: float, dt: float = DT) -> np.ndarray:
    """Smooth torques (N, n): a few sines per joint."""
    t = dt * np.arange(N)[:, None, None]
    f, phase = rng.uniform(0.2, 1.5, (1, n, 4)), rng.uniform(0, 2 * np.pi, (1, n, 4))
    return size * np.sin(2 * np.pi * f * t + phase).mean(axis=2)


def recordings(
    J: Sequence[float], v: Sequence[float], suites: int = 2, trials: int = 4, seconds: float = 1.0, *, dt: float = DT,
    bias: float = 0.3, spread: float = 0.2, noise: tuple[float, float] = (1e-5, 1e-3), seed: int = 1,
) -> list[Recording]:  # fmt: skip
    """Trials of ``n`` lags driven by known torque plus an unknown one in ``bias +- spread`` that changes every 10 steps.

    Readings carry uniform noise of half-widths ``noise`` (rad, rad/s); the first reading too.
    """
    rng = np.random.default_rng(seed)
    n, N = len(J), round(seconds / dt) + 1
    out = []
    for s in range(suites):
        u = torques(rng, N, n, 6.0, dt)
        q0 = rng.uniform(-0.5, 0.5, n)
        for k in range(trials):
            hidden = bias + spread * np.repeat(rng.uniform(-1, 1, (N // 10 + 1, n)), 10, axis=0)[:N]
            q, dq = np.empty((N, n)), np.empty((N, n))
            for j in range(n):
                q[:, j], dq[:, j] = lag(J[j], v[j], dt, q0[j], 0.0, u[:, j] + hidden[:, j])
            q += rng.uniform(-noise[0], noise[0], q.shape)
            dq += rng.uniform(-noise[1], noise[1], dq.shape)
            out.append(Recording("open_loop", s, k, s * trials + k, dt * np.arange(N), q, dq, u.copy()))
    return out


def columns(trials: Sequence[Recording], joints: Sequence[str]) -> dict[str, np.ndarray]:
    """The recording format's columns, double precision."""
    out = {
        "suite": np.concatenate([np.full(len(r.t), r.suite) for r in trials]),
        "trial": np.concatenate([np.full(len(r.t), r.trial) for r in trials]),
        "phase": np.concatenate([np.full(len(r.t), r.phase) for r in trials]),
        "t": np.concatenate([r.t for r in trials]),
    }
    for k, j in enumerate(joints):
        for name in ("q", "dq", "tau"):
            out[f"{name}_{j}"] = np.concatenate([getattr(r, name)[:, k] for r in trials])
    if any(r.stop_trigger is not None for r in trials):
        triggers = [np.zeros(len(r.t), bool) if r.stop_trigger is None else r.stop_trigger for r in trials]
        out["stop_trigger"] = np.concatenate(triggers)
    return out


def meta(joints: Sequence[str], effort: str = "compensated_torque", **more: object) -> dict[str, object]:
    return {"robot": "planar", "joints": list(joints), "effort": effort, "velocity": "measured", "clock": "recorded",
            "rate_hz": 250.0} | more  # fmt: skip


def save(path: Path, table: dict[str, np.ndarray], head: dict[str, object] | None, **options: object) -> Path:
    """Parquet with the metadata ``head`` (None: without), not written by the code under test."""
    t = pa.table({k: pa.array(v) for k, v in table.items()})
    if head is not None:
        t = t.replace_schema_metadata({"recording": json.dumps(head)})
    pq.write_table(t, path, **options)
    return path


def save_trials(path: Path, trials: Sequence[Recording], joints: Sequence[str], **more: object) -> Path:
    return save(path, columns(trials, joints), meta(joints, **more))
