"""The process that does the jobs of the workbench: a page is answered while it runs, and whatever becomes of it."""

from __future__ import annotations

import multiprocessing as mp
import signal
import threading
from collections.abc import Callable
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess

from stopset.offline.workbench.jobs import Ended, Export, Message, Order
from stopset.offline.workbench.work import serve


class Worker:
    """One process that does orders one after another; begun when needed, and anew after it was stopped or died."""

    def __init__(self, export: Export | None = None) -> None:
        self._export = export
        self._process: SpawnProcess | None = None
        self._line: Connection | None = None
        self._lock = threading.Lock()

    def begin(self) -> Connection:
        """The line to the running process."""
        with self._lock:
            if self._line is not None and self._process is not None and self._process.is_alive():
                return self._line
            context = mp.get_context("spawn")
            self._line, far = context.Pipe()
            self._process = context.Process(target=serve, args=(far, self._export), daemon=True, name="workbench")
            self._process.start()
            far.close()
            return self._line

    def do(self, order: Order, take: Callable[[Message], None], given_up: Callable[[], bool]) -> Ended:
        """Have it done; ``take`` is given what comes on the way; ``given_up``: whether it was stopped before it began."""
        well = False
        try:
            line = self.begin()
            if given_up():
                return Ended()
            line.send(order)
            while not isinstance(message := line.recv(), Ended):
                take(message)
            well = True
            return message
        except (EOFError, OSError):
            code = self._code()
            how = f"by signal {signal.Signals(-code).name}" if code is not None and code < 0 else f"with exit code {code}"
            return Ended(
                f"the process that did it ended {how} before its answer; expected memory and time enough: choose fewer recordings, "
                "or start it again"
            )
        finally:
            if not well:
                self.stop()

    def _code(self) -> int | None:
        process = self._process
        if process is None:
            return None
        process.join(2.0)
        return process.exitcode

    def stop(self) -> None:
        """End the process at once; its order is given up."""
        with self._lock:  # not while it is being started
            process = self._process
        if process is not None:
            process.kill()
            process.join()
