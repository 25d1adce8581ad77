"""Compare: what it calls a violation is one, where and when it says; its files can be read anywhere."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest

from stopset.artifact import load_model
from stopset.cli.main import main
from stopset.errors import RecordingError
from stopset.offline.compare.compare import answer, compare
from stopset.offline.compare.dependence import Explained, partial_residual, strongest_first
from stopset.offline.compare.verdict import verdict
from stopset.reach.flowpipe import deviation_tube
from stopset.reach.predict import predict
from stopset.recording import Meta, read_recordings, write_recordings
from synthetic import names, recordings, save_trials

JOINTS = names(2)


def test_the_worst_excess_is_the_one_found_by_brute_force(planar, tmp_path: Path) -> None:
    _, trials, found = planar
    model = found.model
    pushed = dataclasses.replace(trials[3], tau=trials[3].tau + np.array([0.0, 1.5]))
    (violation,) = compare(model, [save_trials(tmp_path / "a.parquet", [pushed], JOINTS)]).violations
    tube = deviation_tube(model.abstraction, model.powered)
    half = 0.5 * (tube.hi - tube.lo)
    u = model.input(pushed.q, pushed.dq, pushed.tau)
    x = np.hstack([pushed.q, pushed.dq])
    worst, where = 0.0, (0, 0, 0)
    for s in range(len(x) - 1):
        e = (x[s:] - predict(model.abstraction, model.powered.dt, x[s], u[s:]))[: len(tube.ages)]
        excess = np.maximum(e - tube.hi[: len(e)], tube.lo[: len(e)] - e)[1:] / half[1 : len(e)]
        if excess.size and excess.max() > worst:
            worst = float(excess.max())
            age, state = np.unravel_index(int(excess.argmax()), excess.shape)
            where = (s, int(age) + 1, int(state))
    assert violation.relative == pytest.approx(worst, rel=1e-6)
    assert violation.start_s == pytest.approx(where[0] * model.powered.dt)
    assert violation.age_s == pytest.approx(where[1] * model.powered.dt)
    assert violation.state == [f"{s}_{j}" for s in ("q", "dq") for j in JOINTS][where[2]]


def test_a_file_given_twice_is_not_compared_twice(planar, tmp_path: Path) -> None:
    _, trials, found = planar
    a = save_trials(tmp_path / "a.parquet", trials[:2], JOINTS)
    with pytest.raises(RecordingError, match="the same recording, byte for byte"):
        compare(found.model, [a, a])


def test_readings_that_are_none_are_not_held_against_the_model(
    planar, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, trials, found = planar
    q = trials[3].q.copy()
    q[40, 1] += 1.0
    data = save_trials(tmp_path / "a.parquet", [dataclasses.replace(trials[3], q=q)], JOINTS)
    seen = compare(found.model, [data])
    said = verdict(seen)
    assert seen.violations and said.text.startswith(f"Not comparable: {JOINTS[1]}: q jumps by 1 rad at {trials[3].t[40]:.4g} s")
    assert "diagnose" not in said.next and not compare(found.model, [folder / "rec.parquet"]).unsound
    assert main(["compare", str(folder / "m.model.json"), "--data", str(data), "--quiet"]) == 1
    assert "mend the recordings first" in capsys.readouterr().out


def test_open_loop_errors_are_those_of_the_prediction(planar) -> None:
    folder, trials, found = planar
    figures = compare(found.model, [folder / "rec.parquet"]).figures
    m = found.model
    errors = [
        np.hstack([r.q, r.dq])
        - predict(m.abstraction, m.powered.dt, np.concatenate([r.q[0], r.dq[0]]), m.input(r.q, r.dq, r.tau))
        for r in trials
    ]
    e = np.vstack(errors)
    repeated: dict[int, list[np.ndarray]] = {}
    for r, own in zip(trials, errors, strict=True):
        repeated.setdefault(r.suite, []).append(own[:: round(0.2 / m.powered.dt), :2])
    away = [x - np.mean(of, axis=0) for of in repeated.values() if len(of) > 1 for x in of]
    free = sum((len(of) - 1) * len(of[0]) for of in repeated.values())
    for k, j in enumerate(JOINTS):
        assert figures[j]["position_rmse"] == pytest.approx(np.sqrt(np.mean(e[:, k] ** 2)), rel=1e-6)
        assert figures[j]["velocity_rmse"] == pytest.approx(np.sqrt(np.mean(e[:, 2 + k] ** 2)), rel=1e-6)
        scatter = np.sqrt(sum((x[:, k] ** 2).sum() for x in away) / free)
        assert figures[j]["position_rmse_floor"] == pytest.approx(scatter, rel=1e-6)
        # the hidden torque is +-0.2 N m in steps of 40 ms, averaged over 0.2 s: 0.2 / sqrt(3) / sqrt(5)
        assert figures[j]["torque_rmse"] == pytest.approx(0.052, rel=0.3)


def test_the_partial_residual_shows_each_law_where_two_variables_move_together() -> None:
    """The plain error over the one variable has the other one's slope mixed in; the partial residual has its own."""
    rng = np.random.default_rng(0)
    a = rng.uniform(-1, 1, 6000)
    b = 0.6 * a + 0.8 * rng.uniform(-1, 1, 6000)
    error = 2.0 * a - 1.0 * b + rng.normal(0, 0.05, 6000)
    found = Explained(("a", "b"), np.array([[0.8, 0.1]]), error[:, None], (a[:, None], b[:, None]), (False, False))
    p = partial_residual(found, 0)
    assert (p.variable, p.other) == ("a", "b")
    slope = np.polyfit(p.line[:, 0], p.line[:, 1], 1)[0]
    plain = np.polyfit(a, error, 1)[0]
    # within twelfths the other variable still varies a little: a few hundredths of its slope
    assert slope == pytest.approx(2.0, abs=0.1) and abs(plain - 2.0) > 0.5


