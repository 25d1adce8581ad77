"""Reference results: what the Python model says, for everyone who wants to check the FMU on their importer.

Inputs ``*_in.csv``, results ``*_ref.csv`` and solver options ``*_ref.opt`` in the layout of the FMI cross-check.  Torque
changes every ten grid steps and is held between; the measured inputs are the model's own motion, so that a model of motor
torque compensates gravity and friction at a known state.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from stopset.artifact import Model
from stopset.files import write_text
from stopset.reach.flowpipe import deviation_tube, predict

Array = NDArray[np.float64]
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


def simulate(model: Model, x0: Array, u: Array) -> Array:
    """Motion (N, 2n) of the abstraction under inputs ``u`` (N, n) held over each grid step."""
    a, dt, n = model.abstraction, model.powered.dt, model.n
    if a.linear:
        return predict(a, dt, x0, u)
    out = np.empty((u.shape[0], 2 * n))
    out[0] = x0
    for k in range(u.shape[0] - 1):

        def flow(_: float, x: Array, held: Array = u[k : k + 1]) -> Array:
            return np.concatenate([x[n:], a.ddq(x[None, :n], x[None, n:], held)[0]])

        # three digits below the 1e-9 that the FMU has to meet over some thousand steps
        out[k + 1] = solve_ivp(flow, (0.0, dt), out[k], method="DOP853", rtol=1e-13, atol=1e-15).y[:, -1]
    return out


def _corners(model: Model, x: Array, u: Array) -> tuple[Array, Array]:
    """Lower and upper bounds of the measured state: two simulations, because decoupled joints are cooperative."""
    s = model.powered
    lo = simulate(model, x[0] + s.X0.lo, u + s.U.lo) + s.V.lo
    hi = simulate(model, x[0] + s.X0.hi, u + s.U.hi) + s.V.hi
    return lo, hi


def reference(model: Model) -> Reference:
    """The reference run of a model: seeded torques of a tenth of its domain, ten seconds or the horizon, from rest."""
    s, d, n = model.powered, model.domain, model.n
    rows = round(min(DURATION, s.horizon) / s.dt) + 1
    rng = np.random.default_rng(SEED)
    changes = rng.uniform(-0.1, 0.1, (rows // HOLD + 1, n)) * np.minimum(np.abs(d.u.lo), np.abs(d.u.hi))
    u = np.repeat(changes, HOLD, axis=0)[:rows]
    start = np.clip(np.zeros(n), d.q.lo, d.q.hi)
    x = simulate(model, np.concatenate([start, np.zeros(n)]), u)
    temp = d.temp.centre if d.temp is not None else np.full(n, 30.0)
    temps = np.tile(temp, (rows, 1))
    t = s.dt * np.arange(rows)
    taken_off = model.input(x[:, :n], x[:, n:], np.zeros_like(u), temp=temps, warm=0.0, t=t)
    if model.abstraction.linear:
        tube = deviation_tube(model.abstraction, s)
        lo, hi = x + tube.lo[:rows], x + tube.hi[:rows]
    else:
        lo, hi = _corners(model, x, u)
    return Reference(t, u - taken_off, x, lo, hi, temps)


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
    inputs += [("stop", np.zeros(len(r.t), int)), ("measured", np.ones(len(r.t), int))]  # type: ignore[list-item]
    results = [("time", r.t), *_named("q", J, r.x[:, :n]), *_named("dq", J, r.x[:, n:])]
    results += [*_named("q_lo", J, r.lo[:, :n]), *_named("q_hi", J, r.hi[:, :n])]
    if model.powered.conform != "position":
        results += [*_named("dq_lo", J, r.lo[:, n:]), *_named("dq_hi", J, r.hi[:, n:])]
    dt = model.powered.dt
    options = (
        f"StartTime, 0\nStopTime, {r.t[-1]!r}\nStepSize, {dt!r}\nRelTol, 1e-9\nAbsTol, 1e-9\nOutputIntervalLength, {dt!r}\n"
    )
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
