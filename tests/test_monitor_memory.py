"""A monitored model whose effects remember: what the arm did before the first sample is unknown, and never a violation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from monitor_arm import DT, known_model, motion
from stopset.artifact import Model
from stopset.artifact.inputs import effect_torques
from stopset.effects import Effect, Signals, get
from stopset.effects.base import Fitted, Law
from stopset.effects.memory import coefficients, stepped
from stopset.effects.signals import Samples
from stopset.errors import NotCovered
from stopset.monitor import unseen
from stopset.monitor.along import watch_for
from stopset.monitor.carried import Carried
from stopset.monitor.sample import Quantum, Sample
from stopset.monitor.verdict import Conformance, Verdict
from stopset.monitor.watch import Watch
from stopset.recording import Recording
from stopset.types import Array
from test_monitor_along import curved

HYSTERESIS = {"F_h": 12.0, "delta": 0.02}
HEATING = {"k_c": -6.0, "k_v": -4.0, "tau_w": 0.5}


def lasting(effect: str, values: dict[str, float]) -> Model:
    m = known_model()
    return replace(m, effects=(Fitted(effect, m.joints[0], values, {}),))


def worked_before(model: Model, r: Recording, start: float) -> tuple[Recording, Array]:
    """The known arm with the model's effect at its first joint, whose state was ``start`` when the recording began; its states."""
    f = model.effects[0]
    effect, s = get(f.effect), Signals(dq=r.dq[:, 0])
    b, a = coefficients(effect, s, f.values)
    z = np.empty(len(r.t))
    z[0] = start
    for k in range(len(z) - 1):
        z[k + 1] = stepped(z[k], b[k], a[k], DT)
    torque = effect_torques(model.robot, model.effects, Samples(r.q, r.dq), memories={0: (z,)})
    return replace(r, tau=r.tau + torque), z


def samples(r: Recording, k0: int = 0) -> list[Sample]:
    return [Sample(k0 + k, r.t[k], r.q[k], r.dq[k], r.tau[k]) for k in range(len(r.t))]


def verdicts(watch: Watch, run: list[Sample]) -> list[Verdict]:
    return [watch.step(s) for s in run]


CASES = [("hysteresis", HYSTERESIS, z) for z in (-1.0, -0.3, 1.0)] + [("self_heating", HEATING, w) for w in (0.0, 0.4, 1.2)]


@pytest.mark.parametrize(("name", "values", "start"), CASES)
def test_a_healthy_arm_is_not_flagged_whatever_it_did_before(name: str, values: dict[str, float], start: float) -> None:
    model = lasting(name, values)
    r, z = worked_before(model, motion(1), start)
    watch, inside = Watch(model), []
    for k, s in enumerate(samples(r)):
        lo, hi = watch._inputs.carried.ends[0]
        inside.append(lo - 1e-9 <= z[k] <= hi + 1e-9)
        verdict = watch.step(s)
        assert verdict.conformance is (Conformance.CONFORMANT if k else Conformance.UNKNOWN), (k, verdict.why)
    assert all(inside)


