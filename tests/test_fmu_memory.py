"""The FMU of a model whose effects remember: their states are integrated beside the motion, and are part of a saved state."""

from __future__ import annotations

import shutil
import subprocess
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fmu_models import arm_model
from stopset.artifact import Model
from stopset.artifact.inputs import memories_along
from stopset.effects import get
from stopset.effects.signals import Samples
from stopset.errors import EffectError
from stopset.fmu import Contents, archive
from stopset.fmu.check import Instance
from stopset.fmu.reference import reference
from stopset.fmu.variables import variables
from stopset.types import Array
from test_fmu import (
    AGREE,
    BOUNDS,
    DT,
    HERE,
    STATE,
    columns,
    exported,
    friction,
    held,
    joint_inputs,
    names,
    reference_of,
    simulate,
)

fmpy = pytest.importorskip("fmpy")
pytest.importorskip("ziglang")
pytestmark = pytest.mark.skipif(HERE is None, reason="no FMU binaries for this platform")
__all__ = ["exported"]  # the fixture

REMEMBERED = ("hysteresis_z_axis_1", "self_heating_w_axis_1", "hysteresis_z_axis_2")
EFFECTS = (
    friction("coulomb", "axis_1", F_c=3.0),
    friction("hysteresis", "axis_1", F_h=2.0, delta=0.004),
    friction("self_heating", "axis_1", k_c=-1.0, k_v=-0.5, tau_w=0.7),
    friction("coulomb", "axis_2", F_c=2.0),
    friction("hysteresis", "axis_2", F_h=1.5, delta=0.01),
    friction("load_coulomb", "axis_2", k_lift=0.1, k_lower=0.05),
)


def lasting() -> Model:
    return arm_model(3, effort="motor_torque", effects=EFFECTS, offset=True, horizon=3.0)


def wound() -> Model:
    """Friction that is hysteresis alone, ``F z``: a smooth differential equation that any solver can check."""
    effects = [friction(e, "axis_1", **v) for e, v in (("coulomb", {"F_c": 3.0}), ("hysteresis", {"F_h": 3.0, "delta": 0.02}))]
    return arm_model(1, effects=effects)


@pytest.mark.parametrize("fmi", [2, 3])
def test_reference_results_hold_and_the_states_are_python_s(exported: Any, fmi: int) -> None:
    """Measured inputs connected: states step with the measured motion, as the identification steps them."""
    from fmpy.validation import validate_fmu

    model = lasting()
    fmu = exported(model, "lasting", fmi)
    assert validate_fmu(str(fmu)) == []
    given, wanted = reference_of(fmu)
    inputs = {k: given[k] for k in names(model, "tau", "temp", "q_measured", "dq_measured")} | {
        "measured": given["measured"] == 1
    }
    out = simulate(model, fmu, given["time"], inputs, [*names(model, *STATE, *BOUNDS), *REMEMBERED, "verdict", "covered"])
    for k in names(model, *STATE, *BOUNDS):
        assert np.abs(out[k] - wanted[k]).max() < AGREE, k
    assert np.all(out["covered"] == 1) and np.all(out["verdict"] == 1)
    r = reference(model)
    states = memories_along(model.robot, model.input.effects, Samples(r.x[:, :3], r.x[:, 3:], t=r.t))
    for name, (z,) in zip(REMEMBERED, states.values(), strict=True):
        assert np.ptp(z) > 0.01 and np.abs(out[name] - z).max() < AGREE, name


