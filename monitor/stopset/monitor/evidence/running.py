"""The continuous recording: everything that is read and said."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from stopset.monitor.evidence.bundle import AT_ONCE
from stopset.monitor.evidence.dynamics import Dynamics
from stopset.monitor.evidence.mcap_file import McapFile
from stopset.monitor.evidence.rotation import Rotation
from stopset.monitor.evidence.rows import messages
from stopset.monitor.evidence.trace import Trace

if TYPE_CHECKING:
    from stopset.monitor.config import Records

TUBE_AGE = 0.1  # [s] of the prediction that is drawn


@dataclass(slots=True)
class Running:
    """Call `turn` a few times a second. Only files of its own are given up, never a violation's."""

    folder: Path
    settings: Records
    n: int
    about: Callable[[], Mapping[str, str]]
    done: int = 0  # rows of the trace that are written
    lost: int = 0  # rows that were overwritten before the disk took them
    _files: Rotation = field(init=False)

    def __post_init__(self) -> None:
        self._files = Rotation(self.folder, self.settings.file_s, self.settings.keep_mb, "stopset", self.about)

    def turn(
        self, trace: Trace, words: list[tuple[str, int, bytes]], model: Dynamics | None, joints: tuple[str, ...],
        pause: Callable[[], None],
    ) -> str:  # fmt: skip
        """Write what is new; returns what is wrong, empty if nothing."""
        return self._files.write(lambda file: self._write(file, trace, words, model, joints, pause))

    def _write(
        self, file: McapFile, trace: Trace, words: list[tuple[str, int, bytes]], model: Dynamics | None,
        joints: tuple[str, ...], pause: Callable[[], None],
    ) -> None:  # fmt: skip
        head, age = trace.head, 1 if model is None else min(max(1, round(TUBE_AGE / model.dt)), len(model.lo) - 1)
        oldest = max(0, head - trace.capacity + 1)
        self.lost += max(0, oldest - self.done)
        first = max(self.done, oldest)
        w = trace.window(first - age, head)
        for k, (topic, t, message) in enumerate(messages(w, len(w) - (head - first), model, joints, age)):
            file.add(topic, t, message)
            if k % AT_ONCE == 0:
                pause()
        for name, t_ns, data in words:
            file.add(name, t_ns, data)
        self.done = head

    def close(self) -> None:
        """End the file with its index."""
        self._files.close()
