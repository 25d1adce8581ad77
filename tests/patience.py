"""Time as this machine has it for us: beside busy neighbours a second of theirs is not one of ours."""

from __future__ import annotations

import os
import threading
import time
from bisect import bisect_left
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self

LOAD = Path("/proc/loadavg")
TICK = 0.02  # [s]


def share() -> float:
    """Which part of a processor one of the processes that want to run now gets."""
    try:
        wanting = int(LOAD.read_text().split()[3].partition("/")[0])
    except (OSError, ValueError, IndexError):  # not on this system
        return 1.0
    return min(1.0, (os.cpu_count() or 1) / max(1, wanting))


def wait(what: Callable[[], Any], seconds: float = 60.0) -> Any:
    """Until ``what`` holds, which is given back; or what it is after so many seconds of a machine that has nothing else to do."""
    left, before = seconds, time.monotonic()
    while not (found := what()):
        time.sleep(TICK)
        now = time.monotonic()
        left -= (now - before) * share()
        before = now
        if left < 0.0:
            return what()
    return found


def rest(seconds: float) -> None:
    """Let the others go on for so many seconds of a machine that has nothing else to do."""
    wait(lambda: False, seconds)


class Granted:
    """Looks, while its block lasts, how much of the time was ours."""

    def __init__(self) -> None:
        self.at, self.ours = [time.monotonic()], [0.0]
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._look, daemon=True)

    def _look(self) -> None:
        while not self._end.wait(TICK):
            now = time.monotonic()
            self.ours.append(self.ours[-1] + (now - self.at[-1]) * share())
            self.at.append(now)

    def _until(self, t: float) -> float:
        k = bisect_left(self.at, t)
        if not 0 < k < len(self.at):  # before the block or after the last look: all of it
            return self.ours[max(0, k - 1)] + t - self.at[max(0, k - 1)]
        part = (t - self.at[k - 1]) / (self.at[k] - self.at[k - 1])
        return self.ours[k - 1] + part * (self.ours[k] - self.ours[k - 1])

    def between(self, first: float, last: float) -> float:
        """Seconds that were ours between two moments [s, monotonic]."""
        return self._until(last) - self._until(first)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join()
