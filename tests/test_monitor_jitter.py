"""Stamps that jitter neither accuse a good arm, nor hide an altered one, nor leave it without a verdict."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection

import numpy as np
import pytest

from monitor_arm import DT, INERTIA, NOISE, VISCOUS, U, known_model, motion, with_torque_scaled
from stopset.monitor.certificates import Numbers
from stopset.monitor.grid import REACH, SETTLE, Cycles, GridMotion
from stopset.monitor.jointstate import JointState, to_json
from stopset.monitor.layout import State
from stopset.monitor.source import SWAPPED, JointStateSource
from stopset.monitor.status import OkConditions, Situation, decide
from stopset.monitor.verdict import Conformance
from stopset.monitor.watch import Watch
from stopset.recording import Recording
from stopset.types import Array

START = 1_700_000_000_000_000_000
SIGMA = 1e-3  # [s]


def truly_late(seed: int, samples: int, off: Array) -> Recording:
    """The known arm, its torques held over each cycle, read at ``DT k + off[k]``: solved exactly piece by piece."""
    rng = np.random.default_rng(seed)
    n = len(INERTIA)
    t = DT * np.arange(samples)
    phase, rate = rng.uniform(0, 2 * np.pi, n), rng.uniform(0.5, 1.5, n)
    u = VISCOUS * 0.5 * np.sin(2 * np.pi * rate * t[:, None] + phase)
    push = np.where(rng.integers(0, 2, (samples, n)) == 1, U.hi, U.lo)
    decay = VISCOUS / INERTIA

    def moved(x: Array, w: Array, h: float) -> Array:
        rest, e = w / VISCOUS, np.exp(-decay * h)
        q = x[:n] + rest * h + (x[n:] - rest) * (1 - e) / decay
        return np.concatenate([q, rest + (x[n:] - rest) * e])

    x, states, read = np.zeros(2 * n), [], []
    for k in range(samples):
        states.append(x)
        x = moved(x, u[k] + push[k], DT)
    for k in range(samples):
        cycle = int(np.clip(np.floor(k + off[k] / DT), 0, samples - 1))
        read.append(moved(states[cycle], u[cycle] + push[cycle], (k - cycle) * DT + off[k]))
    z = np.array(read) + rng.uniform(-NOISE, NOISE, (samples, 2 * n))
    return Recording("open_loop", 0, 0, 0, t, z[:, :n], z[:, n:], u)


def verdicts(r: Recording, off: Array, lost: Collection[int] = ()) -> Counter[Conformance]:
    model = known_model()
    source, watch, out = JointStateSource(model.joints, DT, backlog=len(r.t)), Watch(model), Counter[Conformance]()
    for k in range(len(r.t)):
        stamp = START + round((DT * k + off[k]) * 1e9)
        row = (tuple(x[k].tolist()) for x in (r.q, r.dq, r.tau))
        if k not in lost:
            source.take("", to_json(JointState(stamp, model.joints, *row)))
    for _ in r.t:
        sample = source.next(0.0)
        if sample is not None:
            out[watch.step(sample).conformance] += 1
    return out


@pytest.mark.parametrize("real", [True, False], ids=["read late", "stamped late"])
@pytest.mark.parametrize("seed", range(4))
def test_a_good_arm_with_jittered_stamps_is_neither_accused_nor_unknown(seed: int, real: bool) -> None:
    off = np.clip(np.random.default_rng(seed).normal(0.0, SIGMA, 500), -2.9e-3, 2.9e-3)
    r = truly_late(seed, 500, off if real else np.zeros(500))
    said = verdicts(r, off)
    assert not said[Conformance.VIOLATION] and not said[Conformance.FAULT], said
    assert said[Conformance.UNKNOWN] <= 2 * SETTLE, said  # the places are found, and two stamps out of order


@pytest.mark.parametrize("real", [True, False], ids=["read late", "stamped late"])
@pytest.mark.parametrize(("sigma", "losses", "unknown"), [(SIGMA, 0, 0.05), (0.5 * SIGMA, 10, 0.2)])
def test_neither_stamps_out_of_order_nor_lost_messages_accuse_a_good_arm(
    real: bool, sigma: float, losses: int, unknown: float
) -> None:
    """Ten seconds each: one stamp in 400 comes before its predecessor, one in 700 is nearer to another cycle, and cycles' places wander."""
    samples, said = 2500, Counter[Conformance]()
    for seed in range(4):
        rng = np.random.default_rng(seed)
        off = rng.normal(0.0, sigma, samples)
        lost = rng.integers(50, samples, losses).tolist()
        said += verdicts(truly_late(seed, samples, off if real else np.zeros(samples)), off, lost)
    assert not said[Conformance.VIOLATION] and not said[Conformance.FAULT], said
    assert said[Conformance.CONFORMANT] > (1.0 - unknown) * 4 * samples, said


