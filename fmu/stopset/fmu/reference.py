"""Reference results: what the Python model says, for everyone who wants to check the FMU on their importer.

Inputs ``*_in.csv``, results ``*_ref.csv`` and solver options ``*_ref.opt`` in the layout of the FMI cross-check.  Torque
changes every ten grid steps and is held between; the measured inputs are the model's own motion, so that a model of motor
torque compensates gravity and friction at a known state.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from stopset.artifact import Model
from stopset.artifact.inputs import memories_after, memories_along
from stopset.effects import REFERENCE_TEMPERATURE
from stopset.files import write_text
from stopset.fmu.variables import start_posture
from stopset.reach.flowpipe import deviation_tube, discretise
from stopset.types import Array

DURATION = 10.0  # [s]
HOLD = 10  # grid steps between two changes of the torque
SEED = 2018


@dataclass(frozen=True, slots=True)
class Reference:
    """Rows on the model's grid: ``t`` (N,), ``tau`` (N, n) [N m], the motion ``x`` (N, 2n), bounds ``lo``, ``hi`` (N, 2n)."""

    t: Array
    tau: Array
    x: Array
    lo: Array
    hi: Array
    temp: Array


def stepper(model: Model) -> Callable[[Array, Array], Array]:
    """The abstraction's motion over one grid step: state (2n,), held input (n,) -> state."""
    a, dt, n = model.abstraction, model.powered.dt, model.n
    if a.linear:
        Ad, Bd = discretise(a, dt)
        return lambda x, u: Ad @ x + Bd @ u

    def step(x: Array, u: Array) -> Array:
        def flow(_: float, y: Array) -> Array:
            return np.concatenate([y[n:], a.ddq(y[None, :n], y[None, n:], u[None, :])[0]])

        # three digits below the 1e-9 that the FMU has to meet over some thousand steps
        return np.asarray(solve_ivp(flow, (0.0, dt), x, method="DOP853", rtol=1e-13, atol=1e-15).y[:, -1])

    return step


def reference(model: Model) -> Reference:
    """The reference run of a model: ten seconds or the horizon, from rest at the FMU's own start, seeded torques.

    A tenth of the domain's torque, halved until the motion stays within the domain.
    """
    share = 0.1
    for _ in range(8):
        out = _run(model, share)
        if np.all(model.domain.covers(out.x[:, : model.n], out.x[:, model.n :])):
            break
        share *= 0.5
    return out


def _run(model: Model, share: float) -> Reference:
    s, d, n = model.powered, model.domain, model.n
    rows = round(min(DURATION, s.horizon) / s.dt) + 1
    rng = np.random.default_rng(SEED)
    changes = rng.uniform(-share, share, (rows // HOLD + 1, n)) * np.minimum(np.abs(d.u.lo), np.abs(d.u.hi))
    wanted = np.repeat(changes, HOLD, axis=0)[:rows]
    t = s.dt * np.arange(rows, dtype=np.float64)
    temp = np.tile(d.temp.centre if d.temp is not None else np.full(n, REFERENCE_TEMPERATURE), (rows, 1))
    step = stepper(model)
    x, lo, hi, tau = (np.empty((rows, w)) for w in (2 * n, 2 * n, 2 * n, n))
    x[0] = np.concatenate([start_posture(model), np.zeros(n)])
    lo[0], hi[0] = x[0] + s.X0.lo, x[0] + s.X0.hi
    effects = model.input.effects
    states = memories_along(model.robot, effects, x[:1, :n], x[:1, n:], t=t[:1])
    for k in range(rows):
        now = slice(k, k + 1)
        q, dq = x[now, :n], x[now, n:]
        here: dict[str, Any] = {"temp": temp[now], "t": t[now], "memories": states}
        tau[k] = wanted[k] - model.input(q, dq, np.zeros((1, n)), **here)[0]
        u = model.input(q, dq, tau[now], **here)[0]
        states = memories_after(model.robot, effects, states, q, dq, s.dt, temp=temp[now])
        if k + 1 < rows:
            x[k + 1] = step(x[k], u)
            if not model.abstraction.linear:  # decoupled joints are cooperative: the corners stay the corners
                lo[k + 1], hi[k + 1] = step(lo[k], u + s.U.lo), step(hi[k], u + s.U.hi)
    if model.abstraction.linear:
        tube = deviation_tube(model.abstraction, s.boxed)  # what is exported is the box
        return Reference(t, tau, x, x + tube.lo[:rows], x + tube.hi[:rows], temp)
    return Reference(t, tau, x, lo + s.V.lo, hi + s.V.hi, temp)


def _csv(columns: Sequence[tuple[str, Array]]) -> str:
    out = io.StringIO()
    writer = csv.writer(out, quoting=csv.QUOTE_NONNUMERIC, lineterminator="\n")
    writer.writerow([name for name, _ in columns])
    for row in zip(*(values.tolist() for _, values in columns), strict=True):
        writer.writerow(row)
    return out.getvalue()


def _named(stem: str, joints: Sequence[str], values: Array) -> list[tuple[str, Array]]:
    return [(f"{stem}_{j}", values[:, k]) for k, j in enumerate(joints)]


def reference_texts(model: Model) -> tuple[str, str, str]:
    """Contents of ``*_in.csv``, ``*_ref.csv`` and ``*_ref.opt``."""
    r, J, n = reference(model), model.joints, model.n
    inputs = [("time", r.t), *_named("tau", J, r.tau), *_named("temp", J, r.temp)]
    inputs += [*_named("q_measured", J, r.x[:, :n]), *_named("dq_measured", J, r.x[:, n:])]
    inputs += [("stop", np.zeros(len(r.t), int)), ("measured", np.ones(len(r.t), int))]
    results = [("time", r.t), *_named("q", J, r.x[:, :n]), *_named("dq", J, r.x[:, n:])]
    results += [*_named("q_lo", J, r.lo[:, :n]), *_named("q_hi", J, r.hi[:, :n])]
    if model.powered.conform != "position":
        results += [*_named("dq_lo", J, r.lo[:, n:]), *_named("dq_hi", J, r.hi[:, n:])]
    dt = model.powered.dt
    options = f"StartTime, 0\nStopTime, {r.t[-1]!r}\nStepSize, {dt!r}\nRelTol, 1e-9\nAbsTol, 1e-9\nOutputIntervalLength, {dt!r}\n"
    return _csv(inputs), _csv(results), options


def reference_paths(fmu: str | Path) -> tuple[Path, Path, Path]:
    """Where the reference files of an FMU go: beside it, same stem."""
    p = Path(fmu)
    return p.with_name(f"{p.stem}_in.csv"), p.with_name(f"{p.stem}_ref.csv"), p.with_name(f"{p.stem}_ref.opt")


def write_reference(model: Model, fmu: str | Path) -> tuple[Path, Path, Path]:
    """Write the reference files beside an FMU; returns their paths."""
    paths = reference_paths(fmu)
    for path, text in zip(paths, reference_texts(model), strict=True):
        write_text(path, text)
    return paths
