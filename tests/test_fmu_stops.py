"""Stops in the FMU: the core's proof, bit for bit what Python gets, and only for states that it was made for."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmu_models import arm_model
from fmu_unit import Unit, unit
from stopset.artifact import Brakes, Model
from stopset.fmu import Contents, export
from stopset.fmu.stops import bounds_of
from stopset.reach.stops import StopBound, StopBounds
from stopset.reach.stops.regions import FrictionRegion, PowerOff, power_off, regions
from stopset.sets import Box
from stopset.simulation.stop import StoppingArm, simulate_stop
from stopset.types import Array
from test_fmu import AGREE, EFFECTS, HERE, friction, joint_inputs, names, simulate


def braked(rotor: float, n: int = 4, spread: float = 0.1, **model_options: Any) -> Model:
    """An arm with brakes known to ``spread`` and rotors of ``rotor`` kg m^2; much of it hardly couples, little does."""
    model = arm_model(n, **model_options)
    J = np.full(n, rotor)
    torque = np.linspace(160.0, 60.0, n)
    return replace(
        model,
        rotor=J,
        abstraction=replace(model.abstraction, Minv=np.diag(1.0 / (J + 0.1))),
        brakes=Brakes(
            torque=Box.of(torque * (1 - spread), torque * (1 + spread)),
            delay=Box.of(np.full(n, 0.015), np.full(n, 0.025)),
            rise=Box.of(np.full(n, 0.005), np.full(n, 0.020)),
        ),
    )


def cut_together(apart: float, lag: Array | None = None) -> Model:
    """Brakes of one power stage: bounded once for every window of their common delay."""
    model = braked(8.0)
    assert model.brakes is not None
    brakes = replace(model.brakes, delay=Box.of(np.full(4, 0.010), np.full(4, 0.040)), apart=apart, lag=lag)
    return replace(model, brakes=brakes)


def core_stop(bounds: StopBounds) -> Callable[..., PowerOff | None]:
    assert bounds.setting is not None
    return power_off(bounds.setting)


def in_region(bounds: StopBounds, region: FrictionRegion) -> StopBounds:
    """The Python bounds with the friction of one region, wherever the stop leads."""
    assert bounds.setting is not None
    torques = replace(bounds.setting.torques, roaming=(), speed=np.full(bounds.model.n, np.inf))
    return replace(bounds, setting=replace(bounds.setting, plant=region.plant, torques=torques))


MODELS: dict[str, Callable[[], Model]] = {
    "tube": lambda: braked(8.0),
    "energy": lambda: braked(1.3),
    "six joints": lambda: braked(12.0, 6),
    "motor torque": lambda: braked(
        8.0, 3, effort="motor_torque", offset=True,
        effects=[friction("coulomb", "axis_1", F_c=3.0), friction("viscous", "axis_2", F_v=20.0), friction("encoder_offset", "axis_2", e=0.01)],
    ),
    "together": lambda: cut_together(0.004),
    "together, one late": lambda: cut_together(0.03, np.array([0.0, 0.002, 0.0, 0.004])),
    "no such stop": lambda: cut_together(0.001, np.array([0.0, 0.1, 0.0, 0.0])),
}  # fmt: skip


def states(model: Model, count: int, seed: int, fast: float = 0.5) -> list[tuple[Array, Array]]:
    rng, d = np.random.default_rng(seed), model.domain
    return [
        (rng.uniform(d.q.lo, d.q.hi), rng.uniform(d.dq.lo, d.dq.hi) * rng.uniform(0.0, fast)) for _ in range(count)
    ]  # fmt: skip


@pytest.mark.parametrize("name", MODELS)
def test_the_core_s_bound_is_python_s_to_the_last_bit(name: str) -> None:
    """Of states and of boxes of states; what the one refuses the other does."""
    bounds = bounds_of(MODELS[name]())
    core, n, certified = core_stop(bounds), bounds.model.n, 0
    for k, (q, dq) in enumerate(states(bounds.model, 12, 3)):
        rq, rdq = (np.zeros(n), np.zeros(n)) if k % 2 else (np.full(n, 2e-3), np.full(n, 1e-2))
        want, got = bounds.bound(q, dq, "0", rq, rdq), core(q, dq, rq, rdq)
        assert want.certified == (got is not None)
        if got is None:
            continue
        certified += 1
        for mine, theirs in ((got.time, want.time), (got.forward, want.forward), (got.back, want.back), (got.speed, want.speed)):
            assert np.array_equal(mine, theirs)  # type: ignore[arg-type]
        assert got.tool.tolist() == [want.tcp, want.tcp_speed]
    assert certified >= 4


@pytest.mark.parametrize("effect", [{"effect": "spring", "k": 8.0, "c": 0.1}, {"effect": "stribeck", "F_s": 6.0, "v_s": 0.06}])
def test_effects_that_depend_on_the_state_are_those_of_a_region_that_holds_the_stop(effect: dict[str, Any]) -> None:
    """Bit for bit the proof with that region's friction; never tighter than the laws where the stop is; none beyond the last."""
    values = {k: v for k, v in effect.items() if k != "effect"}
    bounds = bounds_of(braked(8.0, 3, effort="motor_torque", effects=[friction(effect["effect"], "axis_2", **values)]))
    core, places, beyond_first = core_stop(bounds), regions(bounds.setting), 0  # type: ignore[arg-type]
    for q, dq in states(bounds.model, 10, 4, 1.0):
        got, exact = core(q, dq), bounds.bound(q, dq)
        assert got is not None and exact.certified and exact.forward is not None and exact.back is not None
        slack = 1e-12
        assert np.all(got.forward >= exact.forward - slack) and np.all(got.back >= exact.back - slack)
        holds = []
        for r in places:
            want = in_region(bounds, r).bound(q, dq)
            if np.array_equal(got.forward, want.forward) and got.tool[0] == want.tcp:  # type: ignore[arg-type]
                holds.append(bool(np.all(got.speed <= r.speed)))
        assert any(holds)
        beyond_first += bool(np.any(got.speed > places[0].speed))
    assert 0 < beyond_first < 10
    v = 1.01 * places[-1].speed
    assert core(0.0 * v, v) is None


