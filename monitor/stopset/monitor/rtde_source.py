"""Samples of a Universal Robots controller, heard over its Real-Time Data Exchange."""

from __future__ import annotations

import contextlib
import threading
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from stopset.errors import BusError
from stopset.monitor.clock import Clock, SystemClock
from stopset.monitor.config import Rtde
from stopset.monitor.grid import Cycles
from stopset.monitor.links.rtde_client import RtdeClient, Values
from stopset.monitor.sample import Quantum, Sample
from stopset.monitor.source import BACKLOG, GAP

RUNNING = 7  # robot_mode: power is on, the brakes are open
NORMAL = (1, 2)  # safety_status: normal, reduced
LEAK = 1e-3  # [s/s] the two clocks drift apart no faster
AGAIN = 0.5  # [s] between two tries to connect
SILENCE = 1.0  # [s] of a controller, then it is called again
WANTED = ("timestamp", "actual_q", "actual_qd", "joint_temperatures", "robot_mode", "safety_status")


@dataclass(slots=True)
class RtdeSource:
    """See `stopset.monitor.source.SampleSource`; a thread calls the controller, again and again where it must.

    ``oldest_s``: samples older than this are dropped and counted while newer ones wait.
    """

    config: Rtde
    oldest_s: float = float("inf")
    clock: Clock = field(default_factory=SystemClock)
    quantum: Quantum = field(default_factory=lambda: Quantum.none(6))
    received: int = 0
    connected: int = 0
    missed: int = 0
    dropped: int = 0
    _said: deque[str] = field(default_factory=lambda: deque(maxlen=10))
    _waiting: deque[tuple[int, float, Values]] = field(default_factory=deque)  # connection, when it came [s], what
    _there: threading.Semaphore = field(default_factory=lambda: threading.Semaphore(0))
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _closed: threading.Event = field(default_factory=threading.Event)
    _thread: threading.Thread = field(init=False)
    _client: RtdeClient | None = None
    _cycles: Cycles = field(init=False)
    _of: int = 0  # connection of the last sample
    _k: int = 0
    _shift: float = float("inf")  # [s] from the controller's clock to this one, by the least delay seen
    _shifted: float = 0.0

    def __post_init__(self) -> None:
        self._cycles = Cycles(self.config.cycle_s)
        self._waiting = deque(maxlen=max(BACKLOG, round(min(self.oldest_s, 1.0) / self.config.cycle_s)))
        self._thread = threading.Thread(target=self._listen, daemon=True, name="rtde")
        self._thread.start()

    def _listen(self) -> None:
        c, before = self.config, ""
        while not self._closed.is_set():
            try:
                self._client = client = RtdeClient((c.host, c.port), (*WANTED, c.torque), 1.0 / c.cycle_s)
                self.connected += 1
                with contextlib.closing(client):
                    for row in client.rows(SILENCE):
                        if self._closed.is_set():
                            break
                        before = ""
                        self._take(row)
                        while client.said:
                            self._said.append(f"the controller says: {client.said.pop(0)}")
            except BusError as e:
                if str(e) != before and not self._closed.is_set():
                    self._said.append(str(e))
                before = str(e)
            self._closed.wait(AGAIN)

    def _take(self, row: Values) -> None:
        with self._lock:
            full = len(self._waiting) == self._waiting.maxlen
            self._waiting.append((self.connected, self.clock.time_ns() * 1e-9, row))
        self.received, self.dropped = self.received + 1, self.dropped + full
        if not full:
            self._there.release()

    def next(self, timeout: float) -> Sample | None:
        """Waits for a sample if none is there."""
        while self._there.acquire(timeout=timeout):
            with self._lock:
                connection, came, row = self._waiting.popleft()
            sample = self._sample(connection, came, row)
            if sample is None:
                return None
            if self.clock.time_ns() * 1e-9 - sample.t <= self.oldest_s or not self._waiting:
                return sample
            self.dropped += 1
        return None

    def _sample(self, connection: int, came: float, row: Values) -> Sample | None:
        """None for one whose place in time cannot be told."""
        stamp = row["timestamp"][0]
        if not 0.0 <= stamp < 1e9:
            self._said.append(f"the controller's time is {stamp}; expected seconds since its start")
            return None
        if connection != self._of:  # it may have been started anew, and its clock with it
            self._of, self._shift, self._cycles = connection, float("inf"), Cycles(self.config.cycle_s)
            self._k += GAP
        drifted = self._shift + LEAK * max(0.0, came - self._shifted)
        self._shift, self._shifted = min(drifted, came - stamp), came
        found = self._cycles.step(round(stamp * 1e9))
        if found is None:
            self._said.append("a package's time lies far from its cycle, or one was lost: left out")
            return None
        whole, off = found
        whole = whole or GAP
        self.missed += max(whole - 1, 0) if whole != GAP else 1
        self._k += whole
        tau = np.array(row[self.config.torque])
        if self.config.torque_constant:
            tau = tau * np.array(self.config.torque_constant)
        mode, status = int(row["robot_mode"][0]), int(row["safety_status"][0])
        fault = "" if status in NORMAL else f"the controller's safety status is {status}; expected normal (1) or reduced (2)"
        return Sample(
            self._k, stamp + self._shift, np.array(row["actual_q"]), np.array(row["actual_qd"]), tau,
            np.array(row["joint_temperatures"]), mode == RUNNING, fault, off=off, place_error=self._cycles.place_error,
        )  # fmt: skip

    def counters(self) -> dict[str, int]:
        return {"packages": self.received, "connections": self.connected, "missed_cycles": self.missed, "dropped": self.dropped}

    def complaints(self) -> list[str]:
        said: list[str] = []
        while self._said:
            said.append(self._said.popleft())
        return said

    def heard(self, first: float, last: float) -> list[tuple[float, int, bytes]]:
        return []

    def close(self) -> None:
        """Hang up; the thread ends with its connection."""
        self._closed.set()
        if self._client is not None:
            self._client.close()
        self._thread.join(timeout=2.0)
