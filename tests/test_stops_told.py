"""What `stopset stops` tells of a row is held against stops in every direction that the row speaks of, each number for itself."""

from __future__ import annotations

import csv
import json
import sys
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from stop_published import failed_ramp, places, power_off, working_ramp
from stop_sampling import ANGLE_ERROR, DT
from stopset.artifact import Model, save_model
from stopset.cli.main import main
from stopset.errors import NotCovered
from stopset.offline.stops.directions import hull
from stopset.offline.stops.poses import SLACK, Poses
from stopset.offline.stops.separation import protective_separation
from stopset.offline.stops.shown import terms
from stopset.offline.stops.table import ONE_POSE, Question, StopRow, few_poses, holding, prepared, stop_table
from stopset.reach.stops import Category, Ramp, StopBounds

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from stop_arms import prbt_like

RAMP = Ramp.stated(6, time=0.5).failing(0.3)
WORKING = replace(RAMP, off_after=None)
KG = 2.0
STILL = (np.zeros(6), np.zeros(6))


@pytest.fixture(scope="module")
def model() -> Model:
    return prbt_like((0.0, 3.0))


@pytest.fixture(scope="module")
def bounds(model: Model) -> StopBounds:
    return prepared(model, KG, Question(RAMP, payload=KG))


def worst_found(bounds: StopBounds, row: StopRow, category: Category, dq: np.ndarray) -> np.ndarray:
    """(3,) the longest time [s], the farthest angle [rad] of the row's axes and way of the tool [m] of some stops with the speeds ``dq``."""
    q, group = np.array(row.pose), [bounds.model.joints.index(j) for j in row.joint.split("+")]
    if category == "0":
        stops = power_off(bounds, q, dq, STILL, 0.3, 3, 1)
    elif category == "1":
        stops = working_ramp(bounds, q, dq, STILL, 0.0, 3, 2)
    else:
        stops = failed_ramp(bounds, q, dq, STILL, 0.3, 3, 3)
    found = []
    for x in stops:
        tool = places(bounds.model.robot, bounds.setting.payload_com, x).tool
        found.append([x.rests.max(), np.abs(x.q - x.q[0]).max(axis=0)[group].max(), np.linalg.norm(tool - tool[0], axis=1).max()])
    return np.max(found, axis=0)


@pytest.mark.parametrize("category", ["0", "1", "1 guaranteed"])
def test_every_number_of_a_table_holds_in_every_direction(
    category: Category, model: Model, bounds: StopBounds, tmp_path: Path
) -> None:
    save_model(model, tmp_path / "m.json")
    asked = [
        "--category",
        category,
        "--payload",
        f"{KG:g}",
        "--ramp-time",
        "0.5",
        *([] if category == "1" else ["--off-after", "0.3"]),
    ]
    assert main(["stops", str(tmp_path / "m.json"), *asked, "--json", str(tmp_path / "a.json"), "--quiet"]) == 0
    told = json.loads((tmp_path / "a.json").read_text())
    rows = stop_table(model, Question(WORKING if category == "1" else RAMP, (category,), payload=KG)).rows
    assert [r.as_json() for r in rows] == told
    speed = np.full(6, 1.26)
    for row, said in zip(rows, told, strict=True):
        group = [model.joints.index(j) for j in row.joint.split("+")]
        number = np.array([said["time_s"] + 2 * DT, said["angle_rad"] + ANGLE_ERROR, said["tcp_m"] + 2e-6])
        for signs in product((1.0, -1.0), repeat=len(group)):
            dq = np.zeros(6)
            dq[group] = np.array(signs) * speed[group] * row.speed_percent / 100.0
            assert np.all(worst_found(bounds, row, category, dq) <= number), (row.joint, row.speed_percent, signs)


def test_a_table_says_that_its_rows_are_of_one_pose_each(model: Model) -> None:
    """At a third of the reach others carry the tool twice as far: whoever reads a row as the worst of its extension must be told."""
    question = Question(RAMP, ("0",), payload=KG)
    table, bounds = stop_table(model, question), prepared(model, KG, question)
    row = next(r for r in table.rows if r.joint == "arm_2_joint" and (r.speed_percent, r.extension_percent) == (100.0, 33.0))
    poses, dq = Poses.of(model.robot, model.robot.tip, model.domain.q), 1.26 * np.eye(6)[1]
    near = poses.q[(np.abs(poses.extension - 0.33) <= SLACK) & poses.seen][:60]
    assert row.tcp_m is not None and ONE_POSE in table.assumptions
    assert max(bounds.bound(q, dq).tcp or 0.0 for q in near) > 1.3 * row.tcp_m, "else the sentence is not needed"


