"""What the FMU computes is what the monitor computes, to the last bit: motion, tube, and the verdict of every sample."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmu_models import arm_model
from fmu_unit import Unit, unit
from stopset.artifact import Model
from stopset.artifact.inputs import memories_after, memories_along
from stopset.effects import catalogue
from stopset.effects.memory import affine
from stopset.effects.signals import Samples
from stopset.fmu import Contents, export
from stopset.monitor.check import Check
from stopset.monitor.sample import Quantum, Sample
from stopset.monitor.verdict import Conformance
from stopset.monitor.watch import Watch
from stopset.reach.flowpipe import deviation_tube
from stopset.reach.predict import predict
from stopset.sets import Zonotope
from stopset.types import Array
from test_fmu import DT, EFFECTS, HERE, friction, swift
from test_fmu_memory import lasting

pytest.importorskip("fmpy")
pytest.importorskip("ziglang")
pytestmark = pytest.mark.skipif(HERE is None, reason="no FMU binaries for this platform")
TEMP = 28.0


def slanted() -> Model:
    """Its torque set is a zonotope."""
    model = arm_model(3, coupled=True, horizon=0.8)
    U = Zonotope(np.array([0.1, 0.2, -0.1]), np.array([[0.6, 0.0, 0.3, 0.1], [0.0, 0.7, 0.4, -0.2], [0.2, 0.0, 0.5, 0.3]]))
    return replace(model, sets={"powered": replace(model.powered, U=U.box, zonotope=U)})


def of(model: Model, **changes: Any) -> Model:
    return replace(model, sets={"powered": replace(model.powered, **changes)})


MODELS: dict[str, Callable[[], Model]] = {
    "plain": lambda: arm_model(horizon=1.0),
    "coupled": lambda: arm_model(4, coupled=True, offset=True, horizon=0.6),
    "torques": lambda: arm_model(3, effort="motor_torque", effects=EFFECTS, offset=True, horizon=0.7),
    "swift": lambda: swift(arm_model(3, effort="motor_torque", effects=EFFECTS, horizon=0.7)),
    "gain": lambda: arm_model(2, effort="motor_torque", effects=[friction("torque_gain", "axis_2", e=0.1)], horizon=0.7),
    "memory": lambda: replace(lasting(), sets={"powered": replace(lasting().powered, horizon=0.7)}),
    "positions": lambda: of(arm_model(3, horizon=0.6), conform="position"),
    "from the start": lambda: of(arm_model(3, horizon=0.6), windows="start"),
    "zonotope": slanted,
}  # fmt: skip


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Model, str], Path]:
    folder = tmp_path_factory.mktemp("watch")
    done: dict[str, Path] = {}

    def made(model: Model, name: str) -> Path:
        if name not in done:
            done[name] = export(model, folder / f"{name}.fmu", Contents(3, (str(HERE),), reference=False))
        return done[name]

    return made


def connect(u: Unit, model: Model, q: Array, dq: Array, tau: Array, temp: float = TEMP) -> None:
    u.state(model, q, dq)
    u.set({f"tau_{j}": x for j, x in zip(model.joints, tau.tolist(), strict=True)})
    u.set({f"temp_{j}": TEMP for j in model.joints} | {f"temp_{model.joints[1]}": temp})


def swinging(model: Model, rows: int, seed: int) -> tuple[Array, Array, Array]:
    """q, dq, tau (rows, n) of a motion inside the domain, torques that nearly belong to it."""
    rng, n, t = np.random.default_rng(seed), model.n, DT * np.arange(rows)[:, None]
    w, phase = rng.uniform(1.0, 4.0, n), rng.uniform(0.0, 6.0, n)
    q, dq = 0.3 * np.sin(w * t + phase), 0.3 * w * np.cos(w * t + phase)
    a, temp = model.abstraction, np.full((rows, n), TEMP)
    u = (np.linalg.inv(a.Minv) @ (-0.3 * w**2 * np.sin(w * t + phase)).T).T + a.viscous[:, 0] * dq
    one = np.full_like(q, 1e3) * np.where(dq >= 0, 1.0, -1.0)
    tau = one + (u - model.input(q, dq, one, temp=temp, t=t[:, 0])) * model.input.gain
    return q, dq, tau


@pytest.mark.parametrize("name", MODELS)
def test_motion_and_tube_have_the_bits_of_python(exported: Any, name: str) -> None:
    """Every step of the model's own length: state, bounds, and what is remembered."""
    model = MODELS[name]()
    n, rows = model.n, 60
    q, dq, tau = swinging(model, rows, 1)
    tube, temp = deviation_tube(model.abstraction, model.powered), np.full((1, n), TEMP)
    x, m = np.concatenate([q[0], dq[0]]), model.input
    states = memories_along(model.robot, m.effects, Samples(q[:1], dq[:1], t=np.zeros(1)))
    with unit(exported(model, name)) as u:
        u.set(dict(zip([f"{s}_start_{j}" for s in ("q", "dq") for j in model.joints], x.tolist(), strict=True)))
        connect(u, model, q[0], dq[0], tau[0])
        u.begin()
        for k in range(rows - 1):
            now = slice(k, k + 1)
            connect(u, model, q[k], dq[k], tau[k])
            for stem, bound in (("lo", tube.lo[k]), ("hi", tube.hi[k])):
                got = np.concatenate([u.joints(f"{s}_{stem}", model.joints) for s in ("q", "dq")])
                assert np.array_equal(got, x + bound), (k, stem)
            u.step(DT)
            given = m(q[now], dq[now], tau[now], temp=temp, t=np.zeros(1), memories=states)
            x = predict(model.abstraction, DT, x, np.vstack([given, given]))[1]
            states = memories_after(model.robot, m.effects, states, Samples(q[now], dq[now], temp=temp), DT)
            assert np.array_equal(np.concatenate([u.joints(s, model.joints) for s in ("q", "dq")]), x), k