def test_an_altered_arm_is_found_in_spite_of_jitter() -> None:
    off = np.clip(np.random.default_rng(0).normal(0.0, SIGMA, 300), -2.9e-3, 2.9e-3)
    for joint in range(6):
        assert verdicts(with_torque_scaled(motion(joint, 300), joint, 1.5), off)[Conformance.VIOLATION]


def test_without_the_uncertainty_a_good_arm_is_accused(monkeypatch: pytest.MonkeyPatch) -> None:
    real = GridMotion.onto_grid
    monkeypatch.setattr(GridMotion, "onto_grid", lambda *a: (real(*a)[0], 0.01 * real(*a)[1], real(*a)[2]))
    off = np.clip(np.random.default_rng(1).normal(0.0, SIGMA, 300), -2.9e-3, 2.9e-3)
    assert verdicts(truly_late(1, 300, off), off)[Conformance.VIOLATION]


def test_cycles_are_counted_through_jitter_loss_and_a_slow_clock() -> None:
    rng, cycles = np.random.default_rng(0), Cycles(DT)
    assert cycles.step(START) == (1, 0.0)
    lost = set(range(50, 1000, 97))
    counted = 0
    for k in range(1, 1000):
        if k in lost:
            continue
        off = float(np.clip(rng.normal(0.0, 0.3e-3), -1e-3, 1e-3))
        found = cycles.step(START + round((DT * k * (1 + 2e-5) + off) * 1e9))
        assert found is not None
        whole, away = found
        counted += whole
        assert abs(away) < 2e-3
    assert counted == 999 - SETTLE + 1, "all but those that the places were found from"
    assert cycles.step(START) == (0, 0.0), "a stamp that goes back belongs to no cycle"
    assert REACH < 1.0


@pytest.mark.parametrize("back", [0.5, 2.0])
def test_a_senders_clock_that_is_set_back_is_never_ok(back: float) -> None:
    """By little: refused until it has caught up; by more: a new start, and as old as it says. The daemon's own rule decides."""
    model, r = known_model(), motion(0, 900)
    source, watch = JointStateSource(model.joints, DT), Watch(model)
    limits, sample, arrived, said = OkConditions(0.03, 0.004, 0.02, 0.0), None, 0.0, []
    proven = Numbers(*np.full((3, 6), 0.1), 0.1, np.full(6, True))
    for k in range(900):
        now = 1000.0 + DT * k
        stamp = now - (back if k >= 300 else 0.0)
        row = (tuple(x[k].tolist()) for x in (r.q, r.dq, r.tau))
        source.take("", to_json(JointState(round(stamp * 1e9), model.joints, *row)))
        if (new := source.next(0.0)) is not None:
            sample, arrived, verdict = new, now, watch.step(new)
        assert sample is not None
        situation = Situation(True, "", False, False, "", now - sample.t, now - arrived, sample, verdict, True, {"0": proven})
        said.append(decide(situation, limits)[0])
    assert State.OK in said[:300], "a good arm"
    caught_up = 300 + round(back / DT) if back < SWAPPED else 900
    assert State.OK not in said[310:caught_up]


def test_messages_without_effort_give_stops_but_no_verdict() -> None:
    model = known_model()
    source, watch = JointStateSource(model.joints, DT), Watch(model)
    source.take("", to_json(JointState(START, model.joints, (0.1,) * 6, (0.0,) * 6, ())))
    sample = source.next(0.0)
    assert sample is not None and sample.tau is None and sample.q[0] == 0.1
    verdict = watch.step(sample)
    assert verdict.conformance is Conformance.UNKNOWN and "no torque" in verdict.why
