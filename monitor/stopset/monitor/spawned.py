"""A process beside the daemon's, which loads all that it will need before anybody knows for which model.

Begun first and assigned later, both are ready at the same time; so nothing is imported here that would hold up who begins one. Who has no
threads yet, and has loaded already what both need, is copied with it, which is for nothing; later ones load it again.
"""

from __future__ import annotations

import multiprocessing as mp
import sys
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, Self

Work = Callable[..., None]  # called with what `Spawned.assign` sends and the process's end of the pipe


@dataclass(frozen=True, slots=True)
class Spawned:
    """The process, and this end of its pipe."""

    process: Any
    pipe: Connection

    @classmethod
    def begin(cls, load: Callable[[], Work], name: str, *, copied: bool = False) -> Self:
        """``load``, a function of a module, imports in the other process what its work needs, and gives that.

        ``copied``: with all that this process has loaded; only before it has any threads.
        """
        forked = copied and sys.platform == "linux"
        context: Any = mp.get_context("fork" if forked else "spawn")
        mine, theirs = context.Pipe()
        process = context.Process(target=_run, args=(load, theirs, mine if forked else None), daemon=True, name=name)
        process.start()
        theirs.close()
        return cls(process, mine)

    @classmethod
    def bounding_stops(cls, *, copied: bool = False) -> Self:
        """The process that bounds stops."""
        return cls.begin(_stop_bounds, "stop-bounds", copied=copied)

    def assign(self, *arguments: Any) -> None:
        """Say what it is to work on; once. Raises OSError where it has ended."""
        self.pipe.send(arguments)


def _run(load: Callable[[], Work], pipe: Connection, copied: Connection | None) -> None:
    """``copied``: the other end, which came along and would keep the pipe from ending with who began this."""
    if copied is not None:
        copied.close()
    work = load()
    try:
        arguments = pipe.recv()
    except (EOFError, OSError):  # whoever began it is gone
        return
    work(*arguments, pipe)


def _stop_bounds() -> Work:
    from stopset.monitor.stopworker import work

    return work
