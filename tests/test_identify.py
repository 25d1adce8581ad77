"""Identification on arms that are known: the truth comes back inside the sets, on odd data too."""

from __future__ import annotations

import dataclasses
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nominal_cases import F_C, F_V, JOINTS, Truth, moving
from nominal_cases import arm as three_joints
from stopset.cli.main import main
from stopset.effects.base import Fitted
from stopset.errors import EffectError
from stopset.offline.abstraction import build
from stopset.offline.abstraction import order_selection as order
from stopset.offline.abstraction.metrics import torque_error
from stopset.offline.abstraction.nominal_part import NominalPart, fit_nominal
from stopset.offline.abstraction.order_selection import abstracted
from stopset.offline.campaign.run import Run
from stopset.offline.campaign.survey import on_grid, survey
from stopset.offline.compare.compare import answer, compare
from stopset.offline.conform.guarantee import scenario_bound
from stopset.offline.identify.pipeline import Identification, Settings, identify
from stopset.reach.nonlinear import nominal
from stopset.recording import Meta, Recording
from synthetic import DT, arm, columns, meta, names, recordings, save, save_trials, urdf
from test_abstraction import ROTOR, VISCOUS, two_link

J7, V7 = (3.0, 2.5, 2.0, 1.5, 0.6, 0.4, 0.2), (12.0, 11.0, 9.0, 7.0, 4.0, 3.0, 1.5)


def found(folder: Path, trials: list[Recording], settings: Settings | None = None, **more: object) -> Identification:
    joints = names(trials[0].q.shape[1])
    path = save_trials(folder / "rec.parquet", trials, joints, **more)
    return identify(arm(joints), [path], settings)


def enclosed(result: Identification, folder: Path) -> bool:
    return not compare(result.model, [folder / "rec.parquet"]).violations


@pytest.mark.parametrize("n", [1, 2, 7])
def test_the_truth_comes_back_for_arms_of_any_size(n: int, tmp_path: Path) -> None:
    trials = recordings(J7[:n], V7[:n], suites=3, trials=6, seconds=1.6, bias=0.3, spread=0.2)
    result = found(tmp_path, trials)
    m = result.model
    inertia, damping = 1 / np.diag(m.abstraction.Minv), m.abstraction.viscous[:, 0]
    np.testing.assert_allclose(inertia, J7[:n], rtol=0.08)
    np.testing.assert_allclose(damping, V7[:n], rtol=0.08)
    np.testing.assert_allclose(m.abstraction.offset, -0.3, atol=0.1)  # taken off the torque: the bias pushes
    # the hidden torque is +-0.2 about the offset; noise and the fit's own error come on top
    assert np.all(m.powered.U.width < 1.2)
    assert np.all(m.powered.U.width > 0.05)
    assert enclosed(result, tmp_path)


def test_a_torque_that_identification_never_saw_leaves_the_sets(tmp_path: Path, planar) -> None:
    _, trials, result = planar
    pushed = [dataclasses.replace(r, tau=r.tau + np.array([0.0, 3.0])) for r in trials]
    path = save_trials(tmp_path / "pushed.parquet", pushed, names(2))
    comparison = compare(result.model, [path])
    assert len(comparison.violations) == len(trials)
    assert {v.state for v in comparison.violations} <= {"q_axis_2", "dq_axis_2"}
    assert {v.side for v in comparison.violations} == {"below"}  # torque that did not move the arm


@pytest.mark.parametrize("conform", ["all", "position"])
@pytest.mark.parametrize("windows", ["sliding", "start"])
def test_every_case_encloses_what_it_promises(conform: str, windows: str, tmp_path: Path) -> None:
    trials = recordings((2.0, 0.7), (9.0, 4.0), trials=3)
    result = found(tmp_path, trials, Settings(conform=conform, windows=windows, margin=1.0))
    assert result.model.powered.conform == conform
    assert enclosed(result, tmp_path)


