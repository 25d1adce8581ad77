"""Waits that count only the time this machine has for us: beside busy neighbours a second of theirs is not one of ours."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

LOAD = Path("/proc/loadavg")
TICK = 0.02  # [s]


def share() -> float:
    """Which part of a processor one of the processes that want to run now gets."""
    try:
        wanting = int(LOAD.read_text().split()[3].partition("/")[0])
    except (OSError, ValueError, IndexError):  # not on this system
        return 1.0
    return min(1.0, (os.cpu_count() or 1) / max(1, wanting))


def wait(what: Callable[[], Any], seconds: float = 60.0) -> bool:
    """Until ``what`` holds; whether it did within so many seconds of a machine that has nothing else to do."""
    left, before = seconds, time.monotonic()
    while not what():
        time.sleep(TICK)
        now = time.monotonic()
        left -= (now - before) * share()
        before = now
        if left < 0.0:
            return bool(what())
    return True