def test_rows_of_several_poses_are_the_worst_of_each_number(model: Model) -> None:
    """From none of them, nor from sixty others near the extension by much, does the arm go farther; the pose told is the one the tool goes
    farthest from."""
    one, few = (stop_table(model, Question(RAMP, ("0",), payload=KG, poses=k)) for k in (1, 4))
    bounds, poses, dq = (
        prepared(model, KG, Question(RAMP, payload=KG)),
        Poses.of(model.robot, model.robot.tip, model.domain.q),
        1.26 * np.eye(6)[1],
    )
    for a, b in zip(one.rows, few.rows, strict=True):
        assert (a.joint, a.speed_percent, a.extension_percent) == (b.joint, b.speed_percent, b.extension_percent)
        assert a.time_s is not None and b.time_s is not None and b.time_s >= a.time_s
        assert (b.angle_rad or 0.0) >= (a.angle_rad or 0.0) > 0.0 and (b.tcp_m or 0.0) >= (a.tcp_m or 0.0) > 0.0
    row = next(r for r in few.rows if r.joint == "arm_2_joint" and (r.speed_percent, r.extension_percent) == (100.0, 33.0))
    assert bounds.setting is not None and ONE_POSE not in few.assumptions and few_poses(4) in few.assumptions
    said, tool = np.array([row.time_s, row.angle_rad, row.tcp_m]), list[float]()
    for q in poses.worst_few(1, 0.33, bounds.setting.plant.pi, 4):
        for b in (bounds.bound(q, s * dq) for s in (1.0, -1.0)):
            assert b.time is not None and b.angle is not None and b.tcp is not None
            assert np.all(np.array([b.time.max(), b.angle[1], b.tcp]) <= said)
        tool.append(max(bounds.bound(q, s * dq).tcp or 0.0 for s in (1.0, -1.0)))
        if tool[-1] == max(tool):
            farthest_from = q
    assert len(tool) == 4 and row.pose == tuple(farthest_from)
    near = poses.q[(np.abs(poses.extension - 0.33) <= SLACK) & poses.seen][:60]
    assert row.tcp_m is not None and max(bounds.bound(q, dq).tcp or 0.0 for q in near) < 1.1 * row.tcp_m
    with pytest.raises(NotCovered, match="worst of 0 poses; expected 1 to 100"):
        stop_table(model, Question(RAMP, ("0",), poses=0))


def test_a_hull_holds_each_of_its_stops(bounds: StopBounds) -> None:
    q, dq = np.array([0.3, 0.6, -0.8, 0.2, 0.4, 0.0]), np.array([1.0, 0.8, 0.9, 0.0, 0.0, 0.0])
    found = [bounds.bound(q, dq * (*s, 0, 0, 0), "0") for s in product((1.0, -1.0), repeat=3)]
    whole = hull(found[0], found)
    for b in found:
        for name in ("time", "forward", "back", "speed", "links", "link_speed", "tcp", "tcp_speed"):
            assert np.all(getattr(whole, name) >= getattr(b, name))
        assert np.all(whole.tcp_box[:, 0] <= b.tcp_box[:, 0]) and np.all(whole.tcp_box[:, 1] >= b.tcp_box[:, 1])
        assert np.all(whole.holding_margin <= b.holding_margin)
    refused = StopBounds.of(bounds.model).bound(q, dq, "1")  # no ramp
    assert hull(refused, [refused, *found]) is refused


def test_a_margin_is_told_rounded_down(model: Model, bounds: StopBounds, tmp_path: Path) -> None:
    rows = stop_table(model, Question(RAMP, ("0",), payload=KG)).rows
    least = np.min([r.margin for r in rows], axis=0)
    said = holding(model, rows)[0].split(": ")[1].split(", ")
    assert all(float(x.rsplit(" ", 1)[1]) <= m + 1e-9 for x, m in zip(said, least, strict=True))
    save_model(model, tmp_path / "m.json")
    main(
        [
            "stops",
            str(tmp_path / "m.json"),
            "--category",
            "0",
            "--payload",
            f"{KG:g}",
            "--csv",
            str(tmp_path / "a.csv"),
            "--quiet",
        ]
    )
    for r, line in zip(rows, csv.DictReader((tmp_path / "a.csv").open()), strict=True):
        assert all(float(x) <= m + 1e-9 for x, m in zip(line["holding margin [N m]"].split(), r.margin, strict=True))


def test_terms_of_a_separation_distance_are_told_rounded_up(
    capsys: pytest.CaptureFixture[str], model: Model, tmp_path: Path
) -> None:
    """What a reader adds up is never less than the sum: stopping time, distance and speed are bounds."""
    given = {"v_h": 1.6, "T_r": 0.1, "C": 0.2, "Z_d": 0.05, "Z_r": 0.01}
    found = protective_separation(0.314421, 0.123419, 1.987613, given)
    ((_, _, rows),) = terms([found])
    shown = {symbol: float(value) for symbol, value, *_ in rows}
    assert all(x <= shown[symbol] < x + 1.1e-4 for symbol, x, *_ in found.terms)
    assert shown["S_h"] + shown["S_r"] + shown["S_s"] + shown["C"] + shown["Z_d"] + shown["Z_r"] >= found.distance
    save_model(model, tmp_path / "m.json")
    asked = [
        "--category",
        "0",
        "--at",
        "0,0.5,0.6,0,0.3,0",
        "--speed",
        "87%",
        "--separation",
        "--v-human",
        "1.6",
        "--reaction",
        "0.1",
    ]
    asked += ["--intrusion", "0.2", "--person-uncertainty", "0.05", "--robot-uncertainty", "0.01"]
    assert main(["stops", str(tmp_path / "m.json"), *asked, "--json", str(tmp_path / "a.json")]) == 0
    said = {
        words[0]: float(words[1])
        for line in capsys.readouterr().out.splitlines()
        if (words := line.split()) and words[0] == "T_s"
    }
    assert said["T_s"] >= max(r["time_s"] for r in json.loads((tmp_path / "a.json").read_text()))
