"""A bus that is opened beside the loop: whatever an adapter or a connection waits for, the heartbeat does not."""

from __future__ import annotations

import gc
import queue
import threading
from collections.abc import Callable
from dataclasses import dataclass, field

from stopset.monitor.source import SampleSource


@dataclass(slots=True)
class Opening:
    """``begin`` gives an open source, or raises why there is none; it may take as long as it likes."""

    begin: Callable[[], SampleSource]
    _answers: queue.SimpleQueue[SampleSource | Exception] = field(default_factory=queue.SimpleQueue)
    _opening: bool = False

    def turn(self) -> SampleSource | None:
        """Ask for a source, unless that was done; it, or what was raised, once it is there; None before."""
        if not self._opening:
            threading.Thread(target=self._work, daemon=True, name="opening").start()  # which a machine without memory refuses
            self._opening = True
        if self._answers.empty():
            return None
        self._opening, answer = False, self._answers.get_nowait()
        if not isinstance(answer, Exception):
            return answer
        try:
            raise answer
        finally:
            del answer  # which would hold this frame, and that it: nobody collects circles while the loop runs

    def _work(self) -> None:
        gc.collect()  # what a driver has left of the try before: python-can some 40 objects, and a bus may be away for days
        try:
            self._answers.put(self.begin())
        except Exception as e:  # noqa: BLE001 - it is raised where the source was asked for
            self._answers.put(e)
