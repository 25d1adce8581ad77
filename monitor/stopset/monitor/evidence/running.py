"""The continuous recording: file after file of everything that is read and said, the oldest given up for the newest."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from stopset.monitor.evidence.bundle import AT_ONCE
from stopset.monitor.evidence.dynamics import Dynamics
from stopset.monitor.evidence.mcap_file import McapFile
from stopset.monitor.evidence.rows import messages
from stopset.monitor.evidence.trace import Trace

if TYPE_CHECKING:
    from stopset.monitor.config import Records

TUBE_AGE = 0.1  # [s] of the prediction that is drawn
RETRY = 5.0  # [s] before a disk that has refused is asked again


@dataclass(slots=True)
class Running:
    """Call `turn` a few times a second. Only files of its own are given up, never a violation's."""

    folder: Path
    settings: Records
    n: int
    about: Callable[[], Mapping[str, str]]
    done: int = 0  # rows of the trace that are written
    lost: int = 0  # rows that were overwritten before the disk took them
    trouble: str = ""
    _stream: BinaryIO | None = None
    _file: McapFile | None = None
    _until: float = 0.0
    _not_before: float = field(default=float("-inf"))

    def turn(
        self, trace: Trace, words: list[tuple[str, int, bytes]], model: Dynamics | None, joints: tuple[str, ...],
        pause: Callable[[], None],
    ) -> str:  # fmt: skip
        """Write what is new; returns what is wrong, empty if nothing."""
        now = time.monotonic()
        if now < self._not_before:
            return self.trouble
        try:
            self._write(trace, words, model, joints, pause, now)
            self.trouble = ""
        except OSError as e:
            self._give_up()
            self._not_before = now + RETRY
            self.trouble = f"the recording in {self.folder} stands still ({e}); it goes on when the disk takes it again"
        return self.trouble

    def _write(
        self, trace: Trace, words: list[tuple[str, int, bytes]], model: Dynamics | None, joints: tuple[str, ...],
        pause: Callable[[], None], now: float,
    ) -> None:  # fmt: skip
        if self._file is None or now > self._until:
            self._next(now)
        assert self._file is not None and self._stream is not None
        head, age = trace.head, 1 if model is None else min(max(1, round(TUBE_AGE / model.dt)), len(model.lo) - 1)
        oldest = max(0, head - trace.capacity + 1)
        self.lost += max(0, oldest - self.done)
        first = max(self.done, oldest)
        w = trace.window(first - age, head)
        for k, (topic, t, message) in enumerate(messages(w, len(w) - (head - first), model, joints, age)):
            self._file.add(topic, t, message)
            if k % AT_ONCE == 0:
                pause()
        for name, t_ns, data in words:
            self._file.add(name, t_ns, data)
        self.done = head
        self._stream.flush()

    def _next(self, now: float) -> None:
        """Another file; the oldest go until all fit into what may be kept."""
        self.close()
        self.folder.mkdir(parents=True, exist_ok=True)
        old = sorted(self.folder.glob("record-*.mcap"))
        size = sum(p.stat().st_size for p in old)
        while old and size > self.settings.keep_mb * 1e6:
            size -= old[0].stat().st_size
            old.pop(0).unlink()
        name = f"record-{time.strftime('%Y%m%dT%H%M%S', time.gmtime())}-{time.time_ns() % 1_000_000_000:09d}.mcap"
        self._stream = (self.folder / name).open("wb")
        self._file = McapFile(self._stream, "stopset", {**self.about(), "kind": "record"})
        self._until = now + self.settings.file_s

    def _give_up(self) -> None:
        stream, self._file, self._stream = self._stream, None, None
        if stream is not None:
            with contextlib.suppress(OSError):  # it is the disk that has failed
                stream.close()

    def close(self) -> None:
        """End the file with its index."""
        if self._file is not None and self._stream is not None:
            try:
                self._file.finish()
            except OSError:
                self._give_up()
                raise
            self._give_up()