@pytest.mark.parametrize(("name", "values", "start"), [c for c in CASES if c[2] in (-1.0, 1.0, 1.2)])
def test_a_state_that_is_frozen_or_begins_elsewhere_is_refuted(
    name: str, values: dict[str, float], start: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Mutants: the middle of the range for ever, and as if it were known at the first sample."""
    model = lasting(name, values)
    run = samples(worked_before(model, motion(1), start)[0])
    known = Carried.forget

    def certain(self: Carried) -> None:
        known(self)
        self.ends[:] = get(name).at_start[0]

    monkeypatch.setattr(Carried, "forget", certain)
    assert any(v.deviations for v in verdicts(Watch(model), run)), "begun elsewhere"
    frozen = Watch(model)
    frozen._inputs.struct.dt = 0.0
    assert any(v.deviations for v in verdicts(frozen, run)), "frozen"


def test_the_ends_come_together_and_a_wrong_torque_is_then_seen() -> None:
    model = lasting("hysteresis", HYSTERESIS)
    r, _ = worked_before(model, motion(1), 1.0)
    watch = Watch(model)
    widths = []
    for s in samples(r):
        widths.append(float(np.ptp(watch._inputs.carried.ends[0])))
        watch.step(s)
    assert widths[0] == 2.0 and widths[-1] < 1e-3 and np.all(np.diff(widths) <= 1e-12)
    pushed = replace(r, tau=r.tau + np.where(r.t > 0.6, 3.0, 0.0)[:, None] * np.eye(6)[0])
    found = [v for v in verdicts(Watch(model), samples(pushed)) if v.deviations]
    assert found and {d.joint for v in found for d in v.deviations} == {model.joints[0]}


def test_after_a_gap_nothing_is_known_again() -> None:
    model = lasting("hysteresis", HYSTERESIS)
    run = samples(worked_before(model, motion(1), 1.0)[0])
    watch = Watch(model)
    verdicts(watch, run[:200])
    assert np.ptp(watch._inputs.carried.ends[0]) < 0.01
    watch.step(run[203])  # three samples lost: the arm may have moved to and fro
    lo, hi = watch._inputs.carried.ends[0]
    assert hi - lo > 1.5


def test_a_monitor_that_joins_late_encloses_what_the_identification_carried() -> None:
    """Identification starts at each recording's own start, the monitor wherever it is switched on: the same model holds."""
    model = lasting("hysteresis", HYSTERESIS)
    r, z = worked_before(model, motion(2), get("hysteresis").at_start[0])
    u = model.input(r.q, r.dq, r.tau, t=r.t)
    for first in (1, 17, 60):
        inputs = Watch(model)._inputs
        for k in range(first, len(r.t)):
            lo, hi = inputs.carried.ends[0]
            assert lo - 1e-9 <= z[k] <= hi + 1e-9
            mine, du = inputs(r.q[k], r.dq[k], r.tau[k], None)
            assert np.all(np.abs(mine - u[k]) <= du + 1e-9)


def test_a_rounded_speed_may_turn_the_state_either_way() -> None:
    model = lasting("hysteresis", HYSTERESIS)
    r, z = worked_before(model, motion(3), -1.0)
    step = {"q": 1e-4, "dq": 2e-2, "tau": 0.05}
    rounded = replace(r, **{k: np.round(getattr(r, k) / x) * x for k, x in step.items()})
    half = Quantum(*(np.full(6, 0.5 * x) for x in step.values()))
    watch = Watch(model, half)
    for k, s in enumerate(samples(rounded)):
        lo, hi = watch._inputs.carried.ends[0]
        assert lo - 1e-9 <= z[k] <= hi + 1e-9
        assert not watch.step(s).deviations


def test_a_drive_is_no_warmer_than_its_fastest_work() -> None:
    model = lasting("self_heating", HEATING)
    (state,) = Carried.of(model).states
    fastest = max(2.0, float(model.robot.dq_limit[0]))
    assert state.whole[0] == pytest.approx(0.0, abs=1e-12) and fastest <= state.whole[1] <= fastest + 1e-9
    assert Carried.of(lasting("hysteresis", HYSTERESIS)).states[0].whole == pytest.approx((-1.0, 1.0))


def test_a_memory_that_no_ends_enclose_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("stopset.monitor.carried.affine", lambda _: False)
    with pytest.raises(NotCovered, match=r"hysteresis:.* remembers z"):
        Watch(lasting("hysteresis", HYSTERESIS))


def test_a_law_of_time_is_refused_and_never_taken_at_time_zero(own_effect: Effect) -> None:
    """A healthy arm whose hose gives way: at t = 0 for ever it would be accused, as its torque is another by then."""
    values = {"k": 300.0, "T": 0.2}
    with pytest.raises(NotCovered, match=r"relaxing_hose.*time since its recording began"):
        Watch(lasting(own_effect.name, values))
    with pytest.raises(NotCovered, match="time since its recording began"):
        watch_for(
            replace(lasting(own_effect.name, values), abstraction=curved().abstraction), Quantum.none(6), None, (0.0, 1.0), DT
        )


def bent(name: str, needs: tuple[str, ...], law: Law) -> Effect:
    return replace(get("warm_up"), name=name, needs=needs, law=law, terms=get("warm_up").terms[:1])


def test_a_law_that_looks_at_what_no_sample_holds_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the place in the session the two ends are known: enough for a straight law, not for one with a top between them."""
    made = {
        "top": bent("top", ("warm",), lambda s, _: (s.warm * (1.0 - s.warm),)),
        "late": bent("late", ("dtau",), lambda s, _: (s.dtau,)),
    }  # fmt: skip
    monkeypatch.setattr(unseen, "get", lambda name: made.get(name) or get(name))
    for name, words in (("top", "place in the session along a curve"), ("late", "rate of its torque")):
        with pytest.raises(NotCovered, match=words):
            unseen.refuse_unseen([Fitted(name, "j", {"k_v": 1.0}, {})])
    unseen.refuse_unseen([Fitted("warm_up", "j", {"k_v": 1.0, "k_c": 1.0}, {})])
    assert unseen.even_in_session(get("warm_up"))
