"""What the loop asks of the operating system, and what it has got: first in line, cores of its own, memory that stays."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable
from dataclasses import dataclass

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
