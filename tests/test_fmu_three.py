"""What FMI 3 has beyond FMI 2: arrays, clocks, times within a step; and a payload that changes while the arm runs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmu_models import arm_model
from fmu_unit import Unit, unit
from stopset.artifact import Model
from stopset.errors import OutputError
from stopset.fmu import Contents, archive, export
from stopset.fmu.build import native
from stopset.fmu.stops import bounds_of
from stopset.reach.stops import StopBounds
from stopset.sets import Box
from test_fmu import EFFECTS, exported, friction  # noqa: F401
from test_fmu_stops import braked, braking, equals, silent

pytest.importorskip("fmpy")
pytest.importorskip("ziglang")
pytestmark = pytest.mark.skipif(native() is None, reason="no FMU binaries for this platform")
Q, DQ = np.array([0.3, 0.5, -0.2]), np.array([0.4, -0.5, 0.3])


def test_arrays_are_the_scalars(exported: Any) -> None:  # noqa: F811
    model = braked(8.0, 3)
    J, torque = model.joints, np.array([1.0, -2.0, 3.0])
    with unit(exported(model, "braked")) as a, unit(exported(model, "braked")) as b:
        a.slave.setFloat64([a.variables["q_start"].valueReference], Q.tolist())
        a.begin()
        b.set({f"q_start_{j}": x for j, x in zip(J, Q.tolist(), strict=True)})
        b.begin()
        # an array between two scalars
        names = ["temp_axis_1", "tau", "temp_axis_2"]
        a.slave.setFloat64([a.variables[n].valueReference for n in names], [30.0, *torque.tolist(), 31.0])
        b.set({f"tau_{j}": x for j, x in zip(J, torque.tolist(), strict=True)} | {"temp_axis_1": 30.0, "temp_axis_2": 31.0})
        a.step(0.01)
        b.step(0.01)
        for stem in ("q", "dq", "q_lo", "q_hi", "tau", "temp", "q_start", "stop_time", "stop_forward"):
            assert np.array_equal(a.array(stem, 3), b.joints(stem, J)), stem
        assert np.abs(a.array("q", 3) - Q).min() > 0.0
        mixed = a.slave.getFloat64([a.variables[n].valueReference for n in ("age", "dq", "time")], 5)
        assert mixed == [0.01, *b.joints("dq", J).tolist(), 0.01]
        with pytest.raises(Exception, match="fmi3GetFloat64"):
            a.slave.getFloat64([a.variables["q"].valueReference], 2)
        seeds = [0.0, 1.0, 0.0]
        by_array = a.slave.getDirectionalDerivative(
            [a.variables["q_lo"].valueReference], [a.variables["q"].valueReference], seeds, 3
        )
        one, lows = b.variables["q_axis_2"].valueReference, [b.variables[f"q_lo_{j}"].valueReference for j in J]
        assert by_array == b.slave.getDirectionalDerivative(lows, [one], [1.0], 3)


@pytest.fixture(scope="module")
def clocked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export(braking(), tmp_path_factory.mktemp("clocks") / "F.fmu", Contents(3, (str(native()),), clocks=True))


@pytest.mark.parametrize("category", [0, 1, 2])
def test_a_clock_asks_for_a_stop_as_the_input_does(clocked: Path, category: int) -> None:
    model = braking()
    runs = []
    for by_clock in (True, False):
        with unit(clocked, eventModeUsed=by_clock) as u:
            u.set({f"dq_start_{j}": x for j, x in zip(model.joints, DQ.tolist(), strict=True)})
            u.begin()
            if by_clock:
                u.slave.updateDiscreteStates()
                u.slave.enterStepMode()
            u.step(0.01)
            if by_clock:
                u.tick(f"request_stop_{category}")
            else:
                u.set({"stop": category + 1})
            for _ in range(30):
                u.step(0.01)
            values = [u.joints(x, model.joints) for x in ("q", "dq", ("stop", "stop1_guaranteed", "stop2")[category] + "_angle")]
            runs.append(np.concatenate(values))
    assert np.array_equal(runs[0], runs[1]) and np.all(np.isfinite(runs[0]))


def test_a_clock_ticks_in_event_mode_alone_and_is_there_where_it_was_asked_for(clocked: Path) -> None:
    with pytest.raises(OutputError, match="expected FMI 3"):
        archive(braking(), Contents(2, source_only=True, clocks=True))
    with unit(clocked) as u:
        u.begin()
        with pytest.raises(Exception, match="fmi3SetClock"):
            u.slave.setClock([u.variables["request_stop_0"].valueReference], [True])
        with pytest.raises(Exception, match="fmi3EnterEventMode"):
            u.slave.enterEventMode()


@pytest.mark.parametrize("stop", [1, 2])
def test_a_step_ends_where_the_arm_comes_to_rest(exported: Any, stop: int) -> None:  # noqa: F811
    """At the very time: a step before it moves still, and the full step says the same where."""
    model = braking()
    moving = {f"dq_start_{j}": x for j, x in zip(model.joints, DQ.tolist(), strict=True)}
    with unit(exported(model, "ramp"), earlyReturnAllowed=True) as u, unit(exported(model, "ramp")) as plain:
        for x in (u, plain):
            x.set(moving)
            x.begin()
            x.set({"stop": stop})
        *_, early, rests = u.slave.doStep(0.0, 2.0)
        assert early and 0.01 < rests < 2.0
        assert u.get("time") == rests and np.all(np.abs(u.joints("dq", model.joints)) <= 1e-12)
        *_, again, end = u.slave.doStep(rests, 2.0 - rests)
        assert not again and end == 2.0, "it has been at rest"
        *_, early, _ = plain.slave.doStep(0.0, rests - 1e-4)
        assert not early and np.abs(plain.joints("dq", model.joints)).max() > 1e-6
        plain.slave.doStep(rests - 1e-4, 2.0 - rests + 1e-4)
        assert np.abs(plain.joints("q", model.joints) - u.joints("q", model.joints)).max() < 1e-9


def test_a_step_tells_of_the_way_and_ends_where_it_is_asked_to(exported: Any) -> None:  # noqa: F811
    model = arm_model(3, effort="motor_torque", effects=EFFECTS[:3])
    seen: list[tuple[float, float]] = []
    ends = [0.05]
    units: list[Unit] = []

    def update(_: Any, t: float, asked: bool, allowed: bool, finished: bool, may_end: bool, request: Any, until: Any) -> None:
        assert allowed and finished and not asked
        u = units[0]
        seen.append((t, u.get("q_axis_1")))
        with pytest.raises(Exception, match="fmi3SetFloat64"):
            u.set({"tau_axis_1": 0.0})
        if ends and may_end:
            request[0], until[0] = True, max(ends[0], t)

    fmu = exported(model, "free")
    with unit(fmu, earlyReturnAllowed=True, intermediateUpdate=update) as u, unit(fmu) as plain:
        units.append(u)
        for x in (u, plain):
            x.begin()
            x.set({"tau_axis_1": 60.0, "tau_axis_2": -40.0})
        *_, early, t = u.slave.doStep(0.0, 0.2)
        assert early and abs(t - 0.05) < 1e-15
        ends.clear()
        u.slave.doStep(t, 0.2 - t)
        times = [t for t, _ in seen]
        assert len(times) > 3 and times == sorted(times) and 0.05 < max(times) < 0.2
        # what was told is what a run with steps of that length says
        done = 0.0
        for t, q in sorted(set(seen)):
            plain.slave.doStep(done, t - done)
            assert abs(plain.get("q_axis_1") - q) < 1e-9
            done = t


def test_ranges_of_payload_and_temperature_widen_the_bound() -> None:
    """What is given wider is bounded wider; the unit has these bounds to the last bit."""
    warm = friction("thermal_viscous", "axis_1", k_T=-0.05, b=0.025)
    model = braked(8.0, 3, effort="motor_torque", effects=[friction("viscous", "axis_1", F_v=20.0), warm])
    d = model.domain
    narrow = {"payload": replace(d, payload=(0.0, 0.0)), "temp": replace(d, temp=Box.of(np.full(3, 34.0), np.full(3, 35.0)))}
    wide = bounds_of(model).bound(Q, DQ)
    assert wide.forward is not None and wide.back is not None
    for name, domain in narrow.items():
        less = bounds_of(replace(model, domain=domain)).bound(Q, DQ)
        assert less.forward is not None and less.back is not None
        assert np.all(wide.forward >= less.forward) and np.all(wide.back >= less.back), name
        assert wide.forward[0] > less.forward[0], name


def twin(model: Model, lo: float, hi: float) -> StopBounds:
    """The bounds of a range of payloads within the identified one, whose curvature and effects the unit keeps."""
    whole, part = bounds_of(model), StopBounds.of(model, (lo, hi), fast=True)
    assert whole.setting is not None and part.setting is not None
    plant = whole.setting.plant._replace(pi=part.setting.plant.pi, pi_half=part.setting.plant.pi_half)
    return replace(whole, setting=replace(whole.setting, plant=plant))


def test_a_range_of_payloads_set_in_the_unit_is_bounded_as_wide_as_it_is(exported: Any) -> None:  # noqa: F811
    """To the bit; it encloses what is inside, is no wider than all that was identified, and leaves it for nothing."""
    model = braked(8.0, 3)
    with unit(exported(model, "braked")) as u:
        u.begin()
        u.state(model, Q, DQ)

        def angles(lo: float, hi: float) -> np.ndarray:
            u.set({"payload_lo": lo, "payload_hi": hi, "payload_mass": lo})
            assert equals(u, model, twin(model, lo, hi).bound(Q, DQ))
            return u.joints("stop_angle", model.joints)

        whole, half = angles(0.0, 2.0), angles(0.5, 1.0)
        for kg in (0.5, 0.7, 1.0):
            assert np.all(angles(kg, kg) <= half)
        assert np.all(half <= whole) and np.any(half < whole)
        u.set({"payload_lo": 0.5, "payload_hi": 2.5, "payload_mass": 1.0})
        assert silent(u, model), "beyond what was identified"
        u.set({"payload_hi": 2.0})
        assert u.get("stop_certified") == 1
        u.set({"payload_mass": 0.2})
        assert silent(u, model), "another load than the range says"


def test_a_range_that_is_none_or_beyond_the_identified_one_is_not_covered(exported: Any) -> None:  # noqa: F811
    model = braked(8.0, 3)
    for bad in ({"payload_lo": 1.5, "payload_hi": 1.0}, {"temp_lo_axis_2": 40.0, "temp_hi_axis_2": 30.0}):
        with unit(exported(model, "braked")) as u:
            u.set(bad)
            with pytest.raises(Exception, match="ExitInitialization"):
                u.begin()
        with unit(exported(model, "braked")) as u:
            u.begin()
            u.set(bad)
            assert silent(u, model) and not u.get("covered")
            with pytest.raises(Exception, match="DoStep"):
                u.step(0.01)
    with unit(exported(model, "braked")) as u:
        u.begin()
        for name in ("payload_lo", "payload_hi", "temp_lo_axis_1", "temp_hi_axis_3"):
            for x in (float("nan"), float("inf")):
                with pytest.raises(Exception, match="SetFloat64"):
                    u.set({name: x})
        assert u.get("covered") == 1
        for beyond in ({"payload_hi": 2.1}, {"temp_hi_axis_1": 56.0}, {"temp_lo_axis_3": 14.0}):
            before = {name: u.get(name) for name in beyond}
            u.set(beyond)
            assert u.get("covered") == 0 and silent(u, model), beyond
            u.set(before)
            assert u.get("covered") == 1 and u.get("stop_certified") == 1


def test_a_temperature_outside_the_range_asked_for_is_not_covered(exported: Any) -> None:  # noqa: F811
    """The bound is that of every temperature that was identified, so it holds for a part of them too."""
    model = braked(8.0, 3)
    want = bounds_of(model).bound(Q, DQ)
    with unit(exported(model, "braked")) as u:
        u.begin()
        u.state(model, Q, DQ)
        u.set({"temp_lo_axis_1": 20.0, "temp_hi_axis_1": 40.0})
        assert equals(u, model, want) and u.get("covered")
        u.set({"temp_axis_1": 45.0})
        assert silent(u, model) and not u.get("covered")
        u.set({"temp_hi_axis_1": 55.0})
        assert equals(u, model, want) and u.get("covered")


def test_another_payload_in_a_run_is_not_covered_until_a_measured_state_begins_anew(exported: Any) -> None:  # noqa: F811
    """Within the identified range the stop bound, which holds for all of it, is the same; beyond it there is none."""
    model = braked(8.0, 3)
    want = bounds_of(model).bound(Q, DQ)
    with unit(exported(model, "braked")) as u:
        u.begin()
        u.step(0.01)
        assert u.get("covered")
        u.set({"payload_mass": 1.5})
        assert not u.get("covered")
        u.step(0.01)
        assert not u.get("covered"), "the prediction began without the load"
        u.state(model, Q, DQ)
        u.step(0.01)
        assert u.get("covered") and u.get("age") == pytest.approx(0.01)
        assert equals(u, model, want)
        u.set({"payload_mass": 2.5})
        assert not u.get("covered") and silent(u, model)
        with pytest.raises(Exception, match="fmi3SetFloat64"):
            u.set({"payload_mass": float("nan")})
