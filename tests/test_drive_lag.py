"""A drive that follows its command as 1 / (T s + 1): named as that, as late stamps, or as either, as far as the recordings tell."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from stopset.cli.main import main
from stopset.effects import Fitted
from stopset.offline.description import load_robot, robot_from_text
from stopset.offline.diagnose import Diagnosis, diagnose
from stopset.offline.diagnose.estimate import estimates
from stopset.offline.diagnose.question import Inquiry
from stopset.offline.nominal.filters import first_order
from stopset.offline.nominal.known_effects import plain
from stopset.recording import Recordings
from stopset.robot import Robot
from stopset.simulation import prepare
from stopset.simulation.cell import TICK
from stopset.simulation.hidden import Hidden
from stopset.simulation.sizing import inject
from test_hidden_effects import ARM, story

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from as_found import ONE, Trouble, recorded

HELD = TICK / 2  # a simulated drive holds its torque for the tick after its stamp: on time, it acts this much later
SURE = 3.0  # standard deviations


@cache
def recordings(effect: str, joint: str, size: float, seed: int) -> tuple[Robot, Recordings]:
    robot = robot_from_text(ARM)
    scenario = prepare(robot, ["none"], seed, "short", cad="wrong" if seed % 2 else "exact")
    cell, _ = inject(scenario.cell, [Hidden(effect, robot.joints.index(joint), size)])
    made = tuple(replace(scenario, cell=cell).recordings())
    return scenario.robot, Recordings(replace(scenario.meta, sources=()), made)


@cache
def found(effect: str, joint: str, size: float, seed: int) -> Diagnosis:
    return diagnose(*recordings(effect, joint, size, seed))


@pytest.mark.parametrize(("joint", "T", "seed"), [("lift", 0.015, 4), ("turn", 0.008, 5), ("bend", 0.012, 6)])
def test_a_slow_drive_is_named_with_its_time_constant(joint: str, T: float, seed: int) -> None:
    """It was called a delay of as much: the recorded torque "early" by T and half a sample."""
    answer = found("drive_lag", joint, T, seed)
    assert [r.label for r in answer.ranked] == [f"drive_lag:{joint}"] and not answer.alternatives
    told = answer.ranked[0].parameters["T"]
    assert told.std is not None and abs(told.value - T - HELD) < SURE * told.std < 0.3 * T
    assert answer.ranked[0].error_after < 0.95 * answer.ranked[0].error_before


@pytest.mark.parametrize(("joint", "lag", "seed"), [("lift", -0.008, 3), ("turn", -0.012, 4), ("lift", 0.01, 3)])
def test_stamps_that_are_apart_are_no_slow_drive(joint: str, lag: float, seed: int) -> None:
    """Torque through a lag has less noise: with that for nothing the first two are named slow drives."""
    answer = found("delay", joint, lag, seed)
    assert [r.label for r in answer.ranked] == [f"delay:{joint}"] and not answer.alternatives


def test_the_story_of_a_slow_drive_that_add_takes(tmp_path: Path) -> None:
    """Simulated, identified, diagnosed, added: the torque error falls, and the revision holds the time constant."""
    urdf, model, more = tmp_path / "three.urdf", str(tmp_path / "arm.model.json"), str(tmp_path / "more.model.json")
    urdf.write_text(ARM)
    truth, _ = story(urdf, "drive_lag:lift", tmp_path)
    data = str(tmp_path / "recording.parquet")
    assert main(["identify", "--robot", str(tmp_path / "robot.urdf"), "--data", data, "--out", model]) == 0
    answer = tmp_path / "answer.json"
    assert main(["diagnose", model, "--data", data, "--json", str(answer)]) == 0
    first = json.loads(answer.read_text())["ranked_effects"][0]
    assert (first["effect"], first["joint"]) == ("drive_lag", "lift") and first["error_after"] < first["error_before"]
    assert main(["add", model, "drive_lag", "--joint", "lift", "--data", data, "--out", more, "--json", str(answer)]) == 0
    added = next(e for e in json.loads(Path(more).read_text())["effects"] if e["effect"] == "drive_lag")
    hidden = truth["effects"][0]  # type: ignore[index]
    assert added["values"]["T"] == pytest.approx(hidden["params"]["lag_s"] + HELD, abs=0.002)


def test_where_recordings_do_not_tell_the_answer_says_both_and_either_is_estimated() -> None:
    """One trajectory of a wrist at 100 Hz: hardly anything is seen within 5 ms."""
    robot = load_robot("lwa4p")
    scenario = prepare(robot, ["none"], 40, "short", cad="wrong")
    cell, _ = inject(scenario.cell, [Hidden("drive_lag", 4, 0.005)])
    data = recorded(replace(scenario, cell=cell), ONE, 100.0, Trouble(), 140)
    answer = diagnose(scenario.robot, data)
    joint = robot.joints[4]
    (both,) = answer.alternatives
    assert set(both.one_of) == {f"delay:{joint}", f"drive_lag:{joint}"} and "500 Hz" in both.telling
    q = Inquiry(scenario.robot, data, frozenset(), (), None, "the description", ())
    for name in ("delay", "drive_lag"):
        (got,) = estimates(q, [f"{name}:{joint}"]).found
        assert got.found.effect == name and got.after[4] < got.before[4]


def test_a_lag_that_is_known_is_taken_out_of_the_record() -> None:
    robot, data = recordings("drive_lag", "lift", 0.015, 4)
    lag = Fitted("drive_lag", "lift", {"T": 0.015 + HELD})
    r = max(data, key=lambda r: float(np.ptp(r.tau[:, 1])))
    acted = plain(r, robot, [lag], 0.0)
    assert np.array_equal(acted.tau[:, [0, 2]], r.tau[:, [0, 2]])
    told = acted.tau[1:, 1] + (0.015 + HELD) * np.diff(acted.tau[:, 1]) / np.diff(r.t)
    assert np.std(told - r.tau[1:, 1]) < 0.3 * np.std(acted.tau[:, 1] - r.tau[:, 1]) + 0.2
    without = diagnose(robot, data, fitted=[lag])
    assert not [x for x in without.ranked if x.joints == ("lift",)]


def test_a_filter_of_first_order_follows_a_ramp_by_its_time_constant() -> None:
    t = np.arange(400) * 0.002
    out = first_order((3.0 * t)[:, None], 0.01 / 0.002)[:, 0]
    assert out[0] == 0.0 and np.abs(out - 3.0 * (t - 0.01 * -np.expm1(-t / 0.01))).max() < 3.0 * 2e-4
    assert np.array_equal(first_order(np.full((50, 1), 7.0), 4.0), np.full((50, 1), 7.0))
