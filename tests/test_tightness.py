"""A set that encloses everything because it is wide is told, and is no success."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from stopset.cli.main import main
from stopset.offline.campaign.survey import Survey
from stopset.offline.conform.tightness import JUDGED, LIMIT, NAMES, Tightness, of_tube, table
from stopset.offline.description import load_robot
from stopset.offline.identify.absurd import absurd, late, silent
from stopset.offline.identify.pipeline import identify
from stopset.reach.flowpipe import DeviationTube
from synthetic import arm, names, recordings, save_trials, urdf

JOINTS = names(2)


def tube(half: np.ndarray, seen: np.ndarray, dt: float = 0.01, steps: int = 60) -> Tightness:
    """A tube of constant half width about envelopes that are constant too; only ages up to 0.6 s are reached."""
    ages = dt * np.arange(101)
    whole = np.tile(half, (101, 1))
    hi, lo = np.full((101, 4), -np.inf), np.full((101, 4), np.inf)
    hi[: steps + 1], lo[: steps + 1] = seen, -0.5 * seen
    return of_tube(DeviationTube(ages, -whole, whole), hi, lo, 2)


def test_the_ratio_is_half_the_width_over_the_largest_deviation() -> None:
    t = tube(np.array([0.2, 0.3, 2.0, 44.0]), np.array([0.1, 0.2, 1.0, 4.0]))
    assert t.ratio[JUDGED] == pytest.approx([2.0, 1.5, 2.0, 11.0])
    assert t.by_joint[0] == pytest.approx([2.0, 11.0])
    assert np.isnan(t.ratio[2]).all()  # no prediction is a second long
    assert t.median == pytest.approx(2.0)
    said = t.words(JOINTS)
    assert len(said) == 1 and "too wide" in said[0] and JOINTS[1] in said[0] and "44 rad/s" in said[0] and "11.0 times" in said[0]
    assert t.too_wide() and not tube(np.full(4, 0.2), np.full(4, 0.1)).too_wide()
    answer = t.answer(JOINTS)
    assert answer["tightness"][JOINTS[1]] == {NAMES[0]: pytest.approx(11.0), NAMES[1]: pytest.approx(11.0), NAMES[2]: None}
    assert any("11.0" in line for line in table(t, JOINTS))


def test_what_never_deviated_and_what_is_not_promised_has_no_ratio() -> None:
    t = tube(np.array([0.2, np.inf, 2.0, np.inf]), np.array([0.0, 0.2, 1.0, 4.0]))
    assert np.isnan(t.ratio[JUDGED][[0, 1, 3]]).all() and not t.too_wide()


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tight")
    (folder / "arm.urdf").write_text(urdf(JOINTS))
    return save_trials(folder / "rec.parquet", recordings((2.0, 0.7), (4.0, 2.0), suites=3, trials=4, seconds=1.6), JOINTS)


def test_identify_and_compare_say_it_and_a_limit_fails_identify(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["identify", "--robot", str(data.parent / "arm.urdf"), "--data", str(data), "--out", str(tmp_path / "m")]
    assert main(words) == 0
    assert "half width of the tube over the largest deviation seen" in capsys.readouterr().out
    assert main(["compare", str(tmp_path / "m"), "--data", str(data), "--json", str(tmp_path / "c.json")]) == 0
    answer = json.loads((tmp_path / "c.json").read_text())
    assert set(answer["tightness"]) == set(JOINTS) and set(answer["tightness"][JOINTS[0]]) == set(NAMES)
    assert all(0.5 < answer["tightness"][j]["0.1_s"] < 3.0 for j in JOINTS)
    # sets of twelve times the size enclose all the same
    assert main([*words, "--margin", "12"]) == 1
    assert f"more than {LIMIT:g} times" in capsys.readouterr().out and (tmp_path / "m").exists()
    assert main([*words, "--margin", "12", "--accept-wide"]) == 0
    assert "accepted as asked" in capsys.readouterr().out


def test_absurd_sets_are_named(data: Path) -> None:
    found = identify(arm(JOINTS), [data])
    survey: Survey = found.survey
    s, errors, n = found.model.powered, found.model.errors, 2
    assert absurd(s, errors, survey) == [] and found.absurd == ()
    V = dataclasses.replace(s.V, hi=np.where(np.arange(4) == n, 40.0, s.V.hi))
    assert "never faster than" in absurd(dataclasses.replace(s, V=V), errors, survey)[0].what
    far = {j: {**row, "position_rmse": 2392.0 if j == JOINTS[1] else row["position_rmse"]} for j, row in errors.items()}
    assert "diverges" in absurd(s, far, survey)[0].what
    (light,) = absurd(s, far, survey, geared=False)[:1]  # links without rotors leave their range, and that is no contradiction
    assert not light.grave and "behind the gears" in light.what
    U = dataclasses.replace(s.U, lo=s.U.hi.copy())
    odd = absurd(dataclasses.replace(s, U=U), {j: {**row, "torque_rmse": 2.9} for j, row in errors.items()}, survey)
    assert len(odd) == 2 and "0 N m wide" in odd[0].what
    assert late(survey, JOINTS) == [] and silent(survey, JOINTS, found.tightness) == []
    (text,) = late(dataclasses.replace(survey, late=np.array([0.012, 0.0])), JOINTS)
    assert "12.0 ms after the slope" in text and JOINTS[0] in text
    blind = dataclasses.replace(found.tightness, half=np.array([[0.1, 0.1, 9.0, 9.0]] * 3))
    assert all(x.grave and "say nothing" in x.what for x in silent(survey, JOINTS, blind))
    (why,) = silent(
        survey, JOINTS, blind, geared=False
    )  # one sentence of all joints, with what to record instead of what to look at
    assert why.grave and all(j in why.what for j in JOINTS) and "motor current times torque constant" in why.what
    assert "look at its inertia" not in why.what and silent(survey, JOINTS, found.tightness, geared=False) == []
    one = dataclasses.replace(found.tightness, half=np.array([[0.1, 0.1, 9.0, 0.1]] * 3))
    assert [x.says[:5] for x in silent(survey, JOINTS, one)] == ["wide:"]


@pytest.mark.shared
def test_the_real_arm_of_the_paper_is_tight(schunk) -> None:  # type: ignore[no-untyped-def]
    assert schunk.tightness.median < 1.6
    n = schunk.model.n
    assert schunk.model.powered.V.hi[n:].max() < 0.12  # [rad/s] joint 2 vibrates with 0.065


@pytest.mark.shared
@pytest.mark.slow
def test_a_real_ur10e_is_tight_with_held_out_recordings_inside(shared_data) -> None:  # type: ignore[no-untyped-def]
    folder = shared_data("ur10e")
    found = identify(load_robot(folder / "robot.urdf"), [folder / "identification.parquet"])
    assert found.tightness.median <= 3.0 and not found.tightness.too_wide() and not found.absurd
    assert found.model.guarantee.motions >= 3 and found.model.guarantee.violated == 0
    assert found.model.powered.V.hi[6:].max() < 0.3  # it was 1.1 rad/s