SAID = {Conformance.UNKNOWN: 0, Conformance.CONFORMANT: 1, Conformance.VIOLATION: 2}


def verdicts(
    path: Path,
    watch: Check,
    motion: tuple[Array, Array, Array],
    h: float,
    push: float,
    first: tuple[int, ...] = (1,),
) -> set[Conformance]:
    """What monitor and unit say of a motion q, dq, tau (rows, n) every ``h`` s until a violation: the same.

    The torque is ``push`` times U off for half of the time, readings have noise, one sample is outside the domain.
    ``first``: what the unit may also say of the first sample.
    """
    model, (q, dq, tau), rng, seen = watch.model, motion, np.random.default_rng(7), set()
    n, rows, V, U = model.n, len(tau), model.powered.V, model.powered.U
    tau = tau - push * U.hi * (np.sin(0.1 * np.arange(rows)) > 0.0)[:, None]
    q, dq = q + 0.3 * rng.uniform(V.lo[:n], V.hi[:n], q.shape), dq + 0.3 * rng.uniform(V.lo[n:], V.hi[n:], q.shape)
    temp = np.full((rows, n), TEMP)
    temp[20, 1] = 60.0
    with unit(path) as u:
        # the unit's own prediction is not what is compared here: it begins where the arm never is refuted
        u.set(dict(zip([f"{s}_start_{j}" for s in ("q", "dq") for j in model.joints], [*q[0], *dq[0]], strict=True)))
        connect(u, model, q[0], dq[0], tau[0])
        u.begin()
        for k in range(rows):
            connect(u, model, q[k], dq[k], tau[k], temp[k, 1])
            u.step(h)
            want = watch.step(Sample(k, k * h, q[k], dq[k], tau[k], temp[k]))
            got = u.get("verdict")
            assert got == SAID[want.conformance] or (k == 0 and got in first), (k, want)
            seen.add(want.conformance)
            if want.conformance is Conformance.VIOLATION:
                assert u.get("violated_joint") in {model.joints.index(d.joint) + 1 for d in want.deviations}
                break
    return seen


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("push", [0.3, 1.5])
def test_every_sample_s_verdict_is_the_monitor_s(exported: Any, name: str, push: float) -> None:
    """Torque that the arm does not follow, of half of U and beyond it, readings with noise, one sample outside the domain."""
    model = MODELS[name]()
    watch = Watch(model, Quantum.none(model.n), None, (0.0, 0.0))
    seen = verdicts(exported(model, name), watch, swinging(model, 150, 5), DT, push)
    assert Conformance.CONFORMANT in seen and (push > 1.0) == (Conformance.VIOLATION in seen), seen
    assert Conformance.UNKNOWN in seen


def test_a_step_of_another_length_begins_the_comparison_anew(exported: Any) -> None:
    """Samples that are not one grid step apart predict nothing of each other; the unit's own prediction is still held against."""
    model = MODELS["plain"]()
    q = np.full(model.n, 0.1)
    with unit(exported(model, "plain")) as u:
        u.set({f"q_start_{j}": 0.1 for j in model.joints})
        u.begin()
        for h in (DT, DT, 0.004, DT, 0.02, DT):
            connect(u, model, q, 0.0 * q, 0.0 * q)
            u.step(h)
            assert u.get("verdict") == 1
        connect(u, model, q + 0.05, 0.0 * q, 0.0 * q)
        u.step(0.004)
        assert u.get("verdict") == 2


COMPENSATED = sorted(
    e.name
    for e in catalogue().values()
    if e.compensated() and "dtau" not in e.needs and (not e.states or affine(e)) and e.scope != "pair"
)


def fitted(name: str, seed: int) -> Any:
    e, rng = catalogue()[name], np.random.default_rng(seed)
    values = {p.symbol: float(rng.uniform(max(p.lo, -0.2), min(p.hi, 0.3))) for p in e.terms}
    values |= {p.symbol: p.grid[len(p.grid) // 2] for p in e.shapes}
    return friction(name, None if e.scope == "arm" else f"axis_{1 + seed % 3}", **values)


def test_every_effect_of_the_catalogue_and_from_outside_has_the_monitor_s_bits(exported: Any, own_effect: object) -> None:
    """All laws at once, none of them known to the unit by name; with other parameters than identified too."""
    effects = [fitted(name, k) for k, name in enumerate([*COMPENSATED, "relaxing_hose"])]
    model = arm_model(3, effort="motor_torque", effects=effects, offset=True, horizon=0.3)
    q, dq, tau = swinging(model, 12, 8)
    assert len(effects) > 12
    with unit(exported(model, "every effect")) as u:
        connect(u, model, q[0], dq[0], tau[0])
        u.begin()
        states = memories_along(model.robot, model.input.effects, Samples(q[:1], dq[:1], t=np.zeros(1)))
        for k in range(10):
            now, temp = slice(k, k + 1), np.full((1, 3), TEMP)
            x = np.concatenate([u.joints(s, model.joints) for s in ("q", "dq")])
            connect(u, model, q[k], dq[k], tau[k])
            u.step(DT)
            given = model.input(q[now], dq[now], tau[now], temp=temp, t=np.array([k * DT]), memories=states)
            want = predict(model.abstraction, DT, x, np.vstack([given, given]))[1]
            states = memories_after(model.robot, model.input.effects, states, Samples(q[now], dq[now], temp=temp), DT)
            assert np.array_equal(np.concatenate([u.joints(s, model.joints) for s in ("q", "dq")]), want)
