"""The FMU says what the Python model says, in FMI 2 and 3, and refuses what it cannot say."""

from __future__ import annotations

import contextlib
import io
import json
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmu_models import arm_model
from fmu_unit import unit
from stopset.artifact import Model
from stopset.cli.main import main
from stopset.effects import Fitted
from stopset.files import cache_folder
from stopset.fmu import Contents, archive, build, export
from stopset.fmu.build import native
from stopset.fmu.check import SUMS, check_fmu
from stopset.fmu.reference import reference, reference_texts
from stopset.reach.flowpipe import deviation_tube, expm
from stopset.reach.predict import predict
from stopset.robot.rigid import mass_matrix
from stopset.types import Array
from synthetic import with_payload

fmpy = pytest.importorskip("fmpy")
pytest.importorskip("ziglang")
HERE = native()
pytestmark = pytest.mark.skipif(HERE is None, reason="no FMU binaries for this platform")

AGREE = 1e-9  # [rad, rad/s]: what the interface promises between FMU and Python model
DT = 0.01


def friction(effect: str, joint: str | None, /, **values: float) -> Fitted:
    return Fitted(effect, joint, values, {})


EFFECTS = (
    friction("coulomb", "axis_1", F_c=3.0),
    friction("load_coulomb", "axis_2", k_lift=0.1, k_lower=0.05),
    friction("stribeck", "axis_3", F_s=1.5, v_s=0.06),
    friction("thermal_viscous", "axis_1", k_T=-0.05, b=0.025),
    friction("asymmetric_coulomb", "axis_2", F_o=0.4),
    friction("spring", "axis_3", k=0.8, c=0.1),
    friction("encoder_offset", "axis_2", e=0.01),
    friction("base_tilt", None, roll=0.01, pitch=-0.02),
)


