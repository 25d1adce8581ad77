"""A process beside the daemon's, which loads all that it will need before anybody knows for which model.

That takes as long as the daemon's own loading. Begun first and assigned later, both are ready at the same time; so nothing is imported
here that would hold up who begins one.
"""

from __future__ import annotations

import multiprocessing as mp
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
    def begin(cls, load: Callable[[], Work], name: str) -> Self:
        """``load``, a function of a module, imports in the other process what its work needs, and gives that."""
        context = mp.get_context("spawn")
        mine, theirs = context.Pipe()
        process = context.Process(target=_run, args=(load, theirs), daemon=True, name=name)
        process.start()
        theirs.close()
        return cls(process, mine)

    @classmethod
    def bounding_stops(cls) -> Self:
        """The process that bounds stops."""
        return cls.begin(_stop_bounds, "stop-bounds")

    def assign(self, *arguments: Any) -> None:
        """Say what it is to work on; once. Raises OSError where it has ended."""
        self.pipe.send(arguments)


def _run(load: Callable[[], Work], pipe: Connection) -> None:
    work = load()
    try:
        arguments = pipe.recv()
    except (EOFError, OSError):  # whoever began it is gone
        return
    work(*arguments, pipe)


def _stop_bounds() -> Work:
    from stopset.monitor.stopworker import work

    return work
