"""Stops in the FMU: nobody gets farther than it says, and C says what Python says."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmu_models import arm_model
from stopset.artifact import Brakes, Model
from stopset.fmu import export, stops
from stopset.fmu.stops import by_accelerations, by_energy, fmu_stop
from stopset.reach.flowpipe import deviation_tube
from stopset.sets import Box
from stopset.simulation.stop import simulate_stop
from stopset.types import Array
from test_fmu import AGREE, HERE, joint_inputs, names, simulate


def braked(rotor: float, n: int = 4, spread: float = 0.1) -> Model:
    """An arm with brakes known to ``spread`` and rotors of ``rotor`` kg m^2; much of it hardly couples, little does."""
    model = arm_model(n)
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


def worst_of_samples(model: Model, q: Array, dq: Array, rq: Array, rdq: Array, count: int, seed: int) -> tuple[Array, float]:
    """Largest angle (n,) and latest rest of sampled stops of the full nonlinear arm from the box."""
    rng, n = np.random.default_rng(seed), model.n
    d, brakes = stops.stop_data(model), model.brakes
    assert brakes is not None
    angle, time = np.zeros(n), 0.0
    for k in range(count):
        corner = k % 2 == 0

        def draw(lo: Array, hi: Array, sharp: bool = corner) -> Array:
            return np.where(rng.random(n) < 0.5, lo, hi) if sharp else rng.uniform(lo, hi)

        q0, v0 = draw(q - rq, q + rq), draw(dq - rdq, dq + rdq)
        u = np.array([draw(d.stop_u_lo, d.stop_u_hi) for _ in range(4)])
        qs, vs = simulate_stop(
            model.robot.chain, model.robot.pi, model.rotor, d.dry_lo, np.zeros(n), draw(brakes.torque.lo, brakes.torque.hi),
            draw(brakes.delay.lo, brakes.delay.hi), draw(brakes.rise.lo, brakes.rise.hi), q0, v0, 5e-4, 800, u,
        )  # fmt: skip
        angle = np.maximum(angle, np.abs(qs - qs[0]).max(axis=0))
        moving = np.flatnonzero(np.any(vs != 0.0, axis=1))
        time = max(time, 5e-4 * (moving[-1] if moving.size else 0))
    return angle, time


@pytest.mark.parametrize(("rotor", "speed"), [(8.0, 0.6), (8.0, 0.2), (1.3, 0.3)])
def test_no_sampled_stop_goes_beyond_either_proof(rotor: float, speed: float) -> None:
    model, rng = braked(rotor), np.random.default_rng(11)
    n = model.n
    rq, rdq = np.full(n, 1e-3), np.full(n, 5e-3)
    proofs = 0
    for trial in range(4):
        q, dq = rng.uniform(-2, 2, n), rng.uniform(-speed, speed, n)
        x = stops._start(model, model.robot, q, dq, rq, rdq)
        angle, time = worst_of_samples(model, q, dq, rq, rdq, 30, trial)
        for bound in (by_accelerations(x), by_energy(x)):
            if bound is not None:
                proofs += 1
                assert np.all(angle <= bound.angle)
                assert time <= bound.time
    assert proofs >= 4  # at least one of the two everywhere


def test_the_proof_by_accelerations_needs_the_coupling(monkeypatch: pytest.MonkeyPatch) -> None:
    """Mutant: without the off-diagonal inertia the comparison is too optimistic, and samples find it out."""
    model = braked(2.5)
    n = model.n
    rq, rdq = np.full(n, 1e-4), np.full(n, 1e-4)
    rng, escapes = np.random.default_rng(5), 0
    for trial in range(6):
        q, dq = rng.uniform(-2, 2, n), rng.uniform(-0.8, 0.8, n)
        dq[-1] = 0.02
        x = stops._start(model, model.robot, q, dq, rq, rdq)
        blind = replace(x, M=np.diag(np.diag(x.M)), T=np.diag(np.diag(x.T)), slope=0 * x.slope)
        bound = by_accelerations(blind)
        assert bound is not None
        angle, _ = worst_of_samples(model, q, dq, rq, rdq, 20, trial)
        escapes += bool(np.any(angle > bound.angle))
    assert escapes > 0


def test_no_brakes_or_too_weak_ones_prove_nothing() -> None:
    model = braked(8.0)
    n, zero = model.n, np.zeros(model.n)
    q, dq = np.full(n, 0.8), np.full(n, 0.1)
    assert fmu_stop(model, q, dq, zero, zero) is not None
    assert model.brakes is not None
    weak = replace(model.brakes, torque=Box.of(0.01 * model.brakes.torque.lo, model.brakes.torque.hi))
    assert fmu_stop(replace(model, brakes=weak), q, dq, zero, zero) is None
    assert fmu_stop(replace(model, brakes=None), q, dq, zero, zero) is None


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Any:
    folder = tmp_path_factory.mktemp("stops")

    def of(model: Model, name: str) -> Path:
        pytest.importorskip("ziglang")
        pytest.importorskip("fmpy")
        return export(model, folder / f"{name}.fmu", 3, [str(HERE)])

    return of


STOP = ("stop_time", "stop_angle")


@pytest.mark.parametrize("rotor", [1.3, 8.0])
def test_c_bounds_equal_python_bounds(exported: Any, rotor: float) -> None:
    model = braked(rotor)
    n, fmu = model.n, exported(model, f"r{rotor}")
    tube = deviation_tube(model.abstraction, model.powered)
    centre, radius = 0.5 * (tube.lo + tube.hi)[0], 0.5 * (tube.hi - tube.lo)[0]
    rng = np.random.default_rng(2)
    for load in (0.0, 1.5):
        q, dq = rng.uniform(-1, 1, n), rng.uniform(-0.3, 0.3, n)
        start = dict(zip(names(model, "q_start", "dq_start"), np.concatenate([q, dq]).tolist(), strict=True))
        start["payload_mass"] = load
        out = simulate(model, fmu, 0.01 * np.arange(3), {}, [*names(model, *STOP), "tcp_stop_distance", "stop_certified"], start)
        wanted = fmu_stop(model, q + centre[:n], dq + centre[n:], radius[:n], radius[n:], load)
        assert wanted is not None
        assert out["stop_certified"][0] == 1
        assert np.abs([out[f"stop_angle_{j}"][0] for j in model.joints] - wanted.angle).max() < AGREE
        assert abs(out["stop_time_axis_1"][0] - wanted.time) < AGREE
        assert abs(out["tcp_stop_distance"][0] - wanted.tcp) < AGREE


def test_a_stop_0_runs_down_inside_its_bounds(exported: Any) -> None:
    model = braked(8.0)
    fmu, n = exported(model, "run"), model.n
    t = 0.002 * np.arange(301)
    start = dict(zip(names(model, "q_start", "dq_start"), [0.3, 0.5, -0.2, 0.1, 0.4, -0.5, 0.3, -0.2], strict=True))
    asked = {"stop": np.where(t >= 0.1, 1.0, 0.0)}
    tau = joint_inputs(model, "tau", np.full((301, n), 2.0))
    watched = [*names(model, "q", "dq", "q_lo", "q_hi", *STOP), "covered"]
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
    assert np.all(runs[0]["covered"][51:] == 0)


def test_a_stop_1_is_the_controllers_ramp_and_proves_nothing(exported: Any) -> None:
    model = braked(8.0)
    t = 0.01 * np.arange(61)
    start = {"dq_start_axis_1": 0.4, "stop1_time": 0.3}
    asked = {"stop": np.where(t >= 0.1, 2.0, 0.0)}
    watched = ["q_axis_1", "dq_axis_1", "stop_certified", "stop_angle_axis_1"]
    out = simulate(model, exported(model, "ramp"), t, asked, watched, start)
    v = out["dq_axis_1"][10]
    assert np.abs(out["dq_axis_1"][10:] - v * np.clip(1 - (t[10:] - 0.1) / 0.3, 0, 1)).max() < AGREE
    assert abs(out["q_axis_1"][-1] - out["q_axis_1"][10] - 0.15 * v) < AGREE
    assert np.all(out["stop_certified"][11:] == 0)
    assert np.all(np.isnan(out["stop_angle_axis_1"][11:]))


def test_a_stop_without_known_brakes_is_refused_with_a_sentence(exported: Any) -> None:
    model, said = replace(arm_model(2), rotor=np.ones(2)), io.StringIO()
    with pytest.raises(Exception, match="fmi3DoStep"):
        simulate(model, exported(model, "none"), 0.01 * np.arange(5), {"stop": np.ones(5)}, ["q_axis_1"], said=said)
    assert "knows no brakes" in said.getvalue()