@pytest.fixture(scope="session")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Exports for this platform, each model and version once."""
    folder = tmp_path_factory.mktemp("fmu")
    done: dict[str, Path] = {}

    def of(model: Model, name: str, fmi: int = 3) -> Path:
        key = f"{name}{fmi}"
        if key not in done:
            done[key] = export(model, folder / f"{key}.fmu", Contents(fmi, (str(HERE),)))
        return done[key]

    return of


def held(n: int, rows: int, seed: int = 0, size: float = 6.0) -> Array:
    """Torques (rows, n) [N m] that change every ten rows."""
    rng = np.random.default_rng(seed)
    return np.repeat(rng.uniform(-size, size, (rows // 10 + 1, n)), 10, axis=0)[:rows]


def simulate(
    model: Model, fmu: Path, t: Array, inputs: Mapping[str, Array], outputs: list[str], start: Mapping[str, Any] | None = None,
    kind: str = "CoSimulation", said: io.StringIO | None = None, **options: Any,
) -> dict[str, Array]:  # fmt: skip
    """Run an FMU with inputs held from each row of ``t`` on; columns by name."""
    types = [("time", float)] + [(k, np.bool_ if k == "measured" else float) for k in inputs]
    signals = np.zeros(len(t), dtype=types)
    signals["time"] = t
    for k, v in inputs.items():
        signals[k] = v
    if kind == "CoSimulation":
        options = {"step_size": float(t[1] - t[0]), "output_interval": float(t[1] - t[0])} | options
    with contextlib.redirect_stdout(
        io.StringIO() if said is None else said
    ):  # fmpy names every input that is left at its start value
        result = fmpy.simulate_fmu(
            str(fmu), stop_time=float(t[-1]), input=signals, start_values=dict(start or {}), output=outputs,
            fmi_type=kind, **options,
        )  # fmt: skip
    return {name: np.asarray(result[name], float) for name in ("time", *outputs)}


def columns(result: Mapping[str, Array], model: Model, *stems: str) -> Array:
    return np.column_stack([result[f"{s}_{j}"] for s in stems for j in model.joints])


def joint_inputs(model: Model, stem: str, values: Array) -> dict[str, Array]:
    return {f"{stem}_{j}": values[:, k] for k, j in enumerate(model.joints)}


def swift(model: Model) -> Model:
    """The same with Coriolis torque taken off its input."""
    return replace(model, abstraction=replace(model.abstraction, swift=True))


def names(model: Model, *stems: str) -> list[str]:
    return [f"{s}_{j}" for s in stems for j in model.joints]


def reference_of(fmu: Path) -> tuple[Any, Any]:
    """Inputs and results that lie inside a unit."""
    with zipfile.ZipFile(fmu) as z:
        found = [next(n for n in z.namelist() if n.endswith(end)) for end in ("_in.csv", "_ref.csv")]
        texts = [io.StringIO(z.read(n).decode()) for n in found]
    return tuple(np.genfromtxt(x, delimiter=",", names=True, deletechars="") for x in texts)  # type: ignore[return-value]


STATE = ("q", "dq")
BOUNDS = ("q_lo", "dq_lo", "q_hi", "dq_hi")


@pytest.mark.parametrize("fmi", [2, 3])
def test_fmpy_finds_nothing_wrong(exported: Any, fmi: int) -> None:
    from fmpy.validation import validate_fmu

    for name, model in (("arm", arm_model()), ("effects", arm_model(3, effort="motor_torque", effects=EFFECTS, offset=True))):
        assert validate_fmu(str(exported(model, name, fmi))) == []


@pytest.mark.parametrize("fmi", [2, 3])
def test_tools_see_plugs_and_a_picture(exported: Any, fmi: int) -> None:
    """By the standard's schema; every member is a variable of the unit, and none is in two plugs. FMI 2 took them back from FMI 3."""
    etree, image = pytest.importorskip("lxml.etree"), pytest.importorskip("PIL.Image")
    import fmpy

    fmu = exported(arm_model(), "arm", fmi)
    schema = Path(fmpy.__file__).parent / "schema" / "fmi3" / "fmi3TerminalsAndIcons.xsd"
    with zipfile.ZipFile(fmu) as z:
        tree = etree.fromstring(z.read("terminalsAndIcons/terminalsAndIcons.xml"))
        picture = image.open(io.BytesIO(z.read("terminalsAndIcons/icon.png")))
        assert fmi == 3 or z.read("model.png") == z.read("terminalsAndIcons/icon.png"), "where tools of FMI 2 look"
    etree.XMLSchema(etree.parse(str(schema))).assertValid(tree)
    members = [m.get("variableName") for m in tree.iter("TerminalMemberVariable")]
    known = {v.name for v in fmpy.read_model_description(str(fmu)).modelVariables}
    assert len(members) == len(set(members)) and set(members) <= known
    assert {t.get("name") for t in tree.iter("Terminal")} >= {"drive", "sensors", "motion", "bounds", "verdict", "stop"}
    assert picture.size == (96, 96) and len(set(picture.getdata())) == 3


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("coupled", [False, True])
def test_ten_seconds_of_changing_torque_equal_the_python_model(exported: Any, fmi: int, coupled: bool) -> None:
    model = arm_model(coupled=coupled, offset=coupled)
    fmu = exported(model, f"arm{'_coupled' if coupled else ''}", fmi)
    n, t = model.n, DT * np.arange(1001)
    tau, rng = held(n, 1001), np.random.default_rng(5)
    x0 = np.concatenate([rng.uniform(-0.5, 0.5, n), rng.uniform(-0.2, 0.2, n)])
    start = dict(zip(names(model, "q_start", "dq_start"), x0.tolist(), strict=True))
    out = simulate(model, fmu, t, joint_inputs(model, "tau", tau), [*names(model, *STATE, *BOUNDS), "covered"], start)
    x = predict(model.abstraction, DT, x0, tau - model.input.offset)
    tube = deviation_tube(model.abstraction, model.powered)
    assert np.abs(columns(out, model, *STATE) - x).max() < AGREE
    assert np.abs(columns(out, model, "q_lo", "dq_lo") - (x + tube.lo)).max() < AGREE
    assert np.abs(columns(out, model, "q_hi", "dq_hi") - (x + tube.hi)).max() < AGREE
    assert np.all(out["covered"] == 1)