def test_position_only_sets_report_a_violation_of_position(tmp_path: Path) -> None:
    trials = recordings((2.0, 0.7), (9.0, 4.0), trials=3)
    result = found(tmp_path, trials, Settings(conform="position"))
    pushed = [dataclasses.replace(r, tau=r.tau + np.array([0.0, 3.0])) for r in trials]
    comparison = compare(result.model, [save_trials(tmp_path / "pushed.parquet", pushed, names(2))])
    assert {v.state for v in comparison.violations} == {"q_axis_2"}
    assert all(np.isfinite(v.excess) and v.excess > 0 for v in comparison.violations)
    assert answer(result.model, comparison)["violations"] == len(trials)


def test_one_trial(tmp_path: Path) -> None:
    result = found(tmp_path, recordings((2.0,), (4.0,), suites=1, trials=1))
    assert enclosed(result, tmp_path)
    assert result.model.guarantee.motions == 0
    assert "nothing statistical" in result.model.guarantee.text


def test_trials_of_different_length(tmp_path: Path) -> None:
    trials = [r.cut(0, len(r.t) - 31 * (k % 4)) for k, r in enumerate(recordings((2.0, 0.7), (9.0, 4.0), trials=4))]
    result = found(tmp_path, trials)
    assert enclosed(result, tmp_path)
    assert result.model.powered.horizon == pytest.approx(1.0)


def test_a_trial_of_two_samples_is_left_out_not_an_error(tmp_path: Path) -> None:
    trials = recordings((2.0, 0.7), (9.0, 4.0), trials=3)
    trials[1] = trials[1].cut(0, 2)
    assert enclosed(found(tmp_path, trials), tmp_path)


def test_irregular_clock(tmp_path: Path) -> None:
    rng = np.random.default_rng(9)
    out = []
    for r in recordings((2.0, 0.7), (9.0, 4.0), trials=4, dt=0.001):
        keep = np.unique(np.clip(np.cumsum(rng.integers(3, 6, len(r.t))), 0, len(r.t) - 1))
        out.append(dataclasses.replace(r, t=r.t[keep], q=r.q[keep], dq=r.dq[keep], tau=r.tau[keep]))
    result = found(tmp_path, out)
    assert result.survey.irregular
    assert result.model.provenance["clock"] == "resampled to the grid"
    again = result.model.provenance["description_read_again"]  # by another library, where it is installed
    assert again is None or (again["states"] >= 50 and again["largest_Nm"] < 1e-9)
    assert enclosed(result, tmp_path)
    np.testing.assert_allclose(1 / np.diag(result.model.abstraction.Minv), (2.0, 0.7), rtol=0.15)


def test_trials_of_different_rates(tmp_path: Path) -> None:
    slow = recordings((2.0,), (4.0,), suites=1, trials=3, dt=DT)
    fast = [
        dataclasses.replace(r, suite=1, place=r.place + 3)
        for r in recordings((2.0,), (4.0,), suites=1, trials=2, dt=DT / 4, seconds=0.3, seed=2)
    ]
    tiny = [dataclasses.replace(fast[0].cut(0, 3), trial=9)]  # three samples within one step of the grid
    assert enclosed(found(tmp_path, [*slow, *fast, *tiny]), tmp_path)


def still(N: int = 200, n: int = 1, noise: float = 0.0) -> list[Recording]:
    rng = np.random.default_rng(2)
    zero = np.zeros((N, n))
    return [
        Recording(
            "open_loop", 0, k, k, DT * np.arange(N), zero + 0.4 + noise * rng.normal(size=zero.shape), zero.copy(), zero.copy()
        )
        for k in range(3)
    ]


def test_a_constant_signal_is_under_determined_not_an_error(tmp_path: Path) -> None:
    result = found(tmp_path, still())
    assert enclosed(result, tmp_path)
    assert np.all(np.isfinite(result.model.powered.U.width))


def test_an_arm_of_which_one_joint_stands_still(tmp_path: Path) -> None:
    trials = recordings((2.0, 0.7), (9.0, 4.0), trials=3)
    stuck = []
    for r in trials:
        q, dq, tau = r.q.copy(), r.dq.copy(), r.tau.copy()
        q[:, 1], dq[:, 1], tau[:, 1] = 0.2, 0.0, 0.0
        stuck.append(dataclasses.replace(r, q=q, dq=dq, tau=tau))
    result = found(tmp_path, stuck)
    assert enclosed(result, tmp_path)
    np.testing.assert_allclose(1 / result.model.abstraction.Minv[0, 0], 2.0, rtol=0.1)


