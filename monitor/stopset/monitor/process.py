"""What the monitor draws and reads of the process that it is, in one place, so that a simulator can put its own there."""

from __future__ import annotations

import os
import resource
import secrets
from dataclasses import dataclass, field
from typing import Any, Protocol

from stopset.monitor.realtime import Waits


class Process(Protocol):
    """``boot`` (64 bits): the number of this life, which no other has; ``said``: what it takes of the machine, in words of `health`."""

    def boot(self) -> int: ...
    def said(self) -> dict[str, Any]: ...


@dataclass(slots=True)
class SystemProcess:
    """The one that this code runs in."""

    _waits: Waits = field(default_factory=Waits)

    def boot(self) -> int:
        return secrets.randbits(64)

    def said(self) -> dict[str, Any]:
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        return {"processor": self._waits.since(), "memory_mb": memory, "pid": os.getpid()}
