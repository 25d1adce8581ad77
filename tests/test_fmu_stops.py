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
from stopset.reach.stops.compiled import CompiledStops, Stopped
from stopset.reach.stops.ramp import Ramp
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


def cut_together(delay_spread: float, lag: Array | None = None) -> Model:
    """Brakes of one power stage: bounded once for every window of their common delay."""
    model = braked(8.0)
    assert model.brakes is not None
    brakes = replace(model.brakes, delay=Box.of(np.full(4, 0.010), np.full(4, 0.040)), delay_spread=delay_spread, lag=lag)
    return replace(model, brakes=brakes)


def core_stop(bounds: StopBounds) -> Callable[..., Stopped | None]:
    assert bounds.setting is not None
    return CompiledStops.of(bounds.setting, bounds.ramp).bound


def sprung(*axes: int) -> Model:
    """Laws of few joints' angles, or of most: a coarse tube first finds the region of the latter."""
    springs = [friction("spring", f"axis_{j}", k=40.0, c=2.0) for j in axes]
    return braked(8.0, 3, effort="motor_torque", effects=[friction("coulomb", "axis_1", F_c=3.0), *springs])


MODELS: dict[str, Callable[[], Model]] = {
    "tube": lambda: braked(8.0),
    "energy": lambda: braked(1.3),
    "six joints": lambda: braked(12.0, 6),
    "motor torque": lambda: braked(
        8.0, 3, effort="motor_torque", offset=True,
        effects=[friction("coulomb", "axis_1", F_c=3.0), friction("viscous", "axis_2", F_v=20.0), friction("encoder_offset", "axis_2", e=0.01)],
    ),
    "of pose": lambda: effects_of_pose(),
    "a spring": lambda: sprung(2),
    "springs": lambda: sprung(1, 2, 3),
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
        want, got = bounds.bound(q, dq, "0", rq, rdq), core(q, dq, "0", rq, rdq)
        assert want.certified == (got is not None)
        if got is None:
            continue
        certified += 1
        for mine, theirs in ((got.time, want.time), (got.forward, want.forward), (got.back, want.back), (got.speed, want.speed)):
            assert np.array_equal(mine, theirs)  # type: ignore[arg-type]
        assert got.tool.tolist() == [want.tcp, want.tcp_speed]
    assert certified >= 4


def ramped(n: int, **changes: Any) -> Ramp:
    """As identified: with tracking errors."""
    about = Ramp(
        "time", Box.of(np.full(n, 0.28), np.full(n, 0.31)), Box.of(np.full(n, 0.008), np.full(n, 0.024)),
        np.full(n, 2e-3), np.linspace(0.004, 0.008, n), off_after=0.35,
    )  # fmt: skip
    return replace(about, **changes)


RAMPS: dict[str, dict[str, Any]] = {
    "time": {},
    "deceleration": {"kind": "deceleration", "value": Box.of(np.full(4, 3.0), np.full(4, 3.6))},
    "along the motion": {"pace": (-0.4, 0.7)},
    "monitored": {"monitored": True, "off_after": None},
    "monitored, faster": {"monitored": True, "share": 1.3, "kind": "deceleration", "value": Box.of(np.full(4, 3.0), np.full(4, 3.6))},
    "late to rest": {"dq_error": np.full(4, 0.03), "settle": 0.05},
    "never at rest": {"dq_error": np.full(4, 0.03)},
    "too steep": {"value": Box.of(np.full(4, 2e-5), np.full(4, 3e-5))},
    "never cut": {"off_after": None},
}  # fmt: skip


@pytest.mark.parametrize("name", RAMPS)
@pytest.mark.parametrize("model", ["tube", "energy", "motor torque"])
def test_the_core_s_stop_1_and_2_are_python_s_to_the_last_bit(name: str, model: str) -> None:
    """Nominal, guaranteed (after a time and monitored) and held; what the one refuses the other does."""
    n = MODELS[model]().n
    changes = {
        k: v.take(slice(0, n)) if isinstance(v, Box) else v[:n] if isinstance(v, np.ndarray) else v
        for k, v in RAMPS[name].items()
    }
    bounds = replace(bounds_of(MODELS[model]()), ramp=ramped(n, **changes))
    core = core_stop(bounds)
    proved = dict.fromkeys(("1", "1 guaranteed", "2"), 0)
    for k, (q, dq) in enumerate(states(bounds.model, 6, 9)):
        rq, rdq = (np.zeros(n), np.zeros(n)) if k % 2 else (np.full(n, 2e-3), np.full(n, 1e-2))
        for category in proved:
            want, got = bounds.bound(q, dq, category, rq, rdq), core(q, dq, category, rq, rdq)
            assert want.certified == (got is not None), (category, want.why)
            if got is None:
                continue
            proved[category] += 1
            for mine, theirs in (
                (got.time, want.time),
                (got.forward, want.forward),
                (got.back, want.back),
                (got.speed, want.speed),
            ):
                assert np.array_equal(mine, theirs), category  # type: ignore[arg-type]
            assert got.tool.tolist() == [want.tcp, want.tcp_speed], category
    works = name not in ("never at rest", "too steep")
    assert (proved["2"] > 0) == works
    assert (proved["1"] > 0) == (works and name != "late to rest"), "from which power is taken before"
    assert (proved["1 guaranteed"] > 0) == (name != "never cut"), proved


def effects_of_pose() -> Model:
    """Laws over pose, speed, load, tilt, temperature and what is remembered, some of them of more than one joint."""
    fitted = [
        friction("spring", "axis_2", k=8.0, c=0.1), friction("stribeck", "axis_1", F_s=6.0, v_s=0.06),
        friction("cable", "axis_3", k=4.0, k_2=1.0, k_3=2.0, c=0.3), friction("base_tilt", None, roll=0.02, pitch=-0.01),
        friction("load_coulomb", "axis_2", k_lift=0.05, k_lower=0.04), friction("coupling", "axis_1+axis_2", c=0.3),
        friction("self_heating", "axis_3", k_v=-0.3, k_c=-0.2, tau_w=8.0), friction("thermal_viscous", "axis_1", k_T=-0.05, b=0.025),
        friction("torque_ripple", "axis_1", a=0.4, b=0.2, n=12.0),
    ]  # fmt: skip
    return braked(8.0, 3, effort="motor_torque", effects=fitted)


@pytest.mark.parametrize("relative_std", [0.0, 0.02])
def test_effects_of_pose_and_speed_have_the_bits_of_stopset_stops(relative_std: float) -> None:
    """Every category; each law over the region that the stop stays in, which core and Python find alike."""
    model = effects_of_pose()
    unsure = tuple(replace(f, std={k: relative_std * abs(x) for k, x in f.values.items()}) for f in model.effects)
    bounds = replace(bounds_of(replace(model, effects=unsure)), ramp=ramped(3))
    assert bounds.setting is not None and not bounds.setting.torques.settled
    core, proved = core_stop(bounds), 0
    for k, (q, dq) in enumerate(states(bounds.model, 6, 4, 1.0)):
        rq, rdq = (np.zeros(3), np.zeros(3)) if k % 2 else (np.full(3, 2e-3), np.full(3, 1e-2))
        for category in ("0", *CONTROLLED):
            want, got = bounds.bound(q, dq, category, rq, rdq), core(q, dq, category, rq, rdq)  # type: ignore[arg-type]
            assert want.certified == (got is not None), (category, want.why)
            if got is None:
                continue
            proved += 1
            pairs = ((got.time, want.time), (got.forward, want.forward), (got.back, want.back), (got.speed, want.speed))
            assert all(np.array_equal(mine, theirs) for mine, theirs in pairs), category  # type: ignore[arg-type]
            assert got.tool.tolist() == [want.tcp, want.tcp_speed], category
    assert proved >= 16


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
        got = core(q, dq, "0", rq, rdq)
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


PER_JOINT = ("stop_time", "stop_forward", "stop_back")


def equals(u: Unit, model: Model, want: StopBound, stem: str = "stop") -> bool:
    """Whether the unit's outputs of a kind of stop are that bound to the last bit, or say as it does that there is none."""
    if not want.certified:
        return silent(u, model, stem)
    assert want.angle is not None and want.time is not None and want.forward is not None and want.back is not None
    values = zip(outputs(stem)[:4], (want.time, want.forward, want.back, want.angle), strict=True)
    good = all(np.array_equal(u.joints(name, model.joints), x) for name, x in values)
    tool = [u.get(x) for x in outputs(stem)[4:6]]
    return good and tool == [want.tcp, want.tcp_speed] and u.get(f"{stem}_certified") == 1


def outputs(stem: str) -> list[str]:
    """Four of every joint, two of the tool, the age."""
    parts = [f"{stem}_{x}" for x in ("time", "forward", "back", "angle")]
    return [*parts, f"tcp_{stem}_distance", f"tcp_{stem}_speed", f"{stem}_age"]


def silent(u: Unit, model: Model, stem: str = "stop") -> bool:
    """No bound: not a number anywhere, and said so."""
    names = outputs(stem)
    every = np.concatenate([*(u.joints(name, model.joints) for name in names[:4]), [u.get(x) for x in names[4:]]])
    return bool(np.all(np.isnan(every))) and u.get(f"{stem}_certified") == 0


@pytest.mark.parametrize("name", ["tube", "energy", "motor torque", "of pose", "together, one late"])
def test_the_fmu_s_bounds_are_python_s_to_the_last_bit(exported: Any, name: str) -> None:
    """At measured states, and at its own where nothing is measured: then it is the arm."""
    model = MODELS[name]()
    bounds, fmu = bounds_of(model), exported(model, name.replace(",", ""))
    cases = states(model, 10, 7)
    with unit(fmu) as u:
        u.begin()
        certified = 0
        for q, dq in cases:
            want = bounds.bound(q, dq)
            u.state(model, q, dq)
            assert equals(u, model, want)
            assert u.get("stop_age") == 0.0 or not want.certified
            certified += want.certified
        assert certified >= 6
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
        u.step(0.01)
        assert u.get("verdict") == 1
        u.state(model, q + 0.3, dq)
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


CONTROLLED = {"1": "stop1_nominal", "1 guaranteed": "stop1_guaranteed", "2": "stop2"}


def braking(**changes: Any) -> Model:
    model = braked(8.0, 3)
    return replace(model, provenance={**model.provenance, "stop1_ramp": ramped(3, **changes).as_dict()})


@pytest.mark.parametrize(
    "changes", [{}, {"kind": "deceleration", "value": Box.of(np.full(3, 3.0), np.full(3, 3.6)), "pace": (-0.2, 0.5)}]
)
def test_stop_1_and_2_have_the_bits_of_python(exported: Any, changes: dict[str, Any]) -> None:
    """SS1-t, SS1-r and none as the parameters say; another ramp than the identified one proves nothing."""
    model = braking(**changes)
    bounds, fmu = bounds_of(model), exported(model, f"ramp {len(changes)}")
    assert bounds.ramp is not None
    cases = [({}, {}), ({"ss1_monitored": True}, {"monitored": True}), ({"ss1_off_after": -1.0}, {"off_after": None})]
    for given, meant in cases:
        want = replace(bounds, ramp=replace(bounds.ramp, **meant))
        with unit(fmu) as u:
            u.set(given)
            u.begin()
            for q, dq in states(model, 4, 3):
                u.state(model, q, dq)
                for category, stem in CONTROLLED.items():
                    assert equals(u, model, want.bound(q, dq, category), stem), (given, category)
                assert equals(u, model, want.bound(q, dq))
            certified = [u.get(f"{stem}_certified") for stem in CONTROLLED.values()]
            assert certified == [1, 0 if "ss1_off_after" in given else 1, 1]
            u.state(model, np.full(3, 3.1), dq)
            assert all(silent(u, model, stem) for stem in CONTROLLED.values())
    with unit(fmu) as u:
        u.set({"stop1_time": 0.1})
        u.begin()
        u.state(model, q, dq)
        assert all(silent(u, model, stem) for stem in CONTROLLED.values()) and not silent(u, model)


@pytest.mark.parametrize(("request_", "category"), [(2, "1"), (3, "2")])
@pytest.mark.parametrize(
    "changes", [{}, {"kind": "deceleration", "value": Box.of(np.full(3, 3.0), np.full(3, 3.6)), "pace": (0.1, 0.5)}]
)
def test_a_controlled_stop_runs_down_inside_its_bounds(
    exported: Any, request_: int, category: str, changes: dict[str, Any]
) -> None:
    model = braking(**changes)
    bounds, fmu, J = bounds_of(model), exported(model, f"ramp {len(changes)}"), model.joints
    start = [0.3, 0.5, -0.2, 0.4, -0.5, 0.3]
    with unit(fmu) as u:
        u.set(dict(zip(names(model, "q_start", "dq_start"), start, strict=True)))
        u.begin()
        for _ in range(3):
            u.step(0.004)
        q, dq = u.joints("q", J), u.joints("dq", J)
        want, stem = bounds.bound(q, dq, category), CONTROLLED[category]
        assert want.certified and want.time is not None and want.angle is not None
        u.set({"stop": request_})
        still = np.zeros(3)
        for k in range(150):
            u.step(0.004)
            assert equals(u, model, want, stem), "of the request, from then on"
            assert silent(u, model) and silent(u, model, "stop1_nominal" if request_ == 3 else "stop2")
            here, speed = u.joints("q", J), u.joints("dq", J)
            assert np.all(np.abs(here - q) <= want.angle)
            assert np.all((u.joints("q_lo", J) <= here) & (here <= u.joints("q_hi", J)))
            assert np.all((u.joints("dq_lo", J) <= speed) & (speed <= u.joints("dq_hi", J)))
            still[speed != 0.0] = 0.004 * (k + 1)
        assert np.all(still > 0.05) and np.all(still <= want.time + 0.004)
        assert u.get("covered") == 0


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