def test_a_joint_held_by_stiction_keeps_the_inertia_of_the_description(tmp_path: Path) -> None:
    """Torque that moves nothing fits an infinite inertia: sets of any width would then enclose it, and nothing else."""
    trials = recordings((2.0, 0.7), (9.0, 4.0), trials=6)
    stuck = []
    for r in trials:
        q, dq, tau = r.q.copy(), r.dq.copy(), 0.3 * r.tau
        q[:, 1], dq[:, 1] = 0.2 + 1e-3 * tau[:, 1], np.gradient(1e-3 * tau[:, 1], DT)
        stuck.append(dataclasses.replace(r, q=q, dq=dq, tau=np.column_stack([r.tau[:, 0], tau[:, 1]])))
    result = found(tmp_path, stuck)
    assert enclosed(result, tmp_path)
    described = 2 * 0.15**2 + 0.02
    inertia = 1 / np.diag(result.model.abstraction.Minv)
    assert described / 3 < inertia[1] < 3 * described
    assert result.model.powered.U.width[1] < 1.5 * np.ptp([r.tau[:, 1] for r in stuck])
    assert any("undetermined" in note and "axis_2" in note for note in result.model.notes)
    np.testing.assert_allclose(inertia[0], 2.0, rtol=0.1)


def test_a_stuck_signal_in_one_trial(tmp_path: Path) -> None:
    """A frozen encoder under full torque: conformant sets become wide and say which trial made them so."""
    trials = recordings((2.0, 0.7), (9.0, 4.0), trials=4)
    q, dq = trials[2].q.copy(), trials[2].dq.copy()
    q[:, 1], dq[:, 1] = q[0, 1], 0.0
    trials[2] = dataclasses.replace(trials[2], q=q, dq=dq)
    result = found(tmp_path, trials, Settings(margin=1.0))
    assert enclosed(result, tmp_path)
    named = [a.recording for a in result.model.powered.active if a.bound.startswith("U[axis_2]")]
    assert "open_loop suite 0 trial 2" in named


def test_other_order_of_joints_and_strangers_change_nothing(tmp_path: Path, planar) -> None:
    _, trials, result = planar
    joints = names(2)
    table = columns(trials, joints)
    for name in ("q", "dq", "tau"):
        table[f"{name}_rail"] = np.zeros(len(table["t"]))
    path = save(tmp_path / "a.parquet", dict(reversed(table.items())), meta(("rail", *reversed(joints))))
    again = identify(arm(joints), [path])
    np.testing.assert_array_equal(again.model.powered.U.hi, result.model.powered.U.hi)
    np.testing.assert_array_equal(again.model.abstraction.Minv, result.model.abstraction.Minv)


def test_two_files_give_what_one_gives(tmp_path: Path, planar) -> None:
    _, trials, result = planar
    joints = names(2)
    a = save_trials(tmp_path / "a.parquet", trials[:4], joints)
    b = save_trials(tmp_path / "b.parquet", trials[4:], joints)
    again = identify(arm(joints), [a, b])
    np.testing.assert_array_equal(again.model.powered.U.hi, result.model.powered.U.hi)
    assert set(again.model.provenance["data"]) == {"a.parquet", "b.parquet"}


def test_suites_of_two_files_with_the_same_number_are_two_motions(tmp_path: Path) -> None:
    """Every recorder counts its suites from zero: another file's suite 0 is another motion unless its torques say so."""
    joints = names(1)
    one = recordings((2.0,), (4.0,), suites=1, trials=3, seed=1)
    two = recordings((2.0,), (4.0,), suites=1, trials=3, seed=2)
    a, b = save_trials(tmp_path / "a.parquet", one, joints), save_trials(tmp_path / "b.parquet", two, joints)
    assert identify(arm(joints), [a, b]).model.provenance["motions"] == 2
    again = save_trials(tmp_path / "again.parquet", one[:2], joints)
    assert identify(arm(joints), [a, again]).model.provenance["motions"] == 1


def test_the_order_of_trials_does_not_matter_for_the_sets(tmp_path: Path) -> None:
    trials = recordings((2.0,), (4.0,), suites=2, trials=4)
    a = found(tmp_path, trials, Settings(margin=1.0)).model
    b = found(tmp_path, [*trials[4:][::-1], *trials[:4][::-1]], Settings(margin=1.0)).model
    np.testing.assert_allclose(a.powered.U.width, b.powered.U.width, rtol=1e-3)


