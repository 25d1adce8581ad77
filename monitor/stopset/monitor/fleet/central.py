"""One recording of many arms: every event, and what each monitor says of its state, on the disk of whoever listens.

It keeps what the slow keys carry, not the readings of every cycle: those stand beside each daemon. A disk that is slower than
the arms never holds up zenoh: what waits is bounded, the oldest is dropped, and the recording itself says how much is missing.
"""

from __future__ import annotations

import json
import threading
import time
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from stopset.monitor.evidence.mcap_file import WARNING, McapFile, logged
from stopset.monitor.evidence.rotation import Rotation
from stopset.monitor.fleet.fleet import LARGEST, MOST
from stopset.monitor.viewer.words import plain

WAITING = 20_000  # messages; a hundred arms say as many in half a minute
TURN = 0.2  # [s]
TOPICS = {"state/json": "state", "event": "event", "health": "health"}


class _StateWord(msgspec.Struct):
    """What of ``state/json`` says whether it is news."""

    state: str


_state = msgspec.json.Decoder(_StateWord).decode


@dataclass(slots=True)
class Central:
    """``every_s``: a state that is the same as before is written so often. Fed from zenoh's threads; `close` writes what waits."""

    folder: Path
    every_s: float = 1.0
    file_s: float = 3600.0
    keep_mb: float = 10_000.0
    written: int = 0
    lost: int = 0
    garbled: int = 0
    trouble: str = ""
    _last: dict[str, tuple[str, float]] = field(default_factory=dict)  # state and when it was written last, by arm
    _queue: deque[tuple[int, str, str, bytes]] = field(default_factory=deque)
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _ended: threading.Event = field(default_factory=threading.Event)
    _said: int = 0  # of those lost, how many the recording tells
    _files: Rotation = field(init=False)
    _thread: threading.Thread = field(init=False)

    def __post_init__(self) -> None:
        self._files = Rotation(self.folder, self.file_s, self.keep_mb, "fleet", dict)
        self._thread = threading.Thread(target=self._work, daemon=True, name="central")
        self._thread.start()

    @property
    def files(self) -> int:
        """Begun so far."""
        return self._files.files

    @property
    def notice(self) -> str:
        """What somebody should know of the recording; "" if it is whole."""
        gone = f"the recording lacks {self.lost} messages" if self.lost else ""
        return "; ".join(filter(None, (self.trouble, gone)))

    def report(self) -> dict[str, int | str]:
        """For machines."""
        return {"written": self.written, "lost": self.lost, "garbled": self.garbled, "files": self.files, "trouble": self.trouble}

    def take(self, key: str, data: bytes) -> None:
        """A message of an arm on one of the `TOPICS`."""
        arm, _, name = key.partition("/stopset/")
        topic = TOPICS.get(name)
        if topic is None:
            return
        if not self._is_json(data):
            self.garbled += 1
            return
        now = time.monotonic()
        with self._lock:
            if topic == "state" and not self._is_news(arm, data, now):
                return
            if len(self._queue) >= WAITING:
                self._queue.popleft()
                self.lost += 1
            self._queue.append((time.time_ns(), plain(arm), topic, data))

    @staticmethod
    def _is_json(data: bytes) -> bool:
        try:
            return len(data) <= LARGEST and isinstance(json.loads(data), dict)
        except (ValueError, RecursionError):
            return False

    def _is_news(self, arm: str, data: bytes, now: float) -> bool:
        try:
            state = _state(data).state
        except msgspec.MsgspecError:
            state = ""
        before, at = self._last.get(arm, ("", float("-inf")))
        if state == before and now - at < self.every_s:
            return False
        if arm in self._last or len(self._last) < MOST:  # names of strangers do not fill the memory
            self._last[arm] = (state, now)
        return True

    def _work(self) -> None:
        while not self._ended.wait(TURN):
            try:
                self._turn()
            except Exception as e:  # noqa: BLE001 - whatever it is, the overview says it and the recording goes on
                self.trouble = f"the recording failed: {type(e).__name__}: {e}"

    def _turn(self) -> None:
        with self._lock:
            taken, lost = list(self._queue), self.lost
            self._queue.clear()
        if not taken:
            return

        def write(file: McapFile) -> None:
            if lost > self._said:
                t = taken[0][0]
                said = f"{lost - self._said} messages before this one are missing"
                file.add("log", t, logged(t, WARNING, "stopset fleet", said))
            for t, arm, topic, data in taken:
                file.add(topic, t, data, prefix=arm)

        self.trouble = self._files.write(write)
        if self.trouble:
            with self._lock:  # back in front of what came meanwhile, as far as there is room
                room = WAITING - len(self._queue)
                self._queue.extendleft(reversed(taken[-room:] if room else []))
                self.lost += max(0, len(taken) - room)
        else:
            self.written += len(taken)
            self._said = lost

    def close(self) -> None:
        """Write what waits, end the file; what could not be written counts as lost."""
        self._ended.set()
        self._thread.join()
        self._turn()
        self.lost += len(self._queue)
        try:
            self._files.close()
        except OSError as e:
            self.trouble = f"the last file in {self.folder} could not be ended ({e})"
