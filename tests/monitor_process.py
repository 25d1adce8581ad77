"""Run the daemon and the replay as processes of their own, and hear them from a third: this one."""

from __future__ import annotations

import contextlib
import json
import os
import secrets
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from patience import wait
from stopset.artifact import load_model
from stopset.monitor.authentication import Keys
from stopset.monitor.config import load_config
from stopset.monitor.consumer import MS, Consumer, Expected, Fault
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


def stopset(*words: str, **more: str) -> subprocess.Popen[str]:
    """A command as a process; ``more`` goes into its environment."""
    return subprocess.Popen(
        [sys.executable, "-m", "stopset.cli.main", *words],
        env={**environment(), **more}, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip


@contextlib.contextmanager
def running(*words: str, **more: str) -> Iterator[subprocess.Popen[str]]:
    process = stopset(*words, **more)
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


def expected(config: Path, keys: Keys | None = None) -> Expected:
    """What a consumer of the monitor of ``config`` is told."""
    c = load_config(config)
    return Expected.of(c.data_id, load_model(c.model).sha256, c.sha256, keys)


class Reading:
    """A consumer at work: ``said`` holds (time, state, doubt) of every look, once per few milliseconds."""

    def __init__(self, ask: Callable[[bytes], None]) -> None:
        self.said: list[tuple[float, State, int]] = [(time.monotonic(), State.FAULT, int(Fault.NO_MESSAGE))]
        self.ask = ask
        self.on = True
        self.thread = threading.Thread(target=self.work, daemon=True)

    def take(self, data: bytes) -> None:
        raise NotImplementedError

    def work(self) -> None:
        raise NotImplementedError

    @property
    def now(self) -> State:
        return self.said[-1][1]

    def since(self, t: float) -> set[State]:
        """States believed at or after ``t``, that in force then included."""
        before = [s for at, s, _ in self.said if at < t]
        return {*before[-1:], *(s for at, s, _ in self.said if at >= t)}

    def faults(self, t: float) -> set[Fault]:
        """Faults told after ``t``."""
        return {Fault(d) for at, _, d in self.said if at >= t and d}

    def close(self) -> None:
        self.on = False
        self.thread.join(timeout=5)


class PythonReading(Reading):
    """`stopset.monitor.consumer.Consumer` in a thread."""

    def __init__(self, ask: Callable[[bytes], None], expect: Expected, watchdog_ms: int) -> None:
        super().__init__(ask)
        self.consumer, self.lock = Consumer(expect, watchdog_ms * MS), threading.Lock()
        self.thread.start()

    def take(self, data: bytes) -> None:
        with self.lock:
            self.consumer.take(data, time.monotonic_ns())

    def work(self) -> None:
        while self.on:
            with self.lock:
                nonce = self.consumer.challenge(time.monotonic_ns(), secrets.randbits(64))
                state = self.consumer.state(time.monotonic_ns())
                fault = int(self.consumer.why)
            if nonce:
                self.ask(nonce)
            if (state, fault) != self.said[-1][1:]:
                self.said.append((time.monotonic(), state, fault))
            time.sleep(0.002)

    @property
    def refused(self) -> int:
        return self.consumer.rejected

    @property
    def lost(self) -> int:
        return self.consumer.lost


class CReading(Reading):
    """``deploy/plc/reader.c`` as a process."""

    def __init__(self, ask: Callable[[bytes], None], expect: Expected, watchdog_ms: int, binary: Path) -> None:
        super().__init__(ask)
        keys = [w for k in expect.keys.by_id.values() for w in (str(k.key_id), k.secret.hex())] if expect.keys else []
        words = [str(expect.data_id), f"{expect.model_hash:016x}", f"{expect.config_hash:016x}", str(watchdog_ms), *keys]
        self.process = subprocess.Popen([str(binary), *words], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self.last: dict[str, str] = {}
        self.thread.start()

    def take(self, data: bytes) -> None:
        assert self.process.stdin is not None
        with contextlib.suppress(BrokenPipeError, ValueError):
            self.process.stdin.write(len(data).to_bytes(2, "little") + data)
            self.process.stdin.flush()

    def work(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            words = line.decode().split()
            if words[0] == "nonce":
                self.ask(int(words[1], 16).to_bytes(8, "little"))
            else:
                self.last = dict(w.split("=") for w in words)
                self.said.append((time.monotonic(), State(int(self.last["state"], 16)), int(self.last["why"])))

    @property
    def refused(self) -> int:
        return int(self.last.get("refused", 0))

    @property
    def lost(self) -> int:
        return int(self.last.get("lost", 0))

    def close(self) -> None:
        assert self.process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self.process.stdin.close()
        self.process.wait(timeout=5)
        super().close()


def compiled(folder: Path, *source: str | Path, words: tuple[str, ...] = ()) -> Path:
    """A C program or library of the test; skips where there is no compiler."""
    if shutil.which("cc") is None:
        pytest.skip("no C compiler here")
    binary = folder / Path(source[0]).stem
    plc = Path(__file__).resolve().parents[1] / "deploy/plc"
    flags = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-Wno-unused-function", "-I", str(plc)]
    subprocess.run(["cc", *flags, *words, *map(str, source), "-o", str(binary)], check=True)
    return binary


def listens(port: int) -> bool:
    """Whether somebody does."""
    try:
        with socket.create_connection(("127.0.0.1", port), timeout=1):
            return True
    except OSError:
        return False


class Ear:
    """A zenoh subscriber to everything a monitor publishes."""

    def __init__(self, port: int) -> None:
        assert wait(lambda: listens(port)), "the monitor never listened"
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

    def wait(self, what: Any, seconds: float = 60.0) -> Any:
        return wait(what, seconds)

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
