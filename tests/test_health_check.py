"""The container's and the supervisor's health check, as they run it, against real daemons: good, in FAULT, hung, silent and gone."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from monitor_arm import known_model, meta, motion
from monitor_process import PREFIX, Ear, environment, free_port, running, stopset, write_config
from patience import wait
from stopset.artifact import save_model
from stopset.monitor.layout import State
from stopset.recording import write_recordings

DEPLOY = Path(__file__).resolve().parents[1] / "deploy"
SILENT = """
import sys, time
from stopset.monitor.links.zenoh_link import ZenohLink
link = ZenohLink(sys.argv[1], listen=[f"tcp/127.0.0.1:{sys.argv[2]}"])
link.alive("alive")
print("listens", flush=True)
time.sleep(60)
"""


def health(config: Path) -> tuple[int, str]:
    """The very command of the image, with this configuration; its exit code and what it said."""
    text = (DEPLOY / "container/Dockerfile").read_text()
    (reported,) = re.findall(r"HEALTHCHECK.*?CMD \[(.*?)\]", text, re.DOTALL)
    words = [str(config) if w == "/etc/stopset/arm.toml" else w for w in re.findall(r'"([^"]+)"', reported)]
    assert words[:2] == ["stopset", "watch"] and "--check" in words
    p = stopset(*words[1:])
    out, err = p.communicate(timeout=600)
    return p.returncode, out + err


@pytest.fixture
def config(tmp_path: Path) -> tuple[Path, int]:
    save_model(known_model(), tmp_path / "arm.model.json")
    write_recordings(tmp_path / "rec.parquet", meta(), [motion(s, 500, s) for s in range(2)])
    port = free_port()
    source = '[joint_states]\nkey = "js"\ncycle_s = 0.004'
    return write_config(tmp_path, tmp_path / "arm.model.json", source, port, publish="valid_for_ms = 1000\nstale_ms = 2000"), port


def test_green_only_for_a_daemon_that_watches(config: tuple[Path, int]) -> None:
    path, port = config
    words = ("replay", str(path.parent / "rec.parquet"), "--to", f"zenoh:tcp/127.0.0.1:{port}", "--key", "js", "--loop")
    with running("monitor", "--config", str(path)) as monitor, Ear(port) as ear:
        assert ear.wait(lambda: ear.states[-1:] == [State.INIT])
        code, reported = health(path)
        assert code == 1 and "INIT" in reported, f"it has never heard its arm: {reported}"
        with running(*words):
            assert ear.wait(lambda: {State.OK, State.DEGRADED, State.UNKNOWN} & set(ear.states[-1:]))
            code, reported = health(path)
            assert code == 0, reported
            monitor.send_signal(signal.SIGSTOP)
            code, reported = health(path)
            assert code != 0, f"hung: {reported}"
            monitor.send_signal(signal.SIGCONT)
            assert ear.wait(lambda: {State.OK, State.DEGRADED, State.UNKNOWN} & set(ear.states[-1:]))
            assert health(path)[0] == 0, "and green again"
        assert ear.wait(lambda: ear.states[-1] is State.FAULT), "the arm is gone"
        code, reported = health(path)
        assert code == 1 and "FAULT" in reported and "no signal from the arm" in reported
        monitor.kill()
        monitor.wait(600)
    code, reported = health(path)
    assert code != 0 and "Traceback" not in reported, f"gone: {reported}"


def test_red_for_a_daemon_that_is_there_and_says_nothing(config: tuple[Path, int]) -> None:
    path, port = config
    words = [sys.executable, "-c", SILENT, PREFIX, str(port)]
    p = subprocess.Popen(words, env=environment(), stdout=subprocess.PIPE, text=True)
    try:
        assert p.stdout is not None and wait(lambda: p.stdout.readline().strip() == "listens")
        code, reported = health(path)
        assert code == 1 and "NO DATA" in reported
    finally:
        p.kill()
        p.communicate()
