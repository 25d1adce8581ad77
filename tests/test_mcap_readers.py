"""Readers that others wrote open what the monitor writes. They are no part of the product, and where they are not installed that is said.

``pip install rerun-sdk foxglove-schemas-protobuf`` brings them.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from mcap.reader import make_reader

from monitor_arm import known_model
from stopset.monitor.config import Records
from test_monitor_evidence import altered, record

RERUN = shutil.which("rerun")
TOPICS = {
    "stopset/joint_states", "stopset/ros/joint_states", "stopset/verdict", "stopset/tube", "stopset/ros/tube_lo",
    "stopset/ros/tube_hi", "stopset/can", "stopset/cause", "stopset/log",
}  # fmt: skip


@pytest.fixture(scope="module")
def violation(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of a violation."""
    folder = tmp_path_factory.mktemp("seen") / "record"
    return Path(record(folder, known_model(), Records(before_s=0.5), altered()).answers[0].file)


def rerun(*words: str) -> str:
    done = subprocess.run([str(RERUN), *words], capture_output=True, text=True, timeout=120, env={"NO_COLOR": "1"}, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


@pytest.mark.skipif(RERUN is None, reason="rerun-sdk is not installed")
def test_rerun_finds_nothing_wrong_and_draws_every_curve(violation: Path, tmp_path: Path) -> None:
    found = re.findall(
        r"^(\w+)\s+\S+\s+\d+\s+/?(stopset/\S+)\s+(\S.*)$", rerun("mcap", "check", "--full", str(violation)), re.MULTILINE
    )
    assert {topic for _, topic, _ in found} >= TOPICS
    assert {(status, issues.strip()) for status, _, issues in found} == {("ok", "—")}
    rerun("mcap", "convert", str(violation), "-o", str(tmp_path / "seen.rrd"))
    printed = rerun("rrd", "print", str(tmp_path / "seen.rrd"))
    with violation.open("rb") as f:
        rows = {c.topic: 0 for c in make_reader(f).get_summary().channels.values()}  # type: ignore[union-attr]
        for _, channel, _ in make_reader(f).iter_messages():
            rows[channel.topic] += 1
    for topic in ("joint_states", "tube_lo", "tube_hi"):
        for curve in ("position", "velocity"):
            drawn = re.findall(rf"with (\d+) rows .*? - /stopset/ros/{topic}/{curve} - data columns: \[Scalars:scalars", printed)
            assert sum(int(n) for n in drawn) == rows[f"stopset/ros/{topic}"] > 100, f"{topic}, {curve}"


@pytest.mark.skipif(RERUN is None, reason="rerun-sdk is not installed")
def test_rerun_says_of_a_file_that_breaks_off_that_it_does(violation: Path, tmp_path: Path) -> None:
    """The check that passes above is one that can fail."""
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(violation.read_bytes()[:-2000])
    done = subprocess.run([str(RERUN), "mcap", "check", str(broken)], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode != 0


def test_foxgloves_own_type_takes_the_log(violation: Path) -> None:
    log_type = pytest.importorskip("foxglove_schemas_protobuf.Log_pb2", reason="foxglove-schemas-protobuf is not installed")
    json_format = pytest.importorskip("google.protobuf.json_format")
    timestamps = pytest.importorskip("google.protobuf.timestamp_pb2")
    with violation.open("rb") as f:
        ((schema, _, message),) = make_reader(f).iter_messages(["stopset/log"])
    assert schema is not None and schema.name == "foxglove.Log"
    content = json.loads(message.data)
    # times stand as {sec, nsec} in Foxglove's JSON, as a text in protobuf's
    content["timestamp"] = timestamps.Timestamp(
        seconds=content["timestamp"]["sec"], nanos=content["timestamp"]["nsec"]
    ).ToJsonString()
    log = json_format.ParseDict(content, log_type.Log())  # refuses a field that it does not know
    assert log.level == log_type.Log.Level.ERROR and log.message and log.name
    assert {f.name for f in log.DESCRIPTOR.fields} == set(content)
