"""Logs of others: tables of RTDE clients, and ROS 2 bags as they are found."""

from __future__ import annotations

import csv
import sqlite3
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from stopset.cli.main import main
from stopset.monitor.jointstate import JointState, to_cdr
from stopset.monitor.rtde import JOINTS as UR
from stopset.recording import read_meta, read_recordings
from stopset.types import Array

N, RATE = 400, 125.0
T = 7.0 + np.arange(N) / RATE
Q = np.sin(np.outer(T, np.linspace(0.5, 1.5, 6)))
DQ = np.cos(np.outer(T, np.linspace(0.5, 1.5, 6))) * np.linspace(0.5, 1.5, 6)
CURRENT = 0.3 * Q + 0.1 * DQ
K = (13.0, 13.0, 9.5, 8.0, 8.0, 8.0)


def table(path: Path, mark: str, **groups: Array) -> Path:
    """As a client writes it: the groups' columns numbered from base to flange."""
    head = ["timestamp", *(f"{g}_{k}" for g, x in groups.items() for k in range(x.shape[1]))]
    with path.open("w", newline="") as f:
        w = csv.writer(f, delimiter=mark)
        w.writerow(head)
        w.writerows(np.column_stack([T, *groups.values()]).tolist())
    return path


@pytest.mark.parametrize("mark", [" ", ",", ";"])
def test_currents_of_a_ur_become_torques_by_the_constants_that_are_stated(tmp_path: Path, mark: str) -> None:
    path, out = table(tmp_path / "rtde.csv", mark, actual_q=Q, actual_qd=DQ, actual_current=CURRENT), tmp_path / "rec.parquet"
    assert main(["import", str(path), "--out", str(out)]) == 2  # currents alone are no torques
    assert not out.exists()
    assert main(["import", str(path), "--out", str(out), "--torque-constant", ",".join(map(str, K))]) == 0
    (r,) = read_recordings(out)
    assert read_meta(out).joints == UR and read_meta(out).effort == "motor_torque"
    assert r.tau == pytest.approx(CURRENT * K, rel=1e-6) and r.q == pytest.approx(Q, abs=1e-6) and r.t[0] == 0.0


def test_the_torque_nearest_to_a_measurement_is_taken_and_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, groups = tmp_path / "rec.parquet", {"actual_q": Q, "actual_qd": DQ, "target_moment": 5 * Q}
    assert main(["import", str(table(tmp_path / "a.csv", ",", **groups)), "--out", str(out)]) == 0
    assert "no measurement" in capsys.readouterr().out
    assert read_recordings(out).trials[0].tau == pytest.approx(5 * Q, rel=1e-6)
    more = groups | {"actual_current_as_torque": 7 * Q}
    assert main(["import", str(table(tmp_path / "b.csv", ",", **more)), "--out", str(out)]) == 0
    assert read_recordings(out).trials[0].tau == pytest.approx(7 * Q, rel=1e-6)