@pytest.mark.parametrize("h", [0.0137, 0.004, 0.25])
def test_any_communication_step_is_exact(exported: Any, h: float) -> None:
    model = arm_model(coupled=True, offset=True)
    fmu, n = exported(model, "arm_coupled", 3), model.n
    t = h * np.arange(round(4 / h) + 1)
    tau = held(n, len(t), seed=2)
    out = simulate(model, fmu, t, joint_inputs(model, "tau", tau), names(model, *STATE))
    A, B = model.abstraction.A, model.abstraction.B
    step = expm(np.block([[A, B], [np.zeros((n, 3 * n))]]) * h)
    x = np.zeros((len(t), 2 * n))
    for k in range(len(t) - 1):
        x[k + 1] = step[: 2 * n] @ np.concatenate([x[k], tau[k] - model.input.offset])
    assert np.abs(columns(out, model, *STATE) - x).max() < AGREE


def test_bounds_between_grid_ages_are_those_of_a_finer_grid(exported: Any) -> None:
    model = arm_model()
    out = simulate(model, exported(model, "arm", 3), DT / 4 * np.arange(401), {}, names(model, *STATE, *BOUNDS))
    fine = deviation_tube(model.abstraction, replace(model.powered, dt=DT / 4, horizon=1.0))
    assert np.abs(columns(out, model, "q_lo", "dq_lo") - columns(out, model, *STATE) - fine.lo).max() < AGREE
    assert np.abs(columns(out, model, "q_hi", "dq_hi") - columns(out, model, *STATE) - fine.hi).max() < AGREE


@pytest.mark.parametrize("fmi", [2, 3])
def test_model_exchange_follows_co_simulation(exported: Any, fmi: int) -> None:
    model = arm_model()
    t = DT * np.arange(101)
    tau = held(model.n, 101)
    fmu = exported(model, "arm", fmi)
    cs = columns(simulate(model, fmu, t, joint_inputs(model, "tau", tau), names(model, *STATE)), model, *STATE)
    # a row twice at each time makes a jump of the input, where the importer interpolates
    twice, torque = np.repeat(t, 2)[1:], np.repeat(tau, 2, axis=0)[:-1]
    tolerance = 1e-9
    me = simulate(
        model, fmu, twice, joint_inputs(model, "tau", torque), names(model, *STATE), kind="ModelExchange",
        output_interval=DT, relative_tolerance=tolerance,
    )  # fmt: skip
    rows = [np.flatnonzero(np.abs(me["time"] - x) < 1e-9)[-1] for x in t]
    # the importer's solver bounds the local error; 100 intervals of some steps each add up
    assert np.abs(columns(me, model, *STATE)[rows] - cs).max() < 1e3 * tolerance


@pytest.mark.parametrize(
    ("name", "model"),
    [
        ("effects", arm_model(3, effort="motor_torque", effects=EFFECTS, offset=True)),
        ("swift", swift(arm_model(3, effort="motor_torque", effects=EFFECTS, offset=True))),
        ("cubic", arm_model(3, cubic=0.2)),
        ("arm_coupled", arm_model(coupled=True, offset=True)),
    ],
)
def test_reference_results_hold(exported: Any, name: str, model: Model) -> None:
    """The files inside the FMU are what anyone's importer gets, measured inputs connected; every joint moves in them."""
    fmu = exported(model, name, 3)
    given, wanted = reference_of(fmu)
    assert all(np.ptp(wanted[k]) > 0.02 for k in names(model, "q")), "an arm that stands still shows nothing"
    stems = ("tau", "temp", "q_measured", "dq_measured")
    inputs = {k: given[k] for k in names(model, *stems)} | {"measured": given["measured"] == 1}
    out = simulate(model, fmu, given["time"], inputs, [*names(model, *STATE, *BOUNDS), "verdict", "covered"])
    for k in names(model, *STATE, *BOUNDS):
        assert np.abs(out[k] - wanted[k]).max() < AGREE, k
    assert np.all(out["covered"] == 1)
    assert np.all(out["verdict"] == 1)  # the model's own motion does not refute it


def test_sticking_and_sliding_do_not_depend_on_the_communication_step(exported: Any) -> None:
    model = arm_model(3, effort="motor_torque", effects=EFFECTS, offset=True)
    fmu = exported(model, "effects", 3)
    tau = held(3, 301, seed=1) + np.array([0.0, -8.0, 0.0])
    runs = []
    for split in (1, 10):
        t = DT / split * np.arange(300 * split + 1)
        torque = np.repeat(tau, split, axis=0)[: len(t)]
        out = simulate(model, fmu, t, joint_inputs(model, "tau", torque), names(model, *STATE))
        runs.append(columns(out, model, *STATE)[::split])
    assert np.any(runs[0][5:, 3:] == 0.0)  # some joint rests for a while, exactly
    assert np.abs(runs[0] - runs[1]).max() < AGREE


