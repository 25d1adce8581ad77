"""What the units say they can do, done by an importer that nobody here wrote: states, derivatives, clocks, model exchange (fmuloader)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy import read_model_description

from stopset.fmu import Contents, export
from stopset.fmu.build import native
from test_fmu import EFFECTS
from test_fmu_stops import braked, braking

pytest.importorskip("ziglang")
fmi2, fmi3 = pytest.importorskip("fmuloader.fmi2"), pytest.importorskip("fmuloader.fmi3")
pytestmark = pytest.mark.skipif(native() is None, reason="no FMU binaries for this platform")
EFFECTFUL = braked(8.0, 3, effort="motor_torque", effects=EFFECTS, offset=True)
H = 0.01


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder, here = tmp_path_factory.mktemp("units"), (str(native()),)
    models = {"effects": EFFECTFUL, "ramp": braking()}
    return {
        name: export(models[name.split("-")[0]], folder / f"{name}.fmu", Contents(int(name[-1]), here, clocks="ramp" in name))
        for name in ("effects-2", "effects-3", "ramp-3")
    }


class Loaded:
    """An instance by names, in initialization mode."""

    def __init__(self, unit: Path, fmi: int, *, exchange: bool = False, events: bool = False) -> None:
        about = read_model_description(str(unit))
        self.at = {v.name: v.valueReference for v in about.modelVariables}
        self.indicators = about.numberOfEventIndicators
        identifier = about.coSimulation.modelIdentifier
        if fmi == 2:
            self.slave = fmi2.Fmi2Slave(unit, model_identifier=identifier)
            kind = fmi2.Fmi2Type.MODEL_EXCHANGE if exchange else fmi2.Fmi2Type.CO_SIMULATION
            self.slave.instantiate("a", kind, guid=about.guid)
            self.slave.setup_experiment(start_time=0.0)
            self.slave.enter_initialization_mode()
            self.get, self.put = self.slave.get_real, self.slave.set_real
            return
        self.slave = fmi3.Fmi3Slave(unit, model_identifier=identifier)
        if exchange:
            self.slave.instantiate_model_exchange("a", instantiation_token=about.guid)
        else:
            self.slave.instantiate_co_simulation("a", instantiation_token=about.guid, event_mode_used=events)
        self.slave.enter_initialization_mode(0.0)
        self.get, self.put = self.slave.get_float64, self.slave.set_float64

    def of(self, stem: str) -> list[int]:
        return [self.at[f"{stem}_axis_{j}"] for j in (1, 2, 3)]

    def run(self, first: int, last: int, size: float) -> np.ndarray:
        for k in range(first, last):
            self.put(self.of("tau"), [size * x for x in (20.0 - 8.0 * (k // 10 % 5), 9.0, -6.0)])
            self.slave.do_step(k * H, H)
        return np.array(self.get(self.of("q") + self.of("dq")))


@pytest.mark.parametrize("fmi", [2, 3])
def test_instances_run_beside_each_other_and_a_state_comes_back_anywhere(made: dict[str, Path], fmi: int) -> None:
    a, b = (Loaded(made[f"effects-{fmi}"], fmi) for _ in range(2))
    for x in (a, b):
        x.slave.exit_initialization_mode()
    before = a.run(0, 20, 1.0)
    saved = a.slave.get_fmu_state()
    stored = a.slave.serialize_fmu_state(saved)
    after = a.run(20, 40, 1.0)
    other = b.run(0, 20, -0.5)
    assert not np.array_equal(before, other) and not np.array_equal(before, after)
    a.slave.set_fmu_state(saved)
    assert np.array_equal(a.run(20, 40, 1.0), after)
    b.slave.set_fmu_state(b.slave.deserialize_fmu_state(stored))
    assert np.array_equal(b.run(20, 40, 1.0), after)


@pytest.mark.parametrize("fmi", [2, 3])
def test_derivatives_of_model_exchange_are_those_of_the_state(made: dict[str, Path], fmi: int) -> None:
    """States, their rates by differences of the outputs, one event indicator per joint, derivatives along and back."""
    x = Loaded(made[f"effects-{fmi}"], fmi, exchange=True)
    x.put(x.of("dq_start"), [0.5, -0.4, 0.3])
    x.slave.exit_initialization_mode()
    for _ in range(2):
        (x.slave.new_discrete_states if fmi == 2 else x.slave.update_discrete_states)()
    x.slave.enter_continuous_time_mode()
    state = np.array(x.slave.get_continuous_states(6))
    assert np.array_equal(state[3:], [0.5, -0.4, 0.3])
    rates = np.array((x.slave.get_derivatives if fmi == 2 else x.slave.get_continuous_state_derivatives)(6))
    assert np.array_equal(rates[:3], state[3:]) and np.array_equal(rates[3:], x.get(x.of("ddq")))
    assert x.indicators == 3 and np.array_equal(np.sign(x.slave.get_event_indicators(3)), np.ones(3))
    seed = [1.0, -0.5, 0.25]
    along = np.array([x.slave.get_directional_derivative(x.of("ddq"), [tau], [1.0]) for tau in x.of("tau")]).T
    assert np.abs(along - EFFECTFUL.abstraction.Minv).max() < 1e-8
    assert np.abs(np.array(x.slave.get_directional_derivative(x.of("ddq"), x.of("tau"), seed)) - along @ seed).max() < 1e-8
    if fmi == 3:
        assert np.abs(np.array(x.slave.get_adjoint_derivative(x.of("ddq"), x.of("tau"), seed)) - seed @ along).max() < 1e-12
    x.slave.set_continuous_states([*state[:3], 0.5, 0.0, 0.3])
    assert x.slave.get_event_indicators(3)[1] <= 0.0, "a joint that has come to rest is an event"


def test_a_clock_asks_for_a_stop(made: dict[str, Path]) -> None:
    stopped: list[Any] = []
    for by_clock in (True, False):
        x = Loaded(made["ramp-3"], 3, events=by_clock)
        x.put(x.of("dq_start"), [0.3, -0.2, 0.1])
        x.slave.exit_initialization_mode()
        if by_clock:
            x.slave.set_clock([x.at["request_stop_0"]], [True])
            x.slave.update_discrete_states()
            x.slave.enter_step_mode()
        else:
            x.slave.set_int32([x.at["stop"]], [1])
        for k in range(30):
            x.slave.do_step(k * H, H)
        stopped.append(x.get(x.of("q") + x.of("dq") + x.of("stop_forward")))
    assert stopped[0] == stopped[1] and np.all(np.isfinite(stopped[0])) and stopped[0][3:6] == [0.0, 0.0, 0.0]
