"""A process beside the daemon's, which loads all that it will need before anybody knows for which model.

That takes as long as the daemon's own loading. Begun first and assigned later, both are ready at the same time; so nothing is imported
here that would hold up who begins one.
"""

from __future__ import annotations

import importlib
import multiprocessing as mp
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, Self

STOP_BOUNDS = ("stopset.monitor.stopworker", "stop-bounds")  # see `Spawned.begin`


@dataclass(frozen=True, slots=True)
class Spawned:
    """The process, and this end of its pipe."""

    process: Any
    pipe: Connection

    @classmethod
    def begin(cls, module: str, name: str) -> Self:
        """``module`` has a function ``work``, which is called with what `assign` sends and the other end of the pipe."""
        context = mp.get_context("spawn")
        mine, theirs = context.Pipe()
        process = context.Process(target=_run, args=(module, theirs), daemon=True, name=name)
        process.start()
        theirs.close()
        return cls(process, mine)

    def assign(self, *arguments: Any) -> None:
        """Say what it is to work on; once. Raises OSError where it has ended."""
        self.pipe.send(arguments)


def _run(module: str, pipe: Connection) -> None:
    work = importlib.import_module(module).work
    try:
        arguments = pipe.recv()
    except (EOFError, OSError):  # whoever began it is gone
        return
    work(*arguments, pipe)
