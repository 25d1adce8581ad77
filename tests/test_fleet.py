"""The same identification on a cluster of two worker processes: identical model, also when a worker is killed on the way."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from stopset.cli.main import main

pytest.importorskip("distributed")
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from campaign import RATE, trials

from stopset.offline.description import load_robot
from stopset.recording import Meta, write_recordings

TRIALS = 400
LOOPBACK = "tcp://127.0.0.1"


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    robot = load_robot("lwa4p")
    path = tmp_path_factory.mktemp("fleet") / "campaign.parquet"
    cut = (r.cut(0, 400) for r in trials(TRIALS, robot.n))
    write_recordings(path, Meta(joints=robot.joints, effort="compensated_torque", rate_hz=RATE), cut)
    return path


def identify(data: Path, out: Path, *more: str) -> dict[str, object]:
    assert main(["identify", "--robot", "lwa4p", "--data", str(data), "--out", str(out), *more]) == 0
    model: dict[str, object] = json.loads(out.read_text())
    return model


def start(*words: str) -> subprocess.Popen[bytes]:
    quiet = subprocess.DEVNULL
    return subprocess.Popen([sys.executable, "-m", "distributed.cli." + words[0], *words[1:]], stdout=quiet, stderr=quiet)


@pytest.fixture
def cluster(tmp_path: Path) -> object:
    file = tmp_path / "scheduler.json"
    scheduler = start("dask_scheduler", "--host", LOOPBACK, "--port", "0", "--no-dashboard", "--scheduler-file", str(file))
    deadline = time.monotonic() + 60
    while not file.exists() or not file.read_text().strip():
        assert time.monotonic() < deadline, "no scheduler within a minute"
        time.sleep(0.1)
    address = json.loads(file.read_text())["address"]
    options = ("--host", LOOPBACK, "--nthreads", "1", "--no-dashboard", "--no-nanny", "--local-directory", str(tmp_path))
    workers = [start("dask_worker", address, *options) for _ in range(2)]
    yield address, workers
    for p in (*workers, scheduler):
        if p.poll() is None:
            os.kill(p.pid, signal.SIGKILL)
        p.wait()


@pytest.mark.slow
def test_two_workers_give_the_same_bits_and_a_killed_one_loses_nothing(
    data: Path, tmp_path: Path, cluster: tuple[str, list[subprocess.Popen[bytes]]], capsys: pytest.CaptureFixture[str]
) -> None:
    address, workers = cluster
    alone = identify(data, tmp_path / "alone.json")
    told = capsys.readouterr().err
    assert [f"{k * TRIALS // 10} of {TRIALS} trials" in told for k in range(1, 11)] == [True] * 10, told
    together = identify(data, tmp_path / "together.json", "--scheduler", address)
    assert "of 6 parts of the campaign from 2 workers" in capsys.readouterr().err
    assert together == alone, "the model must not depend on where it was computed"

    killed = threading.Timer(2.0, lambda: os.kill(workers[0].pid, signal.SIGKILL))
    killed.start()
    survived = identify(data, tmp_path / "survived.json", "--scheduler", address)
    killed.join()
    assert workers[0].wait(timeout=10) != 0
    assert survived == alone


def test_a_missing_scheduler_is_one_sentence(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "m.json"
    words = ["identify", "--robot", "lwa4p", "--data", str(data), "--out", str(out), "--scheduler", "tcp://127.0.0.1:9"]
    assert main(words) == 2
    assert "no Dask scheduler answers" in capsys.readouterr().err
    assert not out.exists()
