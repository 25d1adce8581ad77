"""Bags of others: what a foreign writer of ROS 2 MCAP files wrote is read, and what we encode is read by its reader."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest

from monitor_arm import known_model, motion
from stopset.monitor.bags import trials_of_bag
from stopset.monitor.jointstate import JointState, to_cdr

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