def test_hysteresis_alone_is_the_differential_equation_it_says(exported: Any) -> None:
    """At its own state, with reversals, and in communication steps of any length: a solver of others gives the same."""
    model = wound()
    J, v = 1.0 / model.abstraction.Minv[0, 0], model.abstraction.viscous[0, 0]
    tau, z0, rows = held(1, 301, seed=4, size=20.0), -0.6, 301

    def flow(_: float, y: Array, u: float) -> Array:
        _q, dq, z = y
        return np.array([dq, (u - v * dq - 3.0 * z) / J, (dq - z * abs(dq)) / 0.02])

    want = np.zeros((rows, 3))
    want[0] = (0.0, 0.0, z0)
    for k in range(rows - 1):
        want[k + 1] = solve_ivp(flow, (0, DT), want[k], rtol=1e-12, atol=1e-14, max_step=DT / 20, args=(tau[k, 0],)).y[:, -1]
    assert np.sum(np.diff(np.sign(want[1:, 1])) != 0) > 5 and np.ptp(want[:, 2]) > 1.5, "it turns round many times"
    for split in (1, 10):
        t = DT / split * np.arange(split * (rows - 1) + 1)
        torque = {"tau_axis_1": np.repeat(tau[:, 0], split)[: len(t)]}
        watched = ["q_axis_1", "dq_axis_1", "hysteresis_z_axis_1"]
        out = simulate(model, exported(model, "wound", 3), t, torque, watched, {"hysteresis_z_start_axis_1": z0})
        got = np.column_stack([out[k] for k in watched])[::split]
        assert np.abs(got - want).max() < 1e-8  # the solver's own error at a corner of |dq|


def test_the_communication_step_does_not_matter(exported: Any) -> None:
    model, tau = lasting(), held(3, 201, seed=1) + np.array([0.0, -8.0, 0.0])
    runs = []
    for split in (1, 10):
        t = DT / split * np.arange(200 * split + 1)
        inputs = joint_inputs(model, "tau", np.repeat(tau, split, axis=0)[: len(t)])
        out = simulate(model, exported(model, "lasting", 3), t, inputs, [*names(model, *STATE), *REMEMBERED])
        runs.append(np.column_stack([columns(out, model, *STATE), *(out[k] for k in REMEMBERED)])[::split])
    assert np.abs(runs[0] - runs[1]).max() < AGREE
    assert min(np.ptp(runs[0][:, 6:], axis=0)) > 0.05


@pytest.mark.parametrize("fmi", [2, 3])
def test_model_exchange_follows_co_simulation(exported: Any, fmi: int) -> None:
    """What is remembered is a continuous state that the importer integrates."""
    model, t = wound(), DT * np.arange(101)
    tau, watched = held(1, 101, size=20.0), ["q_axis_1", "dq_axis_1", "hysteresis_z_axis_1"]
    fmu = exported(model, "wound", fmi)
    cs = simulate(model, fmu, t, {"tau_axis_1": tau[:, 0]}, watched)
    twice, torque = np.repeat(t, 2)[1:], np.repeat(tau[:, 0], 2)[:-1]
    me = simulate(
        model, fmu, twice, {"tau_axis_1": torque}, watched, kind="ModelExchange", output_interval=DT, relative_tolerance=1e-9
    )  # fmt: skip
    rows = [np.flatnonzero(np.abs(me["time"] - x) < 1e-9)[-1] for x in t]
    assert np.ptp(cs["hysteresis_z_axis_1"]) > 0.5
    assert max(float(np.abs(me[k][rows] - cs[k]).max()) for k in watched) < 1e-6


def test_another_start_is_another_motion_and_not_covered(exported: Any) -> None:
    model, t = lasting(), DT * np.arange(60)
    flags = {"measured": np.ones(60, bool)}
    for z, covered in ((0.0, 1), (0.8, 0)):
        start = {"hysteresis_z_start_axis_1": z}
        out = simulate(model, exported(model, "lasting", 3), t, flags, ["hysteresis_z_axis_1", "covered"], start)
        assert out["hysteresis_z_axis_1"][0] == z and np.all(out["covered"] == covered)


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_saved_state_holds_what_was_remembered(exported: Any, fmi: int) -> None:
    """Serialised in the middle, given to another instance of the same process: both end where the first would have."""
    model = wound()
    fmu, state = exported(model, "wound", fmi), ["q_axis_1", "hysteresis_z_axis_1"]
    description, folder = fmpy.read_model_description(fmu), fmpy.extract(fmu)
    a, b = (Instance(description, folder) for _ in "ab")
    for arm in (a, b):
        arm.slave.exitInitializationMode()

    def play(arm: Instance, rows: range) -> list[float]:
        for k in rows:
            arm.set("tau_axis_1", 15.0 * np.sin(0.2 * k))
            arm.step(k * DT, DT)
        return arm.get(state).tolist()  # type: ignore[no-any-return]

    name = "FMUstate" if fmi == 2 else "FMUState"
    get, put = (lambda u: getattr(u.slave, f"get{name}")()), (lambda u, x: getattr(u.slave, f"set{name}")(x))
    halfway = play(a, range(50))
    saved = get(a)
    stored = getattr(a.slave, f"serialize{name}")(saved)
    end = play(a, range(50, 100))
    assert abs(end[1] - halfway[1]) > 0.05, "what is remembered went on"
    put(b, getattr(b.slave, f"{'deSerialize' if fmi == 2 else 'deserialize'}{name}")(stored))
    assert b.get(state).tolist() == halfway
    assert play(b, range(50, 100)) == end
    put(a, saved)
    assert play(a, range(50, 100)) == end