@pytest.mark.parametrize(
    ("spoil", "word"),
    [
        (lambda text: text.replace("actual_qd_3", "other"), "actual_qd_3"),
        (lambda text: text.replace("timestamp", "time"), "timestamp"),
        (lambda text: text.replace(text.splitlines()[9], text.splitlines()[9].rsplit(",", 3)[0]), "cut off"),
        (lambda text: text.replace(",0.", ",nonsense", 1), "expected numbers"),
        (lambda text: "\n".join(text.splitlines()[:5]), "at least"),
    ],
)
def test_tables_that_are_none_end_in_one_sentence(
    spoil: object, word: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = table(tmp_path / "rtde.csv", ",", actual_q=Q, actual_qd=DQ, target_moment=Q)
    assert callable(spoil)
    path.write_text(spoil(path.read_text()))
    assert main(["import", str(path), "--out", str(tmp_path / "rec.parquet")]) == 2
    said = capsys.readouterr().err.strip()
    assert word in said and "\n" not in said and not (tmp_path / "rec.parquet").exists()


def test_a_last_row_that_is_cut_off_is_left_out_and_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = table(tmp_path / "rtde.csv", ",", actual_q=Q, actual_qd=DQ, target_moment=Q), tmp_path / "rec.parquet"
    path.write_text(path.read_text().rsplit(",", 3)[0])
    assert main(["import", str(path), "--out", str(out)]) == 0
    assert "the last row is cut off and left out" in capsys.readouterr().out
    assert len(read_recordings(out).trials[0].t) == len(Q) - 1


@pytest.mark.parametrize("constants", ["1,2,3", "1,2,3,4,5,x", "1,2,3,4,5,0"])
def test_torque_constants_are_six_numbers_and_none_is_zero(constants: str, tmp_path: Path) -> None:
    path = table(tmp_path / "rtde.csv", ",", actual_q=Q, actual_qd=DQ, actual_current=CURRENT)
    assert main(["import", str(path), "--out", str(tmp_path / "rec.parquet"), "--torque-constant", constants]) == 2


def bag(path: Path, states: Sequence[JointState]) -> Path:
    """A ROS 2 bag's folder."""
    path.mkdir()
    (path / "metadata.yaml").write_text("rosbag2_bagfile_information:\n")
    with sqlite3.connect(path / "bag_0.db3") as db:
        db.execute("create table topics (id integer, name text, type text)")
        db.execute("create table messages (id integer primary key, topic_id integer, timestamp integer, data blob)")
        db.execute("insert into topics values (1, '/joint_states', 'sensor_msgs/msg/JointState')")
        rows = [(s.stamp_ns, to_cdr(s)) for s in states]
        db.executemany("insert into messages (topic_id, timestamp, data) values (1, ?, ?)", rows)
    return path


def states(effort: bool = True, velocity: bool = True) -> list[JointState]:
    return [
        JointState(round(1e9 * T[k]), UR, tuple(Q[k]), tuple(DQ[k]) if velocity else (), tuple(CURRENT[k]) if effort else ())
        for k in range(N)
    ]


def test_a_bag_without_effort_is_told_so_and_one_without_speeds_has_them_derived(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "rec.parquet"
    assert main(["import", str(bag(tmp_path / "a", states(effort=False))), "--out", str(out)]) == 2
    assert "no effort" in capsys.readouterr().err and not out.exists()
    assert main(["import", str(bag(tmp_path / "b", states(velocity=False))), "--out", str(out)]) == 0
    assert read_meta(out).velocity == "derived"
    assert read_recordings(out).trials[0].dq[1:-1] == pytest.approx(DQ[1:-1], abs=1e-3)


@pytest.mark.parametrize(
    ("kind", "do"),
    [("sensor_msgs/msg/JointState", "give --topic /joint_states"), ("std_msgs/msg/String", "record sensor_msgs/JointState")],
)
def test_a_bag_without_joint_states_on_the_topic_says_what_it_holds(
    kind: str, do: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = bag(tmp_path / "a", states())
    with sqlite3.connect(path / "bag_0.db3") as db:
        db.execute("update topics set type = ?", (kind,))
    assert main(["import", str(path), "--topic", "/js", "--out", str(tmp_path / "rec.parquet")]) == 2
    assert f"0 messages on /js, and /joint_states ({kind}); expected at least 10: {do}" in capsys.readouterr().err
    with sqlite3.connect(path / "bag_0.db3") as db:
        db.execute("alter table topics rename column type to what")
    assert main(["import", str(path), "--topic", "/js", "--out", str(tmp_path / "rec.parquet")]) == 2
    assert "0 messages on /js, and no topic" in capsys.readouterr().err


def test_a_gripper_on_the_same_topic_and_messages_sent_twice_do_not_cut_a_motion(tmp_path: Path) -> None:
    mixed = []
    for k, s in enumerate(states()):
        mixed += [s, s] if k % 50 == 7 else [s]
        if k % 3 == 0:
            mixed.append(JointState(s.stamp_ns + 1000, ("finger",), (0.0,), (0.0,), (0.0,)))
    out = tmp_path / "rec.parquet"
    assert main(["import", str(bag(tmp_path / "a", mixed)), "--out", str(out)]) == 0
    assert len(read_recordings(out)) == 1 and len(read_recordings(out).trials[0].t) == N