def test_a_sliding_joint_stops_where_the_closed_form_says(exported: Any) -> None:
    """One joint about the vertical: J ddq = -v dq - F until it rests, at (J/v) ln(1 + v dq0/F)."""
    model = arm_model(1, effort="motor_torque", effects=[friction("coulomb", "axis_1", F_c=3.0)])
    model = replace(model, robot=replace(model.robot, chain=model.robot.chain._replace(gravity=np.zeros(3))))
    J, v, F, dq0 = 1.0 / model.abstraction.Minv[0, 0], model.abstraction.viscous[0, 0], 3.0, 0.8
    t = 0.05 * np.arange(21)
    out = simulate(model, exported(model, "one", 3), t, {}, names(model, *STATE), {"dq_start_axis_1": dq0})
    rest = J / v * np.log(1 + v * dq0 / F)
    dq = np.where(t < rest, (dq0 + F / v) * np.exp(-v / J * t) - F / v, 0.0)
    assert np.abs(out["dq_axis_1"] - dq).max() < AGREE
    assert abs(out["q_axis_1"][-1] - (J / v * dq0 - F / v * rest)) < AGREE


def measured_run(model: Model, fmu: Path, shift: Array, kind: str = "CoSimulation", **start: Any) -> dict[str, Array]:
    """Rest, with a measured position that differs by ``shift`` (rows, n)."""
    t = DT * np.arange(len(shift))
    q, dq = joint_inputs(model, "q_measured", shift), joint_inputs(model, "dq_measured", 0 * shift)
    flags = {"measured": np.ones(len(t), bool)}
    watched = ["verdict", "conformant", "violated_joint", "covered", "age", *names(model, "q")]
    return simulate(model, fmu, t, q | dq | flags, watched, start, kind, output_interval=DT)


def test_a_measurement_outside_names_the_joint_and_stays(exported: Any) -> None:
    """Sets that conform from the start only: there is no other prediction than the unit's own."""
    model = arm_model()
    model = replace(model, sets={"powered": replace(model.powered, windows="start")})
    fmu = exported(model, "from_the_start", 3)
    tube = deviation_tube(model.abstraction, model.powered)
    shift = np.zeros((60, model.n))
    shift[0, 0] = 1e-12  # the prediction begins here; exact zeros are no sample
    shift[1:, 2] = 0.999 * tube.hi[1:60, 2]
    assert np.all(measured_run(model, fmu, shift)["verdict"] == 1)
    shift[20, 2] = 1.001 * tube.hi[20, 2]
    out = measured_run(model, fmu, shift)
    # the sample of row 20 is an input of the step that ends in row 21
    assert np.all(out["verdict"][:21] == 1)
    assert np.all(out["verdict"][21:] == 2)
    assert np.all(out["violated_joint"][21:] == 3)
    assert not np.any(out["conformant"][21:])


@pytest.mark.parametrize(
    ("kind", "unconnected"), [("CoSimulation", 0), ("CoSimulation", 1), ("CoSimulation", 7), ("ModelExchange", 0)]
)
def test_who_connects_a_measured_state_needs_no_start(exported: Any, kind: str, unconnected: int) -> None:
    """The prediction begins at the first sample, wherever `q_start` is; an importer that connects late gives zeros until then."""
    model = arm_model()
    shift = np.full((60, model.n), 0.4)
    shift[:unconnected] = 0.0
    shift[:, 4] += 1.0 * (np.arange(60) >= 40)  # and is refuted by what it does not predict
    out = measured_run(model, exported(model, "arm", 3), shift, kind)
    came = slice(unconnected + 2, 40)
    assert np.all(out["covered"][came] == 1) and np.all(out["verdict"][came] == 1)
    assert abs(out["q_axis_1"][39] - 0.4) < 1e-9
    assert out["verdict"][-1] == 2 and out["violated_joint"][-1] == 5


