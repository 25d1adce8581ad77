"""The same identification on a cluster of two worker processes: identical model, also when a worker is killed on the way."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from stopset.cli.main import main

pytest.importorskip("distributed")
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from campaign import RATE, trials

from stopset.offline.description import load_robot
from stopset.recording import Meta, write_recordings
from synthetic import names, recordings, save_trials, urdf

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
    deadline = time.monotonic() + 600
    while not file.exists() or not file.read_text().strip():
        assert time.monotonic() < deadline, "no scheduler within ten minutes"
        time.sleep(0.1)
    address = json.loads(file.read_text())["address"]
    options = ("--host", LOOPBACK, "--nthreads", "1", "--no-dashboard", "--no-nanny", "--local-directory", str(tmp_path))
    workers = [start("dask_worker", address, *options) for _ in range(2)]
    from distributed import Client

    with Client(address) as client:  # a busy machine is slow to start them
        client.wait_for_workers(2, timeout=600)
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
    reported = capsys.readouterr().err
    assert [f"{k * TRIALS // 10} of {TRIALS} trials" in reported for k in range(1, 11)] == [True] * 10, reported
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


def arm_folders(root: Path, count: int) -> Path:
    """So many small arms, each of its own inertia, one folder each."""
    for k in range(count):
        folder = root / f"arm{k:02d}"
        (folder / "later").mkdir(parents=True)
        (folder / "robot.urdf").write_text(urdf(names(2)))
        for place, seed in ((folder, 1), (folder / "later", 2)):
            save_trials(place / "rec.parquet", recordings((2.0 + 0.05 * k, 0.7), (9.0, 4.0), seed=seed), names(2))
    return root


@pytest.mark.slow
def test_many_arms_with_one_command_are_each_as_alone_though_a_worker_is_killed(
    tmp_path: Path, cluster: tuple[str, list[subprocess.Popen[bytes]]], capsys: pytest.CaptureFixture[str]
) -> None:
    address, workers = cluster
    fleet, out = arm_folders(tmp_path / "fleet", 8), tmp_path / "out"
    (fleet / "arm05" / "rec.parquet").write_bytes(b"no recording")
    killed = threading.Timer(6.0, lambda: os.kill(workers[0].pid, signal.SIGKILL))
    killed.start()
    words = ["identify-fleet", str(fleet), "--out", str(out), "--scheduler", address]
    assert main([*words, "--json", str(tmp_path / "all.json"), "--report", str(tmp_path / "all.html")]) == 1
    killed.join()
    assert workers[0].wait(timeout=10) != 0
    reported = capsys.readouterr().out
    assert "7 of 8 arms identified and diagnosed" in reported and "arm05  not done:" in reported and "expected" in reported
    rows = {r["name"]: r for r in json.loads((tmp_path / "all.json").read_text())}
    assert len(rows) == 8 and [n for n, r in rows.items() if r["error"]] == ["arm05"]
    assert not (out / "arm05.model.json").exists() and "arm05" in (tmp_path / "all.html").read_text()
    for k in (0, 7):
        name, alone, diagnosis = f"arm{k:02d}", tmp_path / "alone.json", tmp_path / "diagnosis.json"
        folder = fleet / name
        words = ["--robot", str(folder / "robot.urdf"), "--data", str(folder / "rec.parquet"), "--quiet", "--accept-wide"]
        assert main(["identify", *words, "--out", str(alone)]) == 0
        assert (out / f"{name}.model.json").read_bytes() == alone.read_bytes()
        assert (
            main(["diagnose", str(alone), "--data", str(folder / "later/rec.parquet"), "--quiet", "--json", str(diagnosis)]) == 0
        )
        assert (out / f"{name}.diagnosis.json").read_bytes() == diagnosis.read_bytes()


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda d: None, "is no folder"), (lambda d: d.mkdir(), "holds no arm"),
        (lambda d: ((d / "a").mkdir(parents=True), (d / "a/robot.urdf").write_text("<robot/>")), "no recording"),
        (lambda d: (arm_folders(d, 1), (d.parent / "out").write_text("")), "is a file"),
    ],
)  # fmt: skip
def test_a_fleet_that_is_none_is_a_sentence(
    tmp_path: Path, spoil: Callable[[Path], object], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    spoil(tmp_path / "fleet")
    assert main(["identify-fleet", str(tmp_path / "fleet"), "--out", str(tmp_path / "out")]) == 2
    reported = capsys.readouterr().err
    assert said in reported and "expected" in reported