def worst_of_samples(
    bounds: StopBounds, q: Array, dq: Array, rq: Array, rdq: Array, count: int, seed: int
) -> tuple[Array, float]:
    """Largest angle (n,) and latest rest of sampled stops of the full nonlinear arm from the box of measured states."""
    rng, model, s = np.random.default_rng(seed), bounds.model, bounds.setting
    assert s is not None
    n, p = model.n, s.plant
    angle, time = np.zeros(n), 0.0
    for k in range(count):
        corner = k % 2 == 0

        def draw(lo: Array, hi: Array, sharp: bool = corner) -> Array:
            return np.where(rng.random(n) < 0.5, lo, hi) if sharp else rng.uniform(lo, hi)

        lo, hi = s.start.lo, s.start.hi
        q0, v0 = draw(q - rq + lo[:n], q + rq + hi[:n]), draw(dq - rdq + lo[n:], dq + rdq + hi[n:])
        u = np.array([draw(p.u_lo, p.u_hi) for _ in range(4)])
        body = p.pi + rng.uniform(-1.0, 1.0) * p.pi_half
        qs, vs = simulate_stop(
            StoppingArm(model.robot.chain, body, draw(p.rotor - p.rotor_half, p.rotor + p.rotor_half), p.coulomb_lo, np.zeros(n),
            draw(p.brake_lo, p.brake_hi), draw(p.delay_lo, p.delay_hi), draw(p.rise_lo, p.rise_hi)), q0, v0, 5e-4, 800, u,
        )  # fmt: skip
        angle = np.maximum(angle, np.abs(qs - qs[0]).max(axis=0))
        moving = np.flatnonzero(np.any(vs != 0.0, axis=1))
        time = max(time, 5e-4 * (moving[-1] if moving.size else 0))
    return angle, time