def test_a_prediction_that_runs_away_is_refuted_by_a_measurement_inside_the_domain(exported: Any) -> None:
    model = arm_model()
    t = DT * np.arange(300)
    tau = {"tau_axis_3": np.full(300, 25.0), "measured": np.ones(300, bool)}
    out = simulate(model, exported(model, "arm", 3), t, tau, ["verdict", "violated_joint", "dq_axis_3"])
    assert out["dq_axis_3"][-1] > model.domain.dq.hi[2]
    assert out["verdict"][-1] == 2
    assert out["violated_joint"][-1] == 3


def test_bounds_of_cubic_friction_are_not_made_up_in_model_exchange(exported: Any) -> None:
    model = arm_model(3, cubic=0.2)
    t = DT * np.arange(11)
    out = simulate(
        model, exported(model, "cubic", 3), t, {}, ["q_lo_axis_1", "covered"], kind="ModelExchange", output_interval=DT
    )  # fmt: skip
    assert np.all(np.isnan(out["q_lo_axis_1"][1:]))
    assert np.all(out["covered"][1:] == 0)


def test_no_verdict_where_the_model_was_not_tested(exported: Any) -> None:
    model = arm_model()
    fmu = exported(model, "arm", 3)
    shift = np.zeros((30, model.n))
    assert np.all(measured_run(model, fmu, shift, temp_axis_1=80.0)["verdict"] == 0)
    assert np.all(measured_run(model, fmu, shift, payload_mass=3.0)["covered"] == 0)
    assert np.all(measured_run(model, fmu, shift, inertia_axis_2=13.0)["covered"] == 0)
    shift[10, 0] = np.nan
    assert measured_run(model, fmu, shift)["verdict"][11] == 0


def test_prediction_ends_at_the_horizon_or_starts_anew(exported: Any) -> None:
    model = arm_model(coupled=True, horizon=0.5)
    fmu = exported(model, "short", 3)
    shift = np.full((120, model.n), 5e-4)
    out = measured_run(model, fmu, shift, restart=False)
    assert np.array_equal(out["covered"] == 1, out["age"] <= 0.5 + 1e-12)
    assert np.all(out["verdict"] == 1), "samples predict each other as in the monitor, however old the unit's own prediction is"
    again = measured_run(model, fmu, shift)
    assert abs(again["age"].max() - 0.5) < 1e-9  # as long as it has bounds
    assert np.all(again["covered"] == 1) and np.all(again["verdict"] == 1)
    assert abs(again["q_axis_1"][-1] - 5e-4) < 1e-4  # it left zero for the measured state


def test_a_payload_moves_the_arm_as_the_rigid_body_says(exported: Any) -> None:
    model = arm_model(coupled=True, offset=True)
    mass, com = 1.5, np.array([0.05, -0.1, 0.2])
    start = {"payload_mass": mass} | {f"payload_com_{a}": x for a, x in zip("xyz", com, strict=True)}
    tau = np.tile(np.linspace(1, 3, model.n), (2, 1))
    out = simulate(
        model, exported(model, "arm_coupled", 3), np.array([0.0, DT]), joint_inputs(model, "tau", tau), names(model, "ddq"), start
    )  # fmt: skip
    r, zero = model.robot, np.zeros(model.n)
    loaded = with_payload(r, mass, com)
    added = mass_matrix(r.chain, loaded.pi, zero) - mass_matrix(r.chain, r.pi, zero)
    M = np.linalg.inv(model.abstraction.Minv) + added
    assert np.abs(columns(out, model, "ddq")[0] - np.linalg.solve(M, tau[0] - model.input.offset)).max() < AGREE


def test_reference_is_the_python_prediction() -> None:
    model = arm_model(horizon=1.0)
    r = reference(model)
    assert np.abs(predict(model.abstraction, DT, r.x[0], r.tau) - r.x).max() < 1e-12
    assert len(r.t) == 101


def test_same_model_same_bytes() -> None:
    model = arm_model()
    assert archive(model, Contents(3, (str(HERE),))) == archive(model, Contents(3, (str(HERE),)))


