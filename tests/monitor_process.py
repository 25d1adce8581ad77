"""Run the daemon and the replay as processes of their own, and hear them from a third: this one."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from stopset.monitor.layout import State, unpack
from stopset.monitor.links.zenoh_link import ZenohLink

PREFIX = "site/cell/arm/stopset"
DATA_ID = 1001


def free_port() -> int:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


def environment() -> dict[str, str]:
    roots = Path(__file__).resolve().parents[1]
    paths = [str(roots / p) for p in ("model", "offline", "monitor", "fmu")]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def stopset(*words: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "stopset.cli.main", *words],
        env=environment(), text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip


@contextlib.contextmanager
def running(*words: str) -> Iterator[subprocess.Popen[str]]:
    process = stopset(*words)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGCONT)
            process.terminate()
        try:
            process.communicate(timeout=10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()


class Ear:
    """A zenoh subscriber to everything a monitor publishes."""

    def __init__(self, port: int) -> None:
        end = time.monotonic() + 20
        while True:  # until the monitor listens
            try:
                with socket.create_connection(("127.0.0.1", port), timeout=1):
                    break
            except OSError:
                if time.monotonic() > end:
                    raise
                time.sleep(0.05)
        self.link = ZenohLink(PREFIX, mode="client", connect=[f"tcp/127.0.0.1:{port}"])
        self.raw: list[bytes] = []
        self.twins: list[dict[str, Any]] = []
        self.events: list[dict[str, Any]] = []
        self.echoes: list[dict[str, Any]] = []
        self.link.subscribe("state", lambda _, d: self.raw.append(d))
        self.link.subscribe("state/json", lambda _, d: self.twins.append(json.loads(d)))
        self.link.subscribe("event", lambda _, d: self.events.append(json.loads(d)))
        self.link.subscribe("echo", lambda _, d: self.echoes.append(json.loads(d)))

    @property
    def states(self) -> list[State]:
        return [State(unpack(d)["state"]) for d in list(self.raw)]

    def wait(self, what: Any, seconds: float = 20.0) -> bool:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if what():
                return True
            time.sleep(0.02)
        return bool(what())

    def __enter__(self) -> Ear:
        return self

    def __exit__(self, *_: object) -> None:
        self.link.close()


def write_config(folder: Path, model: Path, bus: str, port: int, more: str = "", publish: str = "valid_for_ms = 1000") -> Path:
    """A configuration for a machine that is shared with everything else: data may be a second old."""
    path = folder / "monitor.toml"
    path.write_text(
        f'model = "{model}"\ndata_id = {DATA_ID}\n{more}\n{bus}\n[zenoh]\nlisten = ["tcp/127.0.0.1:{port}"]\n[publish]\n{publish}\n',
        encoding="utf-8",
    )
    return path
