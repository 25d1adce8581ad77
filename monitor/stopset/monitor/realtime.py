"""What the loop asks of the operating system, and what it has got: first in line, cores of its own, memory that stays."""

from __future__ import annotations

import ctypes
import os
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

TASKS = Path("/proc/self/task")
SHARE = Path("/proc/sys/kernel")  # `sched_rt_runtime_us` of every `sched_rt_period_us`, -1: all
ALL_PAGES = 3  # MCL_CURRENT | MCL_FUTURE
GOT = "set"


@dataclass(frozen=True, slots=True)
class Granted:
    """What was asked for, each ``set`` or why it is not. Published in ``health``."""

    said: dict[str, str]

    @property
    def lacking(self) -> str:
        """All that is not set, in words; empty if nothing is."""
        return "; ".join(f"{what}: {words}" for what, words in self.said.items() if words != GOT)


def claim(*, lock: bool = False, priority: int = 0, cores: tuple[int, ...] = (), begun: tuple[int, ...] = ()) -> Granted:
    """Ask for locked memory, FIFO scheduling of the calling thread with ``priority`` (0: as it is) and ``cores`` (empty: all).

    Threads and processes that come from it are not first in line: the loop must not wait for them. ``begun``: processes that came
    from it before, by their ids; they go to the same cores.
    """
    said: dict[str, str] = {}
    if lock:
        said["memory lock"] = _tried(_lock_memory)
    if cores:
        said[f"cores {', '.join(map(str, cores))}"] = _tried(lambda: _keep_to(cores, (0, *begun)))
    if priority:
        policy, level = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority)
        said[f"FIFO priority {priority}"] = _tried(lambda: os.sched_setscheduler(0, policy, level))
    return Granted(said)


def _keep_to(cores: tuple[int, ...], processes: tuple[int, ...]) -> None:
    for pid in processes:
        os.sched_setaffinity(pid, cores)


def _lock_memory() -> None:
    if ctypes.CDLL(None, use_errno=True).mlockall(ALL_PAGES):
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code))


def _tried(ask: Callable[[], None]) -> str:
    try:
        ask()
    except (OSError, AttributeError) as e:  # not allowed, or not on this system
        return f"refused ({e.strerror if isinstance(e, OSError) else e}); see deploy/systemd/stopset.service"
    return GOT


def first_in_line_share() -> float | None:
    """Which part of a core the system leaves to all that is scheduled FIFO together; None where it does not say."""
    try:
        runtime, period = (int((SHARE / f"sched_rt_{x}_us").read_text()) for x in ("runtime", "period"))
    except (OSError, ValueError):
        return None
    return 1.0 if runtime < 0 else runtime / period


@dataclass(slots=True)
class Waits:
    """How long the loop, and this process's other threads, were ready to run and had no processor.

    The loop may be first in line and late all the same: it waits for Python while another thread has that, and its messages leave by one of
    zenoh's; these have no priority, and whatever else works on their cores comes between.
    """

    _before: dict[str, int] = field(default_factory=dict)  # [ns] by thread

    def since(self) -> dict[str, float | None]:
        """In words of `health`, since it was asked last; of the thread that asks, and of all others together."""
        mine, now = str(threading.get_native_id()), {}
        try:
            for thread in os.listdir(TASKS):  # noqa: PTH208 - Path's objects are for nothing here
                now[thread] = _waited(thread)
        except OSError:  # not on this system
            return {"loop_waited_ms": None, "threads_waited_ms": None, "fifo_share": None}
        grown = {thread: ns - self._before.get(thread, 0) for thread, ns in now.items()}
        self._before = now
        return {
            "loop_waited_ms": grown.get(mine, 0) * 1e-6, "fifo_share": first_in_line_share(),
            "threads_waited_ms": sum(ns for thread, ns in grown.items() if thread != mine) * 1e-6,
        }  # fmt: skip


def _waited(thread: str) -> int:
    try:
        return int((TASKS / thread / "schedstat").read_text().split()[1])
    except (OSError, IndexError, ValueError):  # it has ended, or the kernel does not count
        return 0