def test_the_core_is_compiled_once_for_all_models_and_each_part_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And compiled in two places it has the same bytes."""
    here = archive(arm_model(2, horizon=0.1), Contents(3, (str(HERE),), reference=False))
    monkeypatch.setenv("ZIG_GLOBAL_CACHE_DIR", str(cache_folder() / "zig"))  # the compiler's own libraries are not asked about
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    compiled: list[str] = []
    run = build._run
    monkeypatch.setattr(
        build, "_run", lambda words, *rest: (compiled.extend(w for w in words if w.endswith(".c")), run(words, *rest))
    )
    for horizon, core in ((0.1, True), (0.2, False)):
        said: dict[str, float | None] = {}
        compiled.clear()
        there = archive(arm_model(2, horizon=horizon), Contents(3, (str(HERE),), reference=False), said.setdefault)
        assert "model_data.c" in compiled and ("core/rigid.c" in compiled) is core
        assert (there == here) is core
        shares = [share for text, share in said.items() if text.startswith("compiling")]
        assert shares[0] == 0.0 and shares[-1] == 1.0 and shares == sorted(shares)
        # one word for every unit of the core, when it is there; nothing of a core that was there before
        assert len(shares) - 3 == (sum(w.startswith("core/") for w in compiled) if core else 0)


def test_the_core_takes_the_processors_widest_loops_on_linux(exported: Any) -> None:
    """xgetbv, which asks which registers the system saves: without it zig's clones are always the narrow ones, at 1.3 times the cost."""
    if HERE != "x86_64-linux":
        pytest.skip("compiled for this machine alone, which is another")
    with zipfile.ZipFile(exported(arm_model(), "arm")) as z:
        library = next(z.read(n) for n in z.namelist() if n.startswith("binaries/x86_64-linux/"))
    assert b"\x0f\x01\xd0" in library


def test_reference_options_are_plain_numbers() -> None:
    for line in reference_texts(arm_model(2, horizon=0.5)).options.splitlines():
        assert np.isfinite(float(line.split(",")[1]))


DERIVATIVES = [
    ("arm_coupled", arm_model(coupled=True, offset=True)),
    ("effects", arm_model(3, effort="motor_torque", effects=EFFECTS, offset=True)),
]


