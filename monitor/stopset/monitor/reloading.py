"""Another model while the loop goes on: read and prepared beside it, taken over between two turns."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from stopset.artifact import Model
from stopset.errors import NotCovered, StopsetError
from stopset.monitor.along import WatchAlong
from stopset.monitor.remaining import Remaining
from stopset.monitor.stopdesk import StopDesk
from stopset.monitor.watch import Watch


@dataclass(frozen=True, slots=True)
class Loaded:
    """A model ready to be watched with."""

    model: Model
    text: bytes  # of its file
    watch: Watch | WatchAlong
    desk: StopDesk
    remaining: Remaining


@dataclass(slots=True)
class Reloading:
    """``load``: gives the model anew, raises `StopsetError` if that cannot be used; ``prepare`` makes it ready."""

    load: Callable[[], Model] | None
    prepare: Callable[[Model], Loaded]
    asked: bool = False  # set by whoever wants it, from wherever
    _answers: queue.SimpleQueue[Loaded | str] = field(default_factory=queue.SimpleQueue)
    _working: bool = False

    def turn(self, joints: tuple[str, ...]) -> Loaded | str | None:
        """Begin if it was asked for; a model of the same ``joints`` that has become ready, or why there is none."""
        if self.asked and not self._working:  # asked for once more while one is read: the file may be another by now
            self.asked = False
            self._begin(joints)
        if not self._working or self._answers.empty():
            return None
        self._working = False
        return self._answers.get_nowait()

    def _begin(self, joints: tuple[str, ...]) -> None:
        load = self.load
        if load is None:
            return
        self._working = True

        def work() -> None:
            try:
                model = load()
                if model.joints != joints:
                    raise NotCovered(f"the new model has the joints {', '.join(model.joints)}, this arm {', '.join(joints)}")
                self._answers.put(self.prepare(model))
            except (StopsetError, OSError) as e:
                self._answers.put(str(e))
            except Exception as e:  # noqa: BLE001 - a broken model must not end the watch over the arm
                self._answers.put(f"{type(e).__name__}: {e}")

        try:
            threading.Thread(target=work, daemon=True, name="reload").start()
        except RuntimeError as e:  # the machine has no memory for it
            self._answers.put(f"the model is not read anew: {e}; the one before is watched with, ask again")


def end_beside(*parts: Any) -> None:
    """Close what waits for a process of its own, beside the loop."""
    for part in parts:
        threading.Thread(target=part.close, daemon=True, name="old").start()