def test_held_out_motions_shape_neither_the_nominal_model_nor_the_noise(tmp_path: Path) -> None:
    """Else the count of violations among them would prove nothing."""
    trials = recordings((2.0,), (4.0,), suites=8, trials=2, seconds=0.6)
    a = found(tmp_path, trials)
    held = {suite for _, _, suite, _ in a.survey.held_out}
    assert len(held) == 2
    rng = np.random.default_rng(0)
    spoiled = [
        dataclasses.replace(r, q=r.q + 1e-3 * rng.normal(size=r.q.shape), dq=1.5 * r.dq) if r.suite in held else r for r in trials
    ]
    b = found(tmp_path, spoiled)
    np.testing.assert_array_equal(a.model.abstraction.Minv, b.model.abstraction.Minv)
    np.testing.assert_array_equal(a.model.abstraction.viscous, b.model.abstraction.viscous)
    np.testing.assert_array_equal(a.survey.readings.least.hi, b.survey.readings.least.hi)
    np.testing.assert_array_equal(a.survey.readings.most.hi, b.survey.readings.most.hi)
    assert b.model.guarantee.violated == 2
    assert b.model.guarantee.upper_bound == 1.0
    assert enclosed(b, tmp_path)  # and yet everything recorded is inside


def test_scenario_bound_holds_for_the_number_of_motions_seen_to_matter() -> None:
    """Interval of N uniform numbers: two of them fix it; the mass outside exceeds the bound in less than 5 % of cases."""
    rng = np.random.default_rng(0)
    N = 40
    bound = scenario_bound(2, N)
    assert bound is not None
    x = rng.uniform(size=(20_000, N))
    outside = 1.0 - np.ptp(x, axis=1)
    assert np.mean(outside > bound) <= 0.05
    assert np.mean(outside > bound / 3) > 0.05  # and it says something
    assert scenario_bound(5, 5) is None
    assert scenario_bound(12, N) > scenario_bound(2, N)


@pytest.mark.parametrize("motions", [2, 12])
def test_the_guarantee_counts_motions(motions: int, tmp_path: Path) -> None:
    g = found(tmp_path, recordings((2.0,), (4.0,), suites=motions, trials=2, seconds=0.6)).model.guarantee
    if motions == 2:
        assert (g.motions, g.upper_bound) == (0, 1.0)
        return
    assert (g.motions, g.calibration_motions) == (3, 9)
    expected = 0.95 if g.violated == 0 else None
    assert expected is None or (1 - g.upper_bound) ** 3 == pytest.approx(1 - expected)
    assert f"Of 3 held-out motions {g.violated} left" in g.text


@pytest.mark.parametrize("kind", [1, 2, 3])
def test_torque_error_of_a_model_on_its_own_motion_is_zero(kind: int) -> None:
    """Coriolis torques are part of models 2 and 3: left out, they would count as a lack of the model."""
    a, h = build(kind, 5, two_link(), ROTOR, VISCOUS[:, :1]), 0.001
    t = h * np.arange(1200)
    u = np.column_stack([8 * np.cos(4 * t), 6 * np.sin(5 * t + 0.3)])
    x = nominal(a, np.array([[0.2, -0.5, 0.8, -1.0]]), u[None], h)[0]
    q, dq = x[: len(u), :2], x[: len(u), 2:]
    e = np.abs(torque_error(a, h, q, dq, u)).max(axis=0)
    # inputs are held over each step and torques summed at its left end: an error of first order in the step
    step = np.abs(np.diff(a.ddq(q, dq, u), axis=0)).max(axis=0) @ np.abs(np.linalg.inv(a.Minv))
    assert np.all(e < step)
    if kind == 2:
        bare = np.abs(torque_error(replace(a, coriolis=(), kind=1), h, q, dq, u)).max(axis=0)
        assert bare[0] > 3 * step[0]