@pytest.mark.parametrize(("name", "model"), DERIVATIVES)
def test_directional_derivatives_are_those_of_the_model(exported: Any, name: str, model: Model) -> None:
    """Accelerations by torque and, along two directions at once, by what a step of the motion shows; bounds move with the state."""
    n, a = model.n, model.abstraction
    with unit(exported(model, name, 3)) as u:
        u.set(dict(zip(names(model, "dq_start"), (0.3 + 0.1 * np.arange(n)).tolist(), strict=True)))
        u.begin()
        vr = {k: v.valueReference for k, v in u.variables.items()}
        ddq, tau, dq, q = ([vr[k] for k in names(model, s)] for s in ("ddq", "tau", "dq", "q"))
        seed = np.linspace(1.0, -2.0, n)
        got = u.slave.getDirectionalDerivative(ddq, tau, seed.tolist())
        assert np.abs(np.array(got) - a.Minv @ seed).max() < 1e-8
        if a.linear and model.effort == "compensated_torque":
            got = u.slave.getDirectionalDerivative(ddq, dq, seed.tolist())
            assert np.abs(np.array(got) + a.Minv @ (a.viscous[:, 0] * seed)).max() < 1e-8
        got = u.slave.getDirectionalDerivative([vr["q_lo_axis_1"], vr["q_hi_axis_2"], *dq], q, seed.tolist())
        assert np.abs(np.array(got) - [seed[0], seed[1], *np.zeros(n)]).max() < 1e-8
        got = u.slave.getDirectionalDerivative(ddq, [*q, *dq], [*seed.tolist(), *seed.tolist()])
        before, x = u.joints("ddq", model.joints), 1e-4
        with unit(exported(model, name, 3)) as v:
            start = np.concatenate([x * seed, 0.3 + 0.1 * np.arange(n) + x * seed])
            v.set(dict(zip(names(model, "q_start", "dq_start"), start.tolist(), strict=True)))
            v.begin()
            assert np.abs((v.joints("ddq", model.joints) - before) / x - got).max() < 0.02 * np.abs(got).max()
        tau_array, one_by_one = (
            u.variables["tau"].valueReference,
            [u.slave.getDirectionalDerivative(ddq, [x], [1.0]) for x in tau],
        )
        for knowns in (tau, [tau_array]):  # the transpose, knowns in an array too
            adjoint = u.slave.getAdjointDerivative(ddq, knowns, seed.tolist(), n)
            assert np.abs(np.array(adjoint) - np.array(one_by_one) @ seed).max() < 1e-12
        for wrong in (([vr["tcp_stop_distance"]], tau[:1]), (ddq[:1], [vr["payload_mass"]])):
            with pytest.raises(Exception, match="AdjointDerivative"):
                u.slave.getAdjointDerivative(*wrong, [1.0])
            with pytest.raises(Exception, match="DirectionalDerivative"):
                u.slave.getDirectionalDerivative(*wrong, [1.0])


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_unit_is_checked_against_what_it_was_where_it_was_exported(
    exported: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str], fmi: int
) -> None:
    model = arm_model(3, effort="motor_torque", effects=EFFECTS[:2], offset=True)
    fmu = exported(model, "checked", fmi)
    checked = check_fmu(fmu)
    assert checked.good and checked.rows == 201 and max(checked.differences.values()) < AGREE
    assert main(["check-fmu", str(fmu), "--json", str(tmp_path / "a.json")]) == 0
    assert "is what it was" in capsys.readouterr().out
    assert json.loads((tmp_path / "a.json").read_text())["good"] is True
    other = tmp_path / "other.fmu"

    def by_a_hair(name: str, text: bytes) -> bytes:
        """A reference, as a wrong library would be seen."""
        if not name.endswith("_ref.csv"):
            return text
        rows = text.decode().splitlines()
        cells = rows[50].split(",")
        cells[1] = repr(float(cells[1]) + 2e-9)
        return "\n".join([*rows[:50], ",".join(cells), *rows[51:]]).encode()

    rewritten(fmu, other, by_a_hair)
    assert main(["check-fmu", str(other)]) == 1
    said = capsys.readouterr().out
    assert "NOT" in said and "differs from the reference by 2.0e-09" in said
    # a number that no run looks at
    rewritten(fmu, other, lambda name, text: text.replace(b"stopset", b"stopsat") if name == "sources/model_data.c" else text)
    assert main(["check-fmu", str(other)]) == 1
    assert "sources/model_data.c is not the file of the export" in capsys.readouterr().out
    rewritten(fmu, other, lambda name, text: None if name == SUMS else text)
    assert main(["check-fmu", str(other)]) == 1
    assert f"{SUMS} is missing" in capsys.readouterr().out
    plain, table = tmp_path / "plain.fmu", tmp_path / "table.fmu"
    plain.write_bytes(archive(model, Contents(fmi, source_only=True)))
    rewritten(fmu, table, lambda name, text: b"0 0" if name.endswith("_ref.csv") else text)
    for path, says in (
        (table, "_ref.csv is no table of numbers"),
        (tmp_path / "none.fmu", "none.fmu"),
        (Path(__file__), "expected an FMU"),
        (plain, "no library for this machine"),
    ):
        assert main(["check-fmu", str(path)]) == 2
        said = capsys.readouterr().err
        assert says in said and said.count("\n") == 1


def rewritten(fmu: Path, to: Path, change: Callable[[str, bytes], bytes | None]) -> None:
    """A unit whose files are others, or missing."""
    with zipfile.ZipFile(fmu) as old, zipfile.ZipFile(to, "w") as new:
        for name in old.namelist():
            if (text := change(name, old.read(name))) is not None:
                new.writestr(name, text)


def test_a_library_that_is_not_the_export_s_is_not_run(exported: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Half a library ends the process that loads it; nor is one run before the key that must have signed it is known to have."""
    fmu, other = exported(arm_model(2, effort="motor_torque"), "half", 3), tmp_path / "half.fmu"
    rewritten(fmu, other, lambda name, text: text[:3000] if name.startswith("binaries/") else text)
    checked = check_fmu(other)
    assert not checked.good and checked.rows == checked.stops == 0 and not checked.differences
    assert main(["check-fmu", str(other)]) == 1
    said = capsys.readouterr().out
    assert "is not the file of the export" in said and "nothing of it was run" in said and "do not use it" in said
    unsigned = check_fmu(fmu, trusted=False)
    assert not unsigned.good and unsigned.rows == 0
