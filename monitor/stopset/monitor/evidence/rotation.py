"""File after file of a recording that never ends, the oldest given up for the newest; a disk that refuses is asked again."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from stopset.monitor.evidence.mcap_file import McapFile

RETRY = 5.0  # [s] before a disk that has refused is asked again


@dataclass(slots=True)
class Rotation:
    """Files ``record-*.mcap`` in ``folder``, of ``file_s`` each; of them at most ``keep_mb`` are kept. ``about``: what holds for all."""

    folder: Path
    file_s: float
    keep_mb: float
    prefix: str
    about: Callable[[], Mapping[str, str]]
    trouble: str = ""
    files: int = 0
    _stream: BinaryIO | None = None
    _file: McapFile | None = None
    _until: float = 0.0
    _begun_ns: int = 0  # the time in the name of the last file
    _not_before: float = field(default=float("-inf"))

    def write(self, what: Callable[[McapFile], None]) -> str:
        """Let ``what`` write into the file of now; what is wrong, "" if nothing: then ``what`` was not done, or not whole."""
        now = time.monotonic()
        if now < self._not_before:
            return self.trouble
        try:
            if self._file is None or now > self._until:
                self._next(now)
            assert self._file is not None and self._stream is not None
            what(self._file)
            self._stream.flush()
            self.trouble = ""
        except OSError as e:
            self._give_up()
            self._not_before = now + RETRY
            self.trouble = f"the recording in {self.folder} stands still ({e}); it goes on when the disk takes it again"
        return self.trouble

    def _next(self, now: float) -> None:
        """Another file; the oldest go until all fit into what may be kept."""
        self.close()
        self.folder.mkdir(parents=True, exist_ok=True)
        old = sorted(self.folder.glob("record-*.mcap"))
        size = sum(p.stat().st_size for p in old)
        while old and size > self.keep_mb * 1e6:
            size -= old[0].stat().st_size
            old.pop(0).unlink()
        self._begun_ns = max(time.time_ns(), self._begun_ns + 1)  # a clock may be set back; names stay in order
        s, ns = divmod(self._begun_ns, 1_000_000_000)
        name = f"record-{time.strftime('%Y%m%dT%H%M%S', time.gmtime(s))}-{ns:09d}.mcap"
        self._stream = (self.folder / name).open("wb")
        self._file = McapFile(self._stream, self.prefix, {**self.about(), "kind": "record"})
        self._until = now + self.file_s
        self.files += 1

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