def test_a_clock_four_percent_off_is_put_on_the_grid() -> None:
    """Its stamps are even, but taken for the grid its speed would not be the derivative of its position."""
    t = 1.04 * DT * np.arange(300)
    q = np.sin(2 * t)[:, None]
    r = on_grid(Recording("open_loop", 0, 0, 0, t, q, 2 * np.cos(2 * t)[:, None], 0 * q), DT)
    np.testing.assert_allclose(np.diff(r.t), DT, rtol=1e-9)
    np.testing.assert_allclose(r.q[:, 0], np.sin(2 * r.t), atol=4 * (1.04 * DT) ** 2 / 8)  # curvature between samples
    exact = dataclasses.replace(r, t=DT * np.arange(len(r.t)))
    assert on_grid(exact, DT) is exact


def bent(trials: int, v3: np.ndarray) -> list[Recording]:
    """Motions of the three-joint arm whose friction flattens by ``v3`` dq^3."""
    law = lambda dq, load: F_C * np.sign(dq) + F_V * dq + v3 * dq**3  # noqa: E731
    truth = Truth(three_joints(), friction=law)
    return [moving(truth, k, 4.0, 1.2, 3) for k in range(trials)]


@pytest.mark.parametrize(("v3", "best"), [((6.0, 8.0, 4.0), 3), ((-2.5, -3.5, -2.0), 1)])
def test_the_order_is_that_which_predicts_motions_left_out_of_the_fit(v3: tuple[float, ...], best: int) -> None:
    """Friction that stiffens belongs into the model; one that flattens lets predictions drift, and is better taken off the input."""
    trials, robot = bent(6, np.array(v3)), three_joints()
    head = Meta(joints=JOINTS, robot="three")
    found = survey(lambda: trials)
    settings = Settings(effects=("cubic_viscous",), friction="plain")
    run = Run(robot, head, lambda: trials, found, settings)
    part = fit_nominal(run)
    values = [f.values["v_3"] for f in part.effects if f.effect == "cubic_viscous"]
    np.testing.assert_allclose(values, v3, rtol=0.1)  # at every joint, since none was named
    out = abstracted(run, (), part)
    assert out.abstraction.kind == 1 and out.abstraction.order == best
    assert "held out of the fit" in out.notes[-1] and "order 1:" in out.notes[-1] and "order 3:" in out.notes[-1]
    linear = abstracted(replace(run, settings=replace(settings, order=1)), (), part)
    assert linear.abstraction.linear  # what is asked for is done
    plainly = replace(run, settings=Settings(friction="plain"))
    plain = fit_nominal(plainly)
    assert abstracted(plainly, (), plain) is plain
    # what judges is never what was fitted
    seen: list[tuple[str, int]] = []

    def fitted(half: Run, known: tuple[Fitted, ...]) -> NominalPart:
        seen.extend(r.suite_key for r in half.trials())
        return fit_nominal(half, known)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(order, "fit_nominal", fitted)
        abstracted(run, (), part)
    held = order._half(found)
    assert held is not None
    assert 0 < len(seen) < len(trials) and not any(held(r) for r in trials if r.suite_key in seen)


def test_friction_that_the_motions_do_not_show_is_refused() -> None:
    trials, robot = bent(3, np.zeros(3)), three_joints()
    with pytest.raises(EffectError, match="no trace"):
        fit_nominal(
            Run(robot, Meta(joints=JOINTS), lambda: trials, survey(lambda: trials), Settings(effects=("load_coulomb:base",)))
        )


def test_answer_and_page_are_of_one_comparison(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Comparing reads every recording again: once is enough for both."""
    module = sys.modules[compare.__module__]
    counted: list[object] = []

    def counting(*args: object) -> object:
        counted.append(args)
        return compare(*args)  # type: ignore[arg-type]

    monkeypatch.setattr(module, "compare", counting)
    data = save_trials(tmp_path / "rec.parquet", recordings((2.0,), (4.0,), suites=2, trials=2), names(1))
    (tmp_path / "robot.urdf").write_text(urdf(names(1)))
    words = ["--robot", str(tmp_path / "robot.urdf"), "--data", str(data), "--out", str(tmp_path / "m.json")]
    assert main(["identify", *words, "--json", str(tmp_path / "a.json"), "--report", str(tmp_path / "a.html")]) == 0
    assert len(counted) == 1 and (tmp_path / "a.json").exists() and (tmp_path / "a.html").exists()