@pytest.mark.parametrize(("rotor", "speed"), [(8.0, 0.6), (8.0, 0.2), (1.3, 0.3)])
def test_no_sampled_stop_goes_beyond_either_proof(rotor: float, speed: float) -> None:
    """By joint speeds (heavy rotors), and with the help of the kinetic energy (light ones)."""
    bounds, rng = bounds_of(braked(rotor)), np.random.default_rng(11)
    core, n = core_stop(bounds), bounds.model.n
    rq, rdq = np.full(n, 1e-3), np.full(n, 5e-3)
    for trial in range(4):
        q, dq = rng.uniform(-2, 2, n), rng.uniform(-speed, speed, n)
        angle, time = worst_of_samples(bounds, q, dq, rq, rdq, 30, trial)
        got = core(q, dq, rq, rdq)
        assert got is not None
        assert np.all(angle <= np.maximum(got.forward, got.back))
        assert time <= got.time.max()


def test_no_brakes_or_too_weak_ones_prove_nothing() -> None:
    model = braked(8.0)
    q, dq = np.full(model.n, 0.8), np.full(model.n, 0.1)
    assert core_stop(bounds_of(model))(q, dq) is not None
    assert model.brakes is not None
    weak = replace(model.brakes, torque=Box.of(0.01 * model.brakes.torque.lo, model.brakes.torque.hi))
    assert core_stop(bounds_of(replace(model, brakes=weak)))(q, dq) is None
    with pytest.raises(Exception, match="knows no brakes"):
        bounds_of(replace(model, brakes=None))


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Any:
    folder = tmp_path_factory.mktemp("stops")

    def of(model: Model, name: str) -> Path:
        pytest.importorskip("ziglang")
        pytest.importorskip("fmpy")
        return export(model, folder / f"{name}.fmu", Contents(3, (str(HERE),), reference=False))

    return of


PER_JOINT, TOOL = ("stop_time", "stop_forward", "stop_back"), ("tcp_stop_distance", "tcp_stop_speed")
OUTPUTS = (*PER_JOINT, "stop_angle")


def equals(u: Unit, model: Model, want: StopBound) -> bool:
    """Whether the unit's stop outputs are that bound to the last bit, or say as it does that there is none."""
    if not want.certified:
        return silent(u, model)
    assert want.angle is not None and want.time is not None and want.forward is not None and want.back is not None
    values = zip(OUTPUTS, (want.time, want.forward, want.back, want.angle), strict=True)
    good = all(np.array_equal(u.joints(stem, model.joints), x) for stem, x in values)
    return good and [u.get(x) for x in TOOL] == [want.tcp, want.tcp_speed] and u.get("stop_certified") == 1


def silent(u: Unit, model: Model) -> bool:
    """No bound: not a number anywhere, and said so."""
    every = np.concatenate([*(u.joints(stem, model.joints) for stem in OUTPUTS), [u.get(x) for x in (*TOOL, "stop_age")]])
    return bool(np.all(np.isnan(every))) and u.get("stop_certified") == 0


@pytest.mark.parametrize("name", ["tube", "energy", "motor torque", "together, one late"])
def test_the_fmu_s_bounds_are_python_s_to_the_last_bit(exported: Any, name: str) -> None:
    """At measured states, and at its own where nothing is measured: then it is the arm."""
    model = MODELS[name]()
    bounds, fmu = bounds_of(model), exported(model, name.replace(",", ""))
    cases = states(model, 10, 7)
    with unit(fmu) as u:
        u.begin()
        for q, dq in cases:
            u.state(model, q, dq)
            assert equals(u, model, bounds.bound(q, dq))
            assert u.get("stop_age") == 0.0
    q, dq = cases[0]
    with unit(fmu) as u:
        u.set(dict(zip(names(model, "q_start", "dq_start"), np.concatenate([q, dq]).tolist(), strict=True)))
        u.begin()
        for _ in range(3):
            assert equals(u, model, bounds.bound(u.joints("q", model.joints), u.joints("dq", model.joints)))
            u.step(0.01)


