"""Nonlinear models in the FMU: cubic friction, models 2 and 3, with the bits of what identification and monitor compute."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fmu_models import arm_model
from fmu_unit import unit
from stopset.artifact import Model
from stopset.artifact.inputs import memories_after, memories_along
from stopset.effects.signals import Samples
from stopset.fmu import Contents, export
from stopset.monitor.along import watch_for
from stopset.monitor.sample import Quantum
from stopset.monitor.verdict import Conformance
from stopset.offline.abstraction import build
from stopset.reach.nonlinear import FAR, nominal, predicted_tube
from stopset.reach.predict import predict
from stopset.types import Array
from test_fmu import EFFECTS, HERE, friction
from test_fmu_watch import TEMP, connect, swinging, verdicts

pytest.importorskip("fmpy")
pytest.importorskip("ziglang")
pytestmark = pytest.mark.skipif(HERE is None, reason="no FMU binaries for this platform")


def of_kind(kind: int, order: int, **changes: Any) -> Model:
    """Its abstraction is that of its own rigid body; joints feel each other."""
    model = arm_model(3, horizon=0.4, **changes)
    a = build(kind, order, model.robot, np.full(3, 0.4), model.abstraction.viscous)
    return replace(model, abstraction=a)


def from_the_start(model: Model) -> Model:
    return replace(model, sets={"powered": replace(model.powered, windows="start")})


MODELS: dict[str, Callable[[], Model]] = {
    "cubic": lambda: arm_model(4, cubic=0.2, horizon=0.3),
    "cubic, torques": lambda: arm_model(3, cubic=0.2, effort="motor_torque", effects=EFFECTS, offset=True, horizon=0.3),
    "cubic, from the start": lambda: from_the_start(arm_model(3, cubic=0.2, horizon=0.3)),
    "cubic, coupled": lambda: arm_model(3, cubic=0.1, coupled=True, horizon=0.3),
    "model 2": lambda: of_kind(2, 3),
    "model 2, torques": lambda: of_kind(2, 3, effort="motor_torque", effects=[friction("stribeck", "axis_1", F_s=2.0, v_s=0.1)]),
    "model 3": lambda: of_kind(3, 3),
    "model 3, from the start": lambda: from_the_start(of_kind(3, 2)),
}  # fmt: skip


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Model, str], Path]:
    folder, done = tmp_path_factory.mktemp("nonlinear"), {}

    def made(model: Model, name: str) -> Path:
        if name not in done:
            done[name] = export(model, folder / f"{name.replace(',', '')}.fmu", Contents(3, (str(HERE),), reference=False))
        return done[name]

    return made


@pytest.mark.parametrize("name", MODELS)
def test_motion_and_bounds_have_the_bits_of_python(exported: Any, name: str) -> None:
    """Every step of the model's own grid, until the oldest age; then there are none."""
    model = MODELS[name]()
    n, dt, rows = model.n, model.powered.dt, round(model.powered.horizon / model.powered.dt) + 1
    q, dq, tau = swinging(model, rows, 1)
    q, dq, tau = 0.3 * q, 0.3 * dq, tau
    x, u = np.empty((rows, 2 * n)), np.empty((rows, n))
    x[0] = np.concatenate([q[0], dq[0]])
    states = memories_along(model.robot, model.input.effects, Samples(q[:1], dq[:1], t=np.zeros(1)))
    for k in range(rows):
        now = slice(k, k + 1)
        u[k] = model.input(q[now], dq[now], tau[now], temp=np.full((1, n), TEMP), t=np.zeros(1), memories=states)[0]
        states = memories_after(
            model.robot, model.input.effects, states, Samples(q[now], dq[now], temp=np.full((1, n), TEMP)), dt
        )
        if k + 1 < rows:
            x[k + 1] = predict(model.abstraction, dt, x[k], np.vstack([u[k], u[k]]))[1]
    ends = [[b[k] for b in predicted_tube(model.abstraction, model.powered, x[0], u[: max(k, 1)])] for k in range(rows)]
    lo, hi = np.array([e[0] for e in ends]), np.array([e[1] for e in ends])
    last = rows - 1 if model.abstraction.decoupled else min(rows - 1, FAR)
    with unit(exported(model, name)) as unit_:
        unit_.set(dict(zip([f"{s}_start_{j}" for s in ("q", "dq") for j in model.joints], x[0].tolist(), strict=True)))
        connect(unit_, model, q[0], dq[0], tau[0])
        unit_.begin()
        for k in range(last + 1):
            connect(unit_, model, q[k], dq[k], tau[k])
            assert np.array_equal(np.concatenate([unit_.joints(s, model.joints) for s in ("q", "dq")]), x[k]), k
            for stem, bound in (("lo", lo[k]), ("hi", hi[k])):
                got = np.concatenate([unit_.joints(f"{s}_{stem}", model.joints) for s in ("q", "dq")])
                assert np.array_equal(got, bound), (k, stem, got - bound)
            unit_.step(dt)
        unit_.step(dt)
        assert np.all(np.isnan(unit_.joints("q_lo", model.joints))) and unit_.get("covered") == 0


