"""The times the monitor goes by, in one place, so that a simulator can put its own there."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """``monotonic`` [s] for what has passed, ``time_ns`` since the epoch for what is stamped, ``sleep`` [s]."""

    def monotonic(self) -> float: ...
    def time_ns(self) -> int: ...
    def sleep(self, seconds: float) -> None: ...


def own_ns() -> int:
    """[ns] a consumer's clock, which is never set and goes on while the machine sleeps: what waited for it to wake is old."""
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME) if hasattr(time, "CLOCK_BOOTTIME") else time.monotonic_ns()


class SystemClock:
    """The machine's own."""

    monotonic = staticmethod(time.monotonic)
    time_ns = staticmethod(time.time_ns)
    sleep = staticmethod(time.sleep)
