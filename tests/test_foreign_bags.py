"""Bags of others: what foreign writers of ROS 2 MCAP files and ROS 1 bags wrote is read, and what we encode is read by their reader."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest

from monitor_arm import known_model, motion
from stopset.cli.main import main
from stopset.monitor.bags import trials_of_bag
from stopset.monitor.jointstate import JointState, to_cdr
from stopset.recording import read_recordings

decoder = pytest.importorskip("mcap_ros2.decoder", reason="mcap-ros2-support is not installed")
writer = pytest.importorskip("mcap_ros2.writer")

MESSAGE = "sensor_msgs/msg/JointState"
DEFINITION = """std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
NAMES = known_model().joints
STAMP = 1_700_000_000_123_456_789


def test_their_reader_gets_what_we_encode() -> None:
    from mcap.records import Schema

    row = tuple(0.1 * k - 0.3 for k in range(6))
    for sent in (JointState(STAMP, NAMES, row, row[::-1], row), JointState(STAMP, NAMES, row, row, ())):
        schema = Schema(id=1, name=MESSAGE, encoding="ros2msg", data=DEFINITION.encode())
        got = decoder.DecoderFactory().decoder_for("cdr", schema)(to_cdr(sent))
        assert got.header.stamp.sec * 10**9 + got.header.stamp.nanosec == STAMP and tuple(got.name) == NAMES
        assert (tuple(got.position), tuple(got.velocity), tuple(got.effort)) == (sent.position, sent.velocity, sent.effort)


def test_what_their_writer_wrote_is_read(tmp_path: Path) -> None:
    r, out = motion(0, 200), io.BytesIO()
    bag = writer.Writer(out)
    schema = bag.register_msgdef(MESSAGE, DEFINITION)
    for k in range(len(r.t)):
        stamp = STAMP + round(1e9 * r.t[k])
        head = {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}, "frame_id": "base with a name of odd length"}
        rows = {"position": r.q[k].tolist(), "velocity": r.dq[k].tolist(), "effort": r.tau[k].tolist()}
        bag.write_message(
            "/joint_states", schema, {"header": head, "name": list(NAMES), **rows}, log_time=stamp, publish_time=stamp
        )
    bag.finish()
    path = tmp_path / "theirs.mcap"
    path.write_bytes(out.getvalue())
    ((trial, names),) = trials_of_bag(path, "/joint_states", None, None, 0)
    assert names == NAMES
    assert np.array_equal(trial.q, r.q) and np.array_equal(trial.dq, r.dq) and np.array_equal(trial.tau, r.tau)


def ros1(path: Path, compression: str | None, topic: str = "/joint_states") -> tuple[Path, np.ndarray]:
    """A bag of ROS 1 by its own kind of writer, with another topic beside, chunks of some kB, and its angles."""
    bag = pytest.importorskip("rosbags.rosbag1", reason="rosbags is not installed")
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
    made = store.types
    r = motion(0, 200)
    w = bag.Writer(path)
    w.chunk_threshold = 4096
    if compression is not None:
        w.set_compression(w.CompressionFormat[compression])
    with w:
        mine = w.add_connection(topic, "sensor_msgs/msg/JointState", typestore=store)
        other = w.add_connection("/chatter", "std_msgs/msg/String", typestore=store)
        for k in range(len(r.t)):
            stamp = STAMP + round(1e9 * r.t[k])
            time = made["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9)
            header = made["std_msgs/msg/Header"](seq=k, stamp=time, frame_id="odd")
            message = made["sensor_msgs/msg/JointState"](header, list(NAMES), r.q[k], r.dq[k], r.tau[k])
            w.write(mine, stamp, store.serialize_ros1(message, "sensor_msgs/msg/JointState"))
            w.write(other, stamp, store.serialize_ros1(made["std_msgs/msg/String"]("a" * k), "std_msgs/msg/String"))
    return path, r.q


@pytest.mark.parametrize("compression", [None, "BZ2", "LZ4"])
def test_a_bag_of_ros_1_is_read(tmp_path: Path, compression: str | None, capsys: pytest.CaptureFixture[str]) -> None:
    path, q = ros1(tmp_path / "r.bag", compression)
    ((trial, names),) = trials_of_bag(path, "/joint_states", None, None, 0)
    assert names == NAMES and np.array_equal(trial.q, q)
    record = tmp_path / "r.parquet"
    assert main(["import", str(path), "--out", str(record)]) == 0
    (read,) = read_recordings(record)
    assert np.allclose(read.q, q, atol=1e-6)
    assert main(["inspect", str(path)]) == 2
    assert f"stopset import {path.name}" in capsys.readouterr().err


def test_a_bag_of_ros_1_that_is_none_is_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, _ = ros1(tmp_path / "r.bag", "BZ2", "/arm/joint_states")
    whole = path.read_bytes()
    cases = {
        "whole": (whole, "give --topic /arm/joint_states"),
        "half": (whole[: len(whole) // 2], "rosbag reindex"),
        "none": (b"something else", "not a readable bag of ROS 1"),
        "empty": (b"", "not a readable bag of ROS 1"),
    }
    for name, (data, said) in cases.items():
        path.write_bytes(data)
        assert main(["import", str(path), "--out", str(tmp_path / f"{name}.parquet")]) == 2
        assert said in capsys.readouterr().err, name
    big = bytearray(whole)
    at = big.index(b"size=") + 5  # of the first chunk
    big[at : at + 4] = (2**31 - 1).to_bytes(4, "little")
    path.write_bytes(bytes(big))
    assert main(["import", str(path), "--out", str(tmp_path / "big.parquet")]) == 2
    assert "expected at most 67108864" in capsys.readouterr().err
