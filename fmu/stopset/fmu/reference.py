"""Reference results: what the Python model says, for everyone who wants to check the FMU on their importer.

Inputs ``*_in.csv``, results ``*_ref.csv`` and solver options ``*_ref.opt`` in the layout of the FMI cross-check, and stop bounds
at a dozen states, ``*_stops.csv``, with every bit of the numbers.  All lie inside the unit, see `stopset.fmu.check`.  Each joint
swings to and fro, its torque held over each grid step; the measured inputs are the model's own motion, so that a model of motor
torque compensates gravity and friction at a known state.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from stopset.artifact import Model
from stopset.artifact.inputs import memories_after, memories_along
from stopset.effects import REFERENCE_TEMPERATURE
from stopset.effects.signals import Samples
from stopset.fmu.stops import bounds_of, stop_refusal
from stopset.fmu.variables import categories, start_posture
from stopset.reach.flowpipe import deviation_tube, discretise
from stopset.reach.stops.compiled import CompiledStops, Stopped
from stopset.reach.stops.ramp import ramp_of
from stopset.reach.stops.types import Category
from stopset.types import Array

DURATION = 2.0  # [s]
ORDER: tuple[Category, ...] = ("0", "1", "1 guaranteed", "2")  # of `categories`
STATES = 12  # at which stop bounds are compared
SEED = 2018
PULL = 10.0  # [1/s] by which the motion is drawn to the swing that it shall follow


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
    """The reference run of a model: two seconds or the horizon, from rest at the FMU's own start, every joint swinging.

    The swing is halved until motion and input stay within the domain.
    """
    share, d = 1.0, model.domain
    for _ in range(8):
        out, u = _run(model, share)
        inside = np.all(d.covers(out.x[:, : model.n], out.x[:, model.n :])) and np.all((u >= d.u.lo) & (u <= d.u.hi))
        if inside:
            break
        share *= 0.5
    return out


def _swing(model: Model, share: float, t: float, length: float) -> tuple[Array, Array, Array]:
    """Where each joint shall be at ``t``: angle, speed, acceleration (n,)."""
    d, start = model.domain, start_posture(model)
    w = 2.0 * np.pi / length * (1.0 + 0.5 * (np.arange(model.n) % 3))
    size = share * np.minimum(0.5 * d.q.radius, 1.2 * np.minimum(-d.dq.lo, d.dq.hi) / w)
    size = 0.5 * np.where(d.q.centre >= start, size, -size)
    return start + size * (1.0 - np.cos(w * t)), size * w * np.sin(w * t), size * w * w * np.cos(w * t)


def _torque(model: Model, wanted: Array, q: Array, dq: Array, here: dict[str, Any]) -> Array:
    """(1, n) whose input is ``wanted`` (n,): at rest friction takes its part in the direction that is wanted."""
    strong = np.where(wanted >= 0.0, 1e3, -1e3)[None]
    return strong + (wanted - model.input(q, dq, strong, **here)) * model.input.gain


def _run(model: Model, share: float) -> tuple[Reference, Array]:
    """The run, and its input (N, n) [N m]."""
    s, d, n, a = model.powered, model.domain, model.n, model.abstraction
    rows = round(min(DURATION, s.horizon) / s.dt) + 1
    t = s.dt * np.arange(rows, dtype=np.float64)
    temp = np.tile(d.temp.centre if d.temp is not None else np.full(n, REFERENCE_TEMPERATURE), (rows, 1))
    step, M = stepper(model), np.linalg.inv(a.Minv)
    x, lo, hi, tau, u = (np.empty((rows, w)) for w in (2 * n, 2 * n, 2 * n, n, n))
    x[0] = np.concatenate([start_posture(model), np.zeros(n)])
    lo[0], hi[0] = x[0] + s.X0.lo, x[0] + s.X0.hi
    effects = model.input.effects
    states = memories_along(model.robot, effects, Samples(x[:1, :n], x[:1, n:], t=t[:1]))
    for k in range(rows):
        now = slice(k, k + 1)
        q, dq = x[now, :n], x[now, n:]
        here: dict[str, Any] = {"temp": temp[now], "t": t[now], "memories": states}
        there, fast, acc = _swing(model, share, t[k], t[-1])
        damping = sum(a.viscous[:, i] * dq[0] ** (i + 1) for i in range(a.viscous.shape[1]))
        wanted = M @ (acc + 2.0 * PULL * (fast - dq[0]) + PULL**2 * (there - q[0])) + damping
        tau[k] = _torque(model, wanted, q, dq, here)[0]
        u[k] = model.input(q, dq, tau[now], **here)[0]
        states = memories_after(model.robot, effects, states, Samples(q, dq, temp=temp[now]), s.dt)
        if k + 1 < rows:
            x[k + 1] = step(x[k], u[k])
            if not a.linear:  # decoupled joints are cooperative: the corners stay the corners
                lo[k + 1], hi[k + 1] = step(lo[k], u[k] + s.U.lo), step(hi[k], u[k] + s.U.hi)
    if a.linear:
        tube = deviation_tube(a, s)
        return Reference(t, tau, x, x + tube.lo[:rows], x + tube.hi[:rows], temp), u
    return Reference(t, tau, x, lo + s.V.lo, hi + s.V.hi, temp), u


def _csv(columns: Sequence[tuple[str, Array]]) -> str:
    out = io.StringIO()
    writer = csv.writer(out, quoting=csv.QUOTE_NONNUMERIC, lineterminator="\n")
    writer.writerow([name for name, _ in columns])
    for row in zip(*(values.tolist() for _, values in columns), strict=True):
        writer.writerow(row)
    return out.getvalue()


def _named(stem: str, joints: Sequence[str], values: Array) -> list[tuple[str, Array]]:
    return [(f"{stem}_{j}", values[:, k]) for k, j in enumerate(joints)]


@dataclass(frozen=True, slots=True)
class Texts:
    """Contents of the reference files, by the ends of their names; ``stops`` is empty where no stop is bounded."""

    inputs: str
    results: str
    options: str
    stops: str

    def files(self, name: str) -> dict[str, str]:
        """File name -> text."""
        out = {"in.csv": self.inputs, "ref.csv": self.results, "ref.opt": self.options, "stops.csv": self.stops}
        return {f"{name}_{end}": text for end, text in out.items() if text}


def reference_texts(model: Model) -> Texts:
    """The reference run and stop bounds of a model as texts."""
    r, J, n = reference(model), model.joints, model.n
    inputs = [("time", r.t), *_named("tau", J, r.tau), *_named("temp", J, r.temp)]
    inputs += [*_named("q_measured", J, r.x[:, :n]), *_named("dq_measured", J, r.x[:, n:])]
    inputs += [("stop", np.zeros(len(r.t), int)), ("measured", np.ones(len(r.t), int))]
    results = [("time", r.t), *_named("q", J, r.x[:, :n]), *_named("dq", J, r.x[:, n:])]
    results += [*_named("q_lo", J, r.lo[:, :n]), *_named("q_hi", J, r.hi[:, :n])]
    if model.powered.conform != "position":
        results += [*_named("dq_lo", J, r.lo[:, n:]), *_named("dq_hi", J, r.hi[:, n:])]
    dt, end = model.powered.dt, float(r.t[-1])
    options = f"StartTime, 0\nStopTime, {end!r}\nStepSize, {dt!r}\nRelTol, 1e-9\nAbsTol, 1e-9\nOutputIntervalLength, {dt!r}\n"
    return Texts(_csv(inputs), _csv(results), options, _stops(model, r))


def _stops(model: Model, r: Reference) -> str:
    """Measured states, half of them of the run and half anywhere in the domain, and their bounds; nan where there is none."""
    if stop_refusal(model):
        return ""
    setting, d, n, J = bounds_of(model).setting, model.domain, model.n, model.joints
    assert setting is not None
    stops, rng = CompiledStops.of(setting, ramp_of(model)), np.random.default_rng(SEED)
    anywhere = rng.uniform(np.concatenate([d.q.lo, d.dq.lo]), np.concatenate([d.q.hi, d.dq.hi]), (STATES // 2, 2 * n))
    inside = np.clip(anywhere[:, :n], model.robot.q_limit[:, 0], model.robot.q_limit[:, 1])
    x = np.vstack([r.x[np.linspace(0, len(r.t) - 1, STATES - STATES // 2).astype(int)], np.hstack([inside, anywhere[:, n:]])])
    none = Stopped(*(np.full(k, np.nan) for k in (n, n, n, n, 2)))
    columns = [*_named("q_measured", J, x[:, :n]), *_named("dq_measured", J, x[:, n:])]
    for kind, c in zip(ORDER, categories(model), strict=False):
        found = [stops.bound(row[:n], row[n:], kind) or none for row in x]
        for stem, part in ((f"{c.stem}_time", "time"), (f"{c.stem}_forward", "forward"), (f"{c.stem}_back", "back")):
            columns += _named(stem, J, np.array([getattr(b, part) for b in found]))
        tool = np.array([b.tool for b in found])
        columns += [(f"{c.tool}_distance", tool[:, 0]), (f"{c.tool}_speed", tool[:, 1])]
    return _csv(columns)