def test_a_joints_own_variable_is_named_where_others_do_as_well() -> None:
    """Joints that move together explain each other: another one's angle is named only where it is clearly better; no column twice."""
    names = ("q", "dq", "q of axis_1", "q of axis_2")
    share = np.array([[0.70, 0.1, 0.0, 0.72], [0.10, 0.1, 0.60, 0.0]])
    found = Explained(names, share, np.zeros((1, 2)), (), (False, False, True, True))
    assert names[found.strongest(0)] == "q", "0.72 is no more than 0.70"
    assert names[found.strongest(1)] == "q of axis_1", "0.6 is more than 0.1"
    assert [names[k] for k in strongest_first(found)][:2] == ["q", "q of axis_2"]
    twice = Explained((*names, "time"), np.hstack([share, share[:, :1]]), np.zeros((1, 2)), (), (*found.foreign, False))
    assert [twice.variables[k] for k in strongest_first(twice)].count("time") == 0


def test_command_answers_with_exit_codes_json_and_page(planar, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, trials, _ = planar
    out = ["--json", str(tmp_path / "a.json"), "--report", str(tmp_path / "a.html")]
    assert main(["compare", str(folder / "m.model.json"), "--data", str(folder / "rec.parquet"), *out]) == 0
    body = json.loads((tmp_path / "a.json").read_text(), parse_constant=lambda c: pytest.fail(f"{c} is no JSON"))
    assert body["violations"] == 0
    assert body["recordings"] == len(trials)
    assert set(body["joints"]) == set(JOINTS)
    assert {"torque_rmse", "torque_rmse_floor", "velocity_rmse", "position_rmse"} <= set(body["joints"][JOINTS[0]])
    assert {"U", "X0_q", "X0_dq"} <= set(body["sets"][JOINTS[0]])
    assert {"motions", "violated", "upper_bound", "confidence"} <= set(body["guarantee"])
    page = (tmp_path / "a.html").read_text()
    # self-contained: no script, style, font or picture from elsewhere
    assert not re.search(r"""<(?:script|link|img|iframe)[^>]+(?:src|href)\s*=\s*["'](?:https?:)?//""", page)
    assert "recordings stay inside the predicted sets" in page
    assert "not a" in page
    pushed = [dataclasses.replace(r, tau=1.5 * r.tau) for r in trials]
    bad = save_trials(tmp_path / "bad.parquet", pushed, JOINTS)
    assert main(["compare", str(folder / "m.model.json"), "--data", str(bad)]) == 1
    said = capsys.readouterr().out
    assert "violation: open_loop suite" in said
    assert load_model(folder / "m.model.json").sha256


def test_a_stretch_shorter_than_what_is_averaged_over_is_compared_like_any(
    planar, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What a monitor wrote on a starved machine breaks into such stretches."""
    folder, (first, *_), _ = planar
    cut = {name: getattr(first, name)[:9] for name in ("t", "q", "dq", "tau")}
    short = dataclasses.replace(first, suite=99, begun=99, **cut)
    data = save_trials(tmp_path / "short.parquet", [first, short], JOINTS)
    out = ["--json", str(tmp_path / "a.json"), "--report", str(tmp_path / "a.html"), "--mcap", str(tmp_path / "a.mcap")]
    assert main(["compare", str(folder / "m.model.json"), "--data", str(data), *out]) == 0
    assert json.loads((tmp_path / "a.json").read_text())["recordings"] == 2
    alone = save_trials(tmp_path / "alone.parquet", [short], JOINTS)
    assert main(["compare", str(folder / "m.model.json"), "--data", str(alone), "--report", str(tmp_path / "b.html")]) == 2
    assert "expected one of more than 0.2 s" in capsys.readouterr().err and not (tmp_path / "b.html").exists()


def test_data_without_a_powered_phase_are_refused(planar, tmp_path: Path) -> None:
    _, trials, found = planar
    still = [dataclasses.replace(r, phase="static") for r in trials]
    with pytest.raises(RecordingError, match="static"):
        compare(found.model, [save_trials(tmp_path / "a.parquet", still, JOINTS)])


def test_another_sampling_rate_is_brought_to_the_models_grid(planar, tmp_path: Path) -> None:
    """The same arm recorded four times as fast: its tube still holds (reading noise is the same)."""
    _, _, found = planar
    fast = recordings((2.0, 0.7), (9.0, 4.0), dt=0.001, seed=1, spread=0.1)
    result = compare(found.model, [save_trials(tmp_path / "a.parquet", fast, JOINTS)])
    assert len(result.rows) == len(fast)
    assert np.all(np.isfinite([r.torque_rms for r in result.rows]))


@pytest.mark.shared
@pytest.mark.parametrize(("joint", "factor", "least"), [(0, 1.5, 30), (1, 2.2, 1), (2, 1.5, 50), (4, 1.5, 30)])
def test_one_joints_torque_off_by_half_is_found_on_the_real_arm(
    schunk, schunk_file, tmp_path: Path, joint: int, factor: float, least: int
) -> None:
    """But for joint 2: it brakes harder than its friction at the end of some trials, and that is in its unknown torque."""
    data = read_recordings(schunk_file)
    scaled = [dataclasses.replace(r, tau=r.tau * np.where(np.arange(6) == joint, factor, 1.0)) for r in data]
    write_recordings(tmp_path / "scaled.parquet", Meta(data.meta.joints, effort="compensated_torque"), scaled)
    result = compare(schunk.model, [tmp_path / "scaled.parquet"])
    assert len(result.violations) >= least
    assert {v.state.removeprefix("d") for v in result.violations} == {f"q_arm_{joint + 1}_joint"}
    assert answer(schunk.model, result)["violations"] == len(result.violations)


@pytest.mark.shared
def test_the_real_recordings_conform_to_their_own_model(schunk, schunk_file) -> None:
    result = compare(schunk.model, [schunk_file])
    assert len(result.rows) == 100
    assert not result.violations
    assert result.outside_domain == 0


def test_the_first_sentence_names_the_joint_that_fails_though_the_sets_hold(planar) -> None:  # type: ignore[no-untyped-def]
    """Wide sets enclose what a model does not explain: that must not read as good."""
    folder, _, _ = planar
    found = compare(load_model(folder / "m.model.json"), [folder / "rec.parquet"])
    assert not found.violations
    figures = {
        j: row | {"torque_rmse": (0.6 if k else 0.9), "torque_rmse_known": (0.4 if k else 0.1), "torque_rmse_floor": 0.1}
        for k, (j, row) in enumerate(found.figures.items())
    }  # the first joint's abstraction leaves more out, which is known
    said = verdict(dataclasses.replace(found, figures=figures))
    assert said.kind == ""
    assert JOINTS[1] in said.text and "4.0 times" in said.text and "leaves out, 0.6 N m" in said.text and "diagnose" in said.next
    assert said.text.startswith(f"The model fails most at {JOINTS[1]}"), "the joint comes before the arm"
    explained = {
        j: row | {"torque_rmse": 0.11, "torque_rmse_known": 0.11, "torque_rmse_floor": 0.1} for j, row in found.figures.items()
    }
    assert verdict(dataclasses.replace(found, figures=explained)).kind == "good"
    for rmse, floor in ((0.13, 0.1), (0.1, None)):  # above its floor, or no repetitions that would tell one: not green
        odd = {
            j: row | {"torque_rmse": rmse, "torque_rmse_known": rmse, "torque_rmse_floor": floor}
            for j, row in found.figures.items()
        }
        assert verdict(dataclasses.replace(found, figures=odd)).kind == ""
    beyond = tuple(dataclasses.replace(r, inside_domain=False) for r in found.rows)
    said = verdict(dataclasses.replace(found, figures=explained, rows=beyond))
    assert said.kind == "bad" and said.text.startswith("Not covered")


def test_one_recording_that_is_compared_is_spoken_of_as_one(planar) -> None:  # type: ignore[no-untyped-def]
    folder, _, _ = planar
    whole = compare(load_model(folder / "m.model.json"), [folder / "rec.parquet"])
    found = dataclasses.replace(whole, rows=whole.rows[:1])
    assert "The recording stays inside the predicted sets." in verdict(found).text
    beyond = dataclasses.replace(found, rows=(dataclasses.replace(found.rows[0], inside_domain=False),))
    assert "Not covered: the recording leaves the model's domain, where it promises nothing." in verdict(beyond).text