def test_other_importers_and_compilers_agree(exported: Any, tmp_path: Path) -> None:
    model, v = wound(), variables(wound())
    torque = 15.0 * np.sin(0.2 * np.arange(101))
    watched = ["q_axis_1", "hysteresis_z_axis_1"]
    out = simulate(model, exported(model, "wound", 3), DT * np.arange(101), {"tau_axis_1": torque}, watched)
    want, places = np.array([out[k][100] for k in watched]), [v.reference(k) for k in watched]
    ran = 0
    try:
        from fmuloader.fmi3 import Fmi3Slave
    except ImportError:
        pass
    else:
        xml = zipfile.ZipFile(exported(model, "wound", 3)).read("modelDescription.xml").decode()
        slave = Fmi3Slave(exported(model, "wound", 3), model_identifier="stopset_test_arm")
        slave.instantiate_co_simulation("a", instantiation_token=xml.split('instantiationToken="')[1].split('"')[0])
        slave.enter_initialization_mode(0.0)
        slave.exit_initialization_mode()
        for k in range(100):
            slave.set_float64([v.reference("tau_axis_1")], [torque[k]])
            slave.do_step(k * DT, DT)
        assert np.abs(np.array(slave.get_float64(places)) - want).max() < AGREE
        ran += 1
    try:
        from libcosimpy.CosimExecution import CosimExecution
        from libcosimpy.CosimManipulator import CosimManipulator
        from libcosimpy.CosimObserver import CosimObserver
        from libcosimpy.CosimSlave import CosimLocalSlave
    except ImportError:
        pass
    else:
        execution = CosimExecution.from_step_size(round(DT * 1e9))
        index = execution.add_local_slave(CosimLocalSlave(str(exported(model, "wound", 2)), "arm"))
        observer, manipulator = CosimObserver.create_last_value(), CosimManipulator.create_override()
        execution.add_observer(observer)
        execution.add_manipulator(manipulator)
        for k in range(100):
            manipulator.slave_real_values(index, [v.reference("tau_axis_1")], [float(torque[k])])
            execution.step()
        assert np.abs(np.array(observer.last_real_values(index, places)) - want).max() < AGREE
        ran += 1
    gcc = shutil.which("gcc")
    if gcc:
        with zipfile.ZipFile(exported(lasting(), "lasting", 3)) as z:
            z.extractall(tmp_path, [p for p in z.namelist() if p.startswith("sources/")])
        units = sorted(p.name for p in (tmp_path / "sources").glob("*.c"))
        strict = ["-Wall", "-Wextra", "-Werror", "-Wconversion", "-Wno-sign-conversion"]
        command = [gcc, "-std=c99", "-O1", "-shared", "-fPIC", *strict, *units, "-lm", "-o", "x.so"]
        done = subprocess.run(command, cwd=tmp_path / "sources", capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr[-2000:]
        ran += 1
    if not ran:
        pytest.skip("neither fmuloader, libcosimpy nor gcc is installed")


def test_a_memory_that_is_no_single_affine_state_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    two = replace(get("hysteresis"), states=get("elasticity").states, flow=get("elasticity").flow)
    monkeypatch.setattr("stopset.fmu.laws.get", lambda _: two)
    with pytest.raises(EffectError, match="remembers x, dx; an FMU carries one state"):
        archive(wound(), Contents(3, (str(HERE),)))