def driven(model: Model, rows: int, h: float) -> tuple[Array, Array, Array]:
    """q, dq, tau (rows, n) every ``h`` [s] of the model's own motion under a swinging input."""
    n, t = model.n, h * np.arange(rows)[:, None]
    u = np.linspace(6.0, 3.0, n) * np.sin(np.linspace(9.0, 14.0, n) * t + np.arange(n))
    x = nominal(model.abstraction, np.zeros((1, 2 * n)), u[None, :-1], h)[0]
    q, dq, temp = x[:, :n], x[:, n:], np.full((rows, n), TEMP)
    strong = np.where(dq >= 0.0, 1e3, -1e3)
    return q, dq, strong + (u - model.input(q, dq, strong, temp=temp, t=t[:, 0])) * model.input.gain


@pytest.mark.parametrize("every", [1, 3])
@pytest.mark.parametrize("push", [0.3, 3.0])
@pytest.mark.parametrize("name", MODELS)
def test_every_sample_s_verdict_is_the_monitor_s(exported: Any, name: str, push: float, every: int) -> None:
    """Also where the grid is coarser than the samples; torque of half of U and beyond it, one sample outside the domain."""
    model = MODELS[name]()
    h = model.powered.dt / every
    watch = watch_for(model, Quantum.none(model.n), None, (0.0, 1.0), h)
    seen = verdicts(exported(model, name), watch, driven(model, 60 * every, h), h, push, first=(0, 1))
    assert (push > 1.0) == (Conformance.VIOLATION in seen), seen
    assert push > 1.0 or Conformance.CONFORMANT in seen


@pytest.mark.parametrize("name", ["model 2, torques", "model 3, torques"])
def test_a_free_run_is_the_model_s_motion(exported: Any, name: str) -> None:
    """Friction and gravity at its own state, in sticking and sliding: Python's accelerations, integrated finely; nothing is covered."""
    kind = int(name[6])
    laws = [friction("viscous", "axis_2", F_v=4.0), friction("spring", "axis_3", k=5.0, c=0.2)]
    model = of_kind(kind, 3, effort="motor_torque", effects=laws)
    n, start = model.n, np.array([0.2, -0.3, 0.4, 0.3, -0.2, 0.1])
    tau = np.array([3.0, -9.0, 2.0])

    def flow(_: float, y: Array) -> Array:
        u = model.input(y[None, :n], y[None, n:], tau[None], temp=np.full((1, n), TEMP), t=np.zeros(1))
        return np.concatenate([y[n:], model.abstraction.ddq(y[None, :n], y[None, n:], u)[0]])

    want = solve_ivp(flow, (0.0, 0.3), start, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    with unit(exported(model, name + " free")) as u:
        u.set(dict(zip([f"{s}_start_{j}" for s in ("q", "dq") for j in model.joints], start.tolist(), strict=True)))
        u.set(
            dict(zip([f"tau_{j}" for j in model.joints], tau.tolist(), strict=True)) | {f"temp_{j}": TEMP for j in model.joints}
        )
        u.begin()
        acc = flow(0.0, start)[n:]
        assert np.abs(u.joints("ddq", model.joints) - acc).max() < 1e-9
        for _ in range(30):
            u.step(0.01)
        got = np.concatenate([u.joints(s, model.joints) for s in ("q", "dq")])
        assert np.abs(got - want).max() < 1e-9
        assert u.get("covered") == 0