def test_between_computations_the_last_certificate_serves_or_the_outputs_say_that_there_is_none(exported: Any) -> None:
    model = braked(8.0)
    bounds, fmu, n, h, every = bounds_of(model), exported(model, "tube"), model.n, 0.01, 5
    with unit(fmu) as u:
        u.set({"stop_every": every, "dq_start_axis_1": 0.3})
        u.begin()
        made = []
        for k in range(12):
            q, dq, a = (u.joints(x, model.joints) for x in ("q", "dq", "ddq"))
            now = np.concatenate([u.joints(x, model.joints) for x in PER_JOINT])
            assert u.get("stop_certified") == 1
            assert abs(u.get("stop_age") - (k % every) * h) < 1e-12
            if k % every == 0:  # a box around where the next steps lead, as the monitor chooses it
                ahead = every * h
                mid = dq + 0.5 * ahead * a
                rdq = 0.65 * ahead * np.abs(a) + 0.04
                want = bounds.bound(q + 0.5 * ahead * mid, mid, "0", 0.55 * ahead * np.abs(mid) + 0.5 * ahead * rdq + 5e-4, rdq)
                made.append(now)
                assert equals(u, model, want)
            assert np.array_equal(now, made[-1])
            u.step(h)
        # out of the box: none, until the next computation or until it is asked for
        q, dq = np.full(n, 0.7), np.full(n, -0.2)
        u.state(model, q, dq)
        assert silent(u, model)
        u.set({"evaluate_stop": True})
        assert equals(u, model, bounds.bound(q, dq))
        u.set({"evaluate_stop": False})
        assert equals(u, model, bounds.bound(q, dq)), "it still is that state"
        u.state(model, q + 1e-6, dq)
        assert silent(u, model)
    with unit(fmu) as u:
        u.set({"stop_every": 0})
        u.begin()
        assert silent(u, model)
        u.step(h)
        assert silent(u, model)
        with pytest.raises(Exception, match="SetInt32"):
            u.set({"stop_every": -1})


def test_outside_what_was_identified_there_is_no_number(exported: Any) -> None:
    model = braked(8.0)
    bounds, fmu, n = bounds_of(model), exported(model, "tube"), model.n
    q, dq = np.full(n, 0.2), np.full(n, 0.1)
    with unit(fmu) as u:
        u.begin()
        u.state(model, q, dq)
        assert equals(u, model, bounds.bound(q, dq))
        for column, bad in ((0, 3.1), (1, -1.6), (0, np.nan), (1, np.inf)):
            x = np.array([q, dq])
            x[column, 1] = bad
            u.state(model, *x)
            assert silent(u, model)
        u.state(model, q, dq)
        u.set({"temp_axis_2": 70.0})
        assert silent(u, model)
        u.set({"temp_axis_2": 35.0})
        assert equals(u, model, bounds.bound(q, dq))
        u.step(0.01)  # the measured state is far from the prediction: refuted, and so it stays
        assert u.get("verdict") == 2
        assert silent(u, model)
    elsewhere = {"payload_mass": 1.0, "payload_com_x": 0.3}  # the proof has a load at the flange
    for other in ({"payload_mass": 3.0}, {"viscous_axis_1": 1.0}, {"inertia_axis_2": 20.0}, {"warm": 1.5}, elsewhere):
        with unit(fmu) as u:
            u.set(other)
            u.begin()
            assert silent(u, model)
    with unit(fmu) as u:  # within the range that every bound holds for
        u.set({"payload_mass": 1.0})
        u.begin()
        u.state(model, q, dq)
        assert equals(u, model, bounds.bound(q, dq))


