"""Nonlinear models are watched with: curved friction by its two simulations, model 2 along the nominal motion."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from monitor_arm import DT, INERTIA, NOISE, VISCOUS, U, known_model
from stopset.artifact import Abstraction, Model, UncertaintySets, load_model, save_model
from stopset.artifact.abstraction import Polynomial
from stopset.core.library import lib, view
from stopset.errors import NotCovered
from stopset.monitor.along import WatchAlong, watch_for
from stopset.monitor.config import Bus, Config, Publish, Records, Stops
from stopset.monitor.daemon import Beside, Daemon
from stopset.monitor.evidence.recorder import Recorder
from stopset.monitor.evidence.trace import Trace
from stopset.monitor.layout import State
from stopset.monitor.sample import Quantum, Sample
from stopset.monitor.verdict import Conformance
from stopset.monitor.watch import Watch, check_cycle
from stopset.reach.nonlinear import dynamics, parts, predicted_tube
from stopset.sets import Box
from stopset.types import Array
from test_monitor_daemon import Arm, Script, Wire

NONE = Quantum.none(6)
CURVED = np.column_stack([VISCOUS, np.zeros(6), 0.8 * VISCOUS])  # friction that grows with the cube of the speed


def curved(**more: object) -> Model:
    m = known_model(**more)  # type: ignore[arg-type]
    return replace(m, abstraction=Abstraction(1, 3, np.diag(1 / INERTIA), CURVED))


def coupled() -> Model:
    """Model 2: joints 1 and 3 feel each other's speed through joint 2's angle; its grid is five samples."""
    still = [Polynomial(np.zeros((0, 18), np.int64), np.zeros(0)) for _ in range(6)]
    e = np.zeros((1, 18), np.int64)
    first, third = e.copy(), e.copy()
    first[0, [0, 2, 7]] = 1  # dq1 dq3 sin q2
    third[0, [0, 13]] = (2, 1)  # dq1^2 cos q2
    coriolis = list(still)
    coriolis[0], coriolis[2] = Polynomial(first, np.array([0.8])), Polynomial(third, np.array([-0.5]))
    m = known_model()
    sets = m.powered
    coarse = UncertaintySets(X0=sets.X0, U=sets.U, V=Box.symmetric(np.repeat([3e-4, 3e-3], 6)), dt=5 * DT, horizon=0.4)
    a = Abstraction(2, 2, np.diag(1 / INERTIA), VISCOUS[:, None], tuple(coriolis))
    return replace(m, abstraction=a, sets={"powered": coarse})


def whole() -> Model:
    """Model 3: the same arm with its acceleration as one polynomial of speeds, angles and torques."""
    m, rows = coupled(), []
    for j in range(6):
        own = np.zeros((2, 24), np.int64)
        own[0, j], own[1, 18 + j] = 1, 1  # dq, u
        c = m.abstraction.coriolis[j]
        powers = np.vstack([own, np.hstack([c.exponent, np.zeros((len(c.coefficient), 6), np.int64)])])
        rows.append(Polynomial(powers, np.concatenate([[-VISCOUS[j], 1.0], -c.coefficient]) / INERTIA[j]))
    a = m.abstraction
    return replace(m, abstraction=Abstraction(3, 2, a.Minv, a.viscous, acceleration=tuple(rows)))


def read(model: Model, seed: int, samples: int = 300, push: Box = U) -> tuple[Array, Array]:
    """States (N, 12) as read, and torques (N, 6), of the arm that the model tells the truth of: small midpoint steps in numpy."""
    rng = np.random.default_rng(seed)
    t = DT * np.arange(samples)
    u = VISCOUS * 0.5 * np.sin(2 * np.pi * rng.uniform(0.5, 1.5, 6) * t[:, None] + rng.uniform(0, 2 * np.pi, 6))
    x, out, h = np.zeros(12), [], DT / 10
    for k in range(samples):
        out.append(x)
        w = (u[k] + np.where(rng.integers(0, 2, 6) == 1, push.hi, push.lo))[None]
        for _ in range(10):
            mid = x + 0.5 * h * np.concatenate([x[6:], model.abstraction.ddq(x[None, :6], x[None, 6:], w)[0]])
            x = x + h * np.concatenate([mid[6:], model.abstraction.ddq(mid[None, :6], mid[None, 6:], w)[0]])
    return np.array(out) + rng.uniform(-NOISE, NOISE, (samples, 12)), u


def verdicts(model: Model, x: Array, tau: Array, quantum: Quantum = NONE) -> tuple[Counter[Conformance], WatchAlong]:
    watch = watch_for(model, quantum, None, (0.0, 1.0), DT)
    assert isinstance(watch, WatchAlong)
    said = Counter(watch.step(Sample(k, DT * k, x[k, :6], x[k, 6:], tau[k])).conformance for k in range(len(x)))
    return said, watch


MODELS = {"curved friction": curved, "model 2": coupled, "model 3": whole}


@pytest.mark.parametrize("which", MODELS)
@pytest.mark.parametrize("seed", range(3))
def test_an_arm_inside_its_sets_is_never_flagged(which: str, seed: int) -> None:
    model = MODELS[which]()
    said, watch = verdicts(model, *read(model, seed))
    assert set(said) <= {Conformance.CONFORMANT, Conformance.UNKNOWN} and said[Conformance.UNKNOWN] <= watch.every, said


@pytest.mark.parametrize("which", MODELS)
def test_a_wrong_torque_and_a_too_small_set_are_refuted(which: str) -> None:
    model = MODELS[which]()
    x, tau = read(model, 1)
    for joint in (0, 2, 4):
        wrong = tau.copy()
        wrong[:, joint] *= 1.5
        assert verdicts(model, x, wrong)[0][Conformance.VIOLATION], joint
    held = read(model, 2, push=Box.of(0.8 * U.hi, U.hi))
    small = replace(model, sets={"powered": replace(model.powered, U=Box.of(U.lo, 0.5 * U.hi))})
    assert verdicts(small, *held)[0][Conformance.VIOLATION] and not verdicts(model, *held)[0][Conformance.VIOLATION]


def test_the_linear_part_alone_would_be_refuted() -> None:
    """Cubic friction is not for nothing: its tangent is contradicted."""
    model = curved()
    x, tau = read(model, 0)
    watch = Watch(known_model())
    assert any(watch.step(Sample(k, 0.0, x[k, :6], x[k, 6:], tau[k])).conformance is Conformance.VIOLATION for k in range(len(x)))


@pytest.mark.parametrize("which", MODELS)
def test_the_tube_is_that_of_the_comparison(which: str) -> None:
    """What `predicted_tube` gives, which identification and compare use, from the states and mean torques of its grid."""
    model = MODELS[which]()
    x, tau = read(model, 3, 201)
    watch = watch_for(model, NONE, None, (0.0, 1.0), DT)
    assert isinstance(watch, WatchAlong)
    every = watch.every
    for k in range(len(x)):
        watch.step(Sample(k, DT * k, x[k, :6], x[k, 6:], tau[k]))
    at = (len(x) - 1) // every * every
    for age in (1, 3, 8):
        u = tau[at - age * every : at].reshape(age, every, 6).mean(axis=1)
        lo, hi = predicted_tube(model.abstraction, model.powered, x[at - age * every], u)
        seen = watch._predictions.bounds(age)
        assert np.all(seen[0] <= lo[-1] + 1e-12) and np.all(seen[1] >= hi[-1] - 1e-12), "coarser, if anything"
        assert np.allclose(seen, (lo[-1], hi[-1]), rtol=0, atol=1e-7)


def test_rounding_of_the_bus_never_flags_a_conformant_arm() -> None:
    model, count = curved(), 2e-3
    x, tau = read(model, 0)
    rounded, coarse = np.round(x / count) * count, np.round(tau / 0.2) * 0.2
    quantum = Quantum(np.full(6, count / 2), np.full(6, count / 2), np.full(6, 0.1))
    assert not verdicts(model, rounded, coarse, quantum)[0][Conformance.VIOLATION]
    assert verdicts(model, rounded, coarse)[0][Conformance.VIOLATION], "unknown rounding would be flagged"


def test_a_gap_a_bad_number_and_another_domain_give_no_verdict() -> None:
    model = curved()
    x, tau = read(model, 0, 60)
    watch = watch_for(model, NONE, None, (0.0, 1.0), DT)
    for k in (*range(30), 32):
        v = watch.step(Sample(k, 0.0, x[k, :6], x[k, 6:], tau[k]))
    assert v.conformance is Conformance.UNKNOWN and v.why.startswith("gap")
    v = watch.step(Sample(33, 0.0, x[33, :6] * np.nan, x[33, 6:], tau[33]))
    assert v.conformance is Conformance.UNKNOWN and "not a number" in v.why
    for k in (34, 35):
        v = watch.step(Sample(k, 0.0, x[k, :6] + 5.0, x[k, 6:], tau[k]))
    assert v.outside and v.conformance is Conformance.UNKNOWN


def test_sets_that_conform_from_the_start_are_used_from_the_start_only() -> None:
    model = curved(horizon=0.2, windows="start")
    x, tau = read(model, 0, 120)
    watch = watch_for(model, NONE, None, (0.0, 1.0), DT)
    said = [watch.step(Sample(k, 0.0, x[k, :6], x[k, 6:], tau[k])) for k in range(120)]
    assert [k for k, v in enumerate(said) if v.conformance is Conformance.CONFORMANT] == list(range(1, 51))


def test_the_grid_must_be_a_whole_number_of_cycles() -> None:
    check_cycle(coupled(), DT)
    with pytest.raises(NotCovered, match="cycle of 3 ms"):
        check_cycle(coupled(), 0.003)
    with pytest.raises(NotCovered, match="cycle of 2 ms"):
        check_cycle(known_model(), 0.002)


def gentle() -> Model:
    """Friction so little curved that a step is not cut into parts."""
    m = curved()
    return replace(m, abstraction=Abstraction(1, 3, np.diag(1 / INERTIA), CURVED * [1.0, 1.0, 0.01]))


def tied() -> Model:
    """Linear friction, but joints that accelerate each other: no two simulations enclose that."""
    m = curved()
    Minv = np.diag(1 / INERTIA)
    Minv[0, 2] = Minv[2, 0] = 0.1
    return replace(m, abstraction=Abstraction(1, 3, Minv, CURVED))


def of_sets(model: Model, **changes: Any) -> Model:
    return replace(model, sets={"powered": replace(model.powered, **changes)})


VARIANTS = {
    **MODELS, "gentle": gentle, "tied": tied,
    "curved, positions": lambda: of_sets(curved(), conform="position"),
    "curved, from the start": lambda: of_sets(curved(), windows="start"),
    "model 2, positions": lambda: of_sets(coupled(), conform="position"),
    "model 2, from the start": lambda: of_sets(coupled(), windows="start"),
    "model 3, far": lambda: of_sets(whole(), dt=DT, horizon=0.25),
}  # fmt: skip


@pytest.mark.parametrize("which", VARIANTS)
def test_a_sample_is_held_against_what_is_due(which: str) -> None:
    """By hand, from the bounds of each prediction: which ages, what they leave, the nearest bound, the worst that is passed; what is
    refuted predicts nothing, and what passed a sample outside the domain is marked."""
    model = VARIANTS[which]()
    sets, paths = model.powered, not model.abstraction.decoupled
    x, tau = read(model, 4, 200)
    tau[110:, 1] += 60.0  # from here on refuted
    watch = watch_for(model, NONE, None, (0.0, 1.0), DT)
    assert isinstance(watch, WatchAlong)
    every, steps, sliding = watch.every, len(watch.ages) - 1, sets.windows == "sliding"
    looks = [a for a in (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64) if a < steps] + [steps]
    starts, beyond, turns, refuted = [0], set(), {}, 0
    for k in range(len(x)):
        far = 20 * every <= k < 20 * every + 2  # the arm was somewhere else, for two samples
        v = watch.step(Sample(k, DT * k, x[k, :6] + 3.1 * far, x[k, 6:], tau[k]))
        beyond |= {k} if v.outside else set()
        if k % every:
            continue
        step = k // every
        ages = [step - s for s in starts if 0 < step - s <= steps]
        if paths and sliding:
            old = [a for a in ages if a in looks and a > 24]
            assert v.compared == len([a for a in ages if a in looks and a <= 24]) + (len(old) > 0)
            oldest = round(v.oldest / sets.dt)
            turns[oldest] = turns.get(oldest, 0) + (len(old) > 1)
            ages = [a for a in ages if a in looks and (a <= 24 or a == oldest)]
        assert v.compared == len(ages), step
        if sliding and step and not v.deviations:
            starts.append(step)
        if not ages:
            continue
        lo, hi = np.array([watch._predictions.bounds(a) for a in sorted(ages)]).transpose(1, 0, 2)
        z = np.concatenate([x[k, :6] + 3.1 * far, x[k, 6:]])
        between = watch.tube(Sample(k, DT * k, x[k, :6], x[k, 6:], tau[k]))
        assert between is not None and np.array_equal(between, (lo.max(axis=0), hi.min(axis=0)))
        width = np.where(np.isfinite(hi - lo), hi - lo, 1e9)  # no speed was promised: as far from a bound as can be
        room = np.minimum(2.0 * np.minimum(z - lo, hi - z) / width, 1.0).min(axis=0)
        assert v.room is not None and np.allclose(v.room, room, rtol=1e-9, atol=0)
        assert {(d.state, d.joint, d.side) for d in v.deviations} == {
            ("q" if i < 6 else "dq", model.joints[i % 6], side)
            for i in range(12) for side, bad in (("above", z > hi), ("below", z < lo)) if bad[:, i].any()
        }  # fmt: skip
        for d in v.deviations:
            i = model.joints.index(d.joint) + 6 * (d.state == "dq")
            past = (z - hi) / width if d.side == "above" else (lo - z) / width
            row = int(np.argmax(past[:, i]))
            assert d.fraction == past[row, i] and round(d.age / sets.dt) == sorted(ages)[row]
            assert d.in_domain == (not beyond & set(range(k - sorted(ages)[row] * every, k + 1)))
        refuted += bool(v.deviations)
    assert refuted and (sum(n > 0 for n in turns.values()) > 1) == (which in ("tied", "model 3, far")), turns


def test_a_corner_that_runs_away_is_held() -> None:
    """Friction that drives: its corners stay numbers, and predict nothing that is passed."""
    a = Abstraction(1, 3, np.eye(1), np.array([[0.0, 0.0, -50.0]]))
    struct, _ = dynamics(a)
    for side in (1.0, -1.0):
        z = np.array([0.0, side * 30.0])
        lib.stopset_corners(struct, 1, view(np.zeros(1)), 0.01, 4, 100.0, view(z))
        assert z[1] == side * 100.0 and np.isfinite(z[0])
    lib.stopset_corners(struct, 1, view(np.zeros(1)), 0.01, 4, 100.0, view(z := np.array([0.0, 1e-3])))
    assert 1e-3 < z[1] < 1.1e-3


def test_ages_reach_the_horizon() -> None:
    def ages(oldest: int) -> list[int]:
        return [k for k in range(-1, oldest + 3) if lib.stopset_looked_at(k, oldest)]

    assert ages(100) == [1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 100]
    assert ages(1) == [1] and ages(2) == [1, 2] and ages(5) == [1, 2, 3, 4, 5]


@pytest.mark.parametrize("damping", [1e9, 1e300])
def test_damping_that_no_number_of_parts_is_enough_for_is_not_predicted_with(damping: float) -> None:
    a = replace(curved().abstraction, viscous=damping * CURVED)
    with pytest.raises(NotCovered, match="parts of a step"):
        parts(a, DT, np.full(6, 3.0))


def test_a_saved_nonlinear_model_is_watched_with(tmp_path: Path) -> None:
    save_model(curved(), tmp_path / "m.model.json")
    model = load_model(tmp_path / "m.model.json")
    assert isinstance(watch_for(model, NONE, None, (0.0, 1.0), DT), WatchAlong)


@pytest.mark.parametrize("which", MODELS)
def test_the_daemon_runs_and_records_with_it(which: str, tmp_path: Path) -> None:
    """Real loop, recorder and stop bounds: verdicts are given, a violation is latched and written, no fault comes out."""
    model = save_model(MODELS[which](), tmp_path / "arm.model.json")
    again = load_model(tmp_path / "arm.model.json")  # as the process of stop bounds reads it; some joints have no Coriolis torque
    at = np.full((2, 6), 0.3)
    assert again.sha256 == model.sha256 and np.array_equal(again.abstraction.ddq(at, at, at), model.abstraction.ddq(at, at, at))
    x, tau = read(model, 1, 200)
    tau[100:, 2] *= 1.8
    script: Script = [Sample(k, 0.0, x[k, :6], x[k, 6:], tau[k]) for k in range(200)]
    arm, wire = Arm(script), Wire()
    config = Config(
        str(tmp_path / "arm.model.json"), Bus("hub:1"), data_id=7, stops=Stops(("0",)), sha256="ab" * 32,
        publish=Publish(valid_for_ms=5000, stale_ms=1000, json_hz=1e9, recover_s=0.0, evidence_min_s=0.0),
    )  # fmt: skip
    recorder = Recorder(Trace(6), Records(), tmp_path / "record", DT, pause=lambda: None)
    daemon = Daemon(config, model, arm, wire, DT, Beside(recorder=recorder))
    arm.daemon = daemon
    assert daemon.run(lambda: arm) == 0
    daemon.close()
    assert daemon.tally.faults == 0 and daemon.tally.verdicts["CONFORMANT"] > 90
    assert State.VIOLATION in wire.words and daemon.latch.joints[0] == "arm_3_joint"
    (event,) = [e for e in wire.slow["event"] if e["kind"] == "bundle"]
    assert event["cause"]["kind"] == "unclassed" and Path(event["file"]).is_file()
