"""Parameters that may change in a run: the unit is from then on one that began with the other value, or says nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stopset.artifact import Model
from stopset.fmu import Contents, export
from stopset.fmu.build import native
from stopset.fmu.check import Instance
from stopset.fmu.variables import variables
from test_fmu import names
from test_fmu_stops import braking

pytest.importorskip("fmpy")
pytest.importorskip("ziglang")
pytestmark = pytest.mark.skipif(native() is None, reason="no FMU binaries for this platform")
STATE = (0.3, 0.5, -0.2, 0.4, -0.5, 0.3)


def tunables(model: Model) -> dict[str, tuple[float, float]]:
    """Every real one, with a value within what was identified and one beyond it."""
    given = {
        "payload_mass": (0.5, 2.5), "payload_lo": (0.0, -0.5), "payload_hi": (1.5, 2.5), "ss1_off_after": (0.36, -1.0), "warm": (1.0, 1.5),
    }  # fmt: skip
    for j in model.joints:
        given |= {f"temp_lo_{j}": (20.0, 10.0), f"temp_hi_{j}": (40.0, 60.0)}
    assert set(given) == {v.name for v in variables(model) if v.variability == "tunable" and v.kind == "Real"}, "each is here"
    return given


class Unit(Instance):
    """With a state measured and ``given`` parameters, after initialization."""

    def __init__(self, description: Any, folder: str, model: Model, given: dict[str, float]) -> None:
        super().__init__(description, folder)
        state = dict(zip(names(model, "q_start", "dq_start", "q_measured", "dq_measured"), (*STATE, *STATE), strict=True))
        for name, x in (state | {"measured": 1.0} | given).items():
            self.set(name, x)
        self.slave.exitInitializationMode()

    def flags(self) -> dict[str, bool]:
        found = [n for n in self.variables if n == "covered" or n.endswith("_certified")]
        return {n: bool(self.slave.getBoolean([self.variables[n].valueReference])[0]) for n in found}

    def bounds(self) -> Any:
        scalars = {n: v for n, v in self.variables.items() if v.causality == "output" and not v.dimensions}
        return self.get([n for n in scalars if "stop" in n and not n.endswith(("_certified", "_end_stop"))])


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_parameter_changed_in_a_run_is_that_of_a_unit_that_began_with_it(tmp_path: Path, fmi: int) -> None:
    """Read before, so that a bound is at hand; then to the last bit, and nothing beyond what was identified."""
    import fmpy

    model = braking()
    path = export(model, tmp_path / "u.fmu", Contents(fmi, (str(native()),), reference=False))
    description, folder = fmpy.read_model_description(str(path)), fmpy.extract(str(path), str(tmp_path / "unpacked"))
    for name, (within, beyond) in tunables(model).items():
        running = Unit(description, folder, model, {})
        assert all(running.flags().values()) and np.all(np.isfinite(running.bounds()))
        for x in (within, beyond, within):
            running.set(name, x)
            fresh = Unit(description, folder, model, {name: x})
            assert np.array_equal(running.bounds(), fresh.bounds(), equal_nan=True), (name, x)
            now, want = running.flags(), fresh.flags()
            if name == "payload_mass":  # taken up in the run: uncovered until a prediction begins with it
                assert not now.pop("covered") and want.pop("covered") is (x == within)
            assert now == want, (name, x)
            if name == "ss1_off_after":  # power never taken: the ramp that fails proves nothing, the others what they did
                assert want == dict.fromkeys(want, True) | {"stop1_guaranteed_certified": x == within}
            else:
                assert set(want.values()) == {x == within}, (name, x)
            fresh.slave.freeInstance()
        for x in (float("nan"), float("inf")):
            with pytest.raises(Exception, match="Set"):
                running.set(name, x)
        running.slave.freeInstance()


@pytest.mark.parametrize("name", ["payload_mass", "payload_hi"])
def test_a_parameter_changed_while_the_arm_stops_ends_the_bounds_of_the_request(tmp_path: Path, name: str) -> None:
    """They were proved for another arm; and no bound of zero is left in their place."""
    import fmpy

    model = braking()
    path = export(model, tmp_path / "u.fmu", Contents(3, (str(native()),), reference=False))
    description, folder = fmpy.read_model_description(str(path)), fmpy.extract(str(path), str(tmp_path / "unpacked"))
    u = Unit(description, folder, model, {"stop": 1})
    u.step(0.0, 0.01)
    assert u.flags()["stop_certified"] and np.all(np.isfinite(u.get(names(model, "stop_angle", "q_lo", "q_hi"))))
    u.set(name, 1.25)
    assert not any(u.flags().values()) and np.all(np.isnan(u.get(names(model, "stop_angle", "stop_time", "q_lo", "q_hi"))))
    u.slave.freeInstance()