def test_a_stop_0_runs_down_inside_its_bounds(exported: Any) -> None:
    model = braked(8.0)
    fmu, n = exported(model, "tube"), model.n
    t = 0.002 * np.arange(301)
    start = dict(zip(names(model, "q_start", "dq_start"), [0.3, 0.5, -0.2, 0.1, 0.4, -0.5, 0.3, -0.2], strict=True))
    asked = {"stop": np.where(t >= 0.1, 1.0, 0.0)}
    tau = joint_inputs(model, "tau", np.full((301, n), 2.0))
    watched = [*names(model, "q", "dq", "q_lo", "q_hi", "stop_time", "stop_angle"), "covered", "stop_age"]
    runs = [simulate(model, fmu, t, tau | asked, watched, start)]
    fine = 0.001 * np.arange(601)
    asked = {"stop": np.where(fine >= 0.1, 1.0, 0.0)}
    runs.append(simulate(model, fmu, fine, joint_inputs(model, "tau", np.full((601, n), 2.0)) | asked, watched, start))
    for j in model.joints:
        q, dq = runs[0][f"q_{j}"], runs[0][f"dq_{j}"]
        assert dq[-1] == 0.0
        assert np.all(np.abs(q[50:] - q[50]) <= runs[0][f"stop_angle_{j}"][51])
        assert np.all(runs[0][f"q_lo_{j}"][51:] <= q[51:])
        assert np.all(q[51:] <= runs[0][f"q_hi_{j}"][51:])
        still = np.flatnonzero(dq != 0.0)[-1] + 1
        assert t[still] - 0.1 <= runs[0][f"stop_time_{j}"][51] + 0.002
        # brakes, sticking and all: the motion does not depend on the importer's step
        assert np.abs(q - runs[1][f"q_{j}"][::2]).max() < AGREE
        # the bound is of use: at most some three times what the nominal arm does
        assert runs[0][f"stop_angle_{j}"][51] < 3.0 * np.abs(q[50:] - q[50]).max() + 0.02
    assert np.all(runs[0]["covered"][51:] == 0)
    assert np.abs(runs[0]["stop_age"][51:] - (t[51:] - 0.1)).max() < 1e-9, "of the request, from then on"


def test_a_stop_1_is_the_controllers_ramp_and_proves_nothing(exported: Any) -> None:
    model = braked(8.0)
    t = 0.01 * np.arange(61)
    start = {"dq_start_axis_1": 0.4, "stop1_time": 0.3}
    asked = {"stop": np.where(t >= 0.1, 2.0, 0.0)}
    watched = ["q_axis_1", "dq_axis_1", "stop_certified", "stop_angle_axis_1"]
    out = simulate(model, exported(model, "tube"), t, asked, watched, start)
    v = out["dq_axis_1"][10]
    assert np.abs(out["dq_axis_1"][10:] - v * np.clip(1 - (t[10:] - 0.1) / 0.3, 0, 1)).max() < AGREE
    assert abs(out["q_axis_1"][-1] - out["q_axis_1"][10] - 0.15 * v) < AGREE
    assert np.all(out["stop_certified"][:11] == 1)
    assert np.all(out["stop_certified"][11:] == 0)
    assert np.all(np.isnan(out["stop_angle_axis_1"][11:]))


def test_a_stop_without_known_brakes_is_refused_with_a_sentence(exported: Any) -> None:
    model, said = replace(arm_model(2), rotor=np.ones(2)), io.StringIO()
    with pytest.raises(Exception, match="fmi3DoStep"):
        simulate(model, exported(model, "none"), 0.01 * np.arange(5), {"stop": np.ones(5)}, ["q_axis_1"], said=said)
    assert "knows no brakes" in said.getvalue()


def test_a_plain_import_shows_stop_bounds(exported: Any) -> None:
    """Nothing connected, a model of motor torque: the unit is the arm, and its own state's stop is bounded."""
    model = braked(8.0, 3, effort="motor_torque", effects=EFFECTS[:1], offset=True)
    out = simulate(
        model, exported(model, "plain"), 0.01 * np.arange(20), {}, ["stop_certified", "tcp_stop_distance"], {"dq_start_axis_1": 0.5}
    )  # fmt: skip
    assert np.all(out["stop_certified"] == 1)
    assert len(set(out["tcp_stop_distance"].tolist())) == 20, "of every state anew, not one number for all"
    assert out["tcp_stop_distance"].max() < 0.01
