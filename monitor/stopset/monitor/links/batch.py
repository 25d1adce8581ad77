"""Frames as they come from a bus, several at a time, in memory that is there already."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

from stopset.core.library import ffi

SIZE = 128  # frames taken from a bus at once
PLACE = struct.Struct("=Ii8sd")  # the core's StopsetFrame; of longer data eight bytes are here, as there


class Frame(NamedTuple):
    """One classic CAN frame; ``t``: reception as its adapter stamps it, seconds since the epoch or since the adapter's start."""

    cob_id: int
    data: bytes | bytearray
    t: float


class Listener(Protocol):
    """A bus as the monitor sees it: there is nothing here to send with. Links may also `fill` a batch, see `filler`, and
    count the frames that were ``lost`` before they could be taken."""

    def recv(self, timeout: float) -> Frame | None: ...
    def close(self) -> None: ...


@dataclass(slots=True)
class Batch:
    """``count`` frames, of which ``taken[0]`` have been looked at; ``frames``: the core's, to be written by links."""

    frames: Any = field(default_factory=lambda: ffi.new("StopsetFrame[]", SIZE))
    count: int = 0
    taken: Any = field(default_factory=lambda: ffi.new("int64_t *"))
    _memory: Any = field(init=False)  # of the frames

    def __post_init__(self) -> None:
        self._memory = ffi.buffer(self.frames)

    def put(self, frame: Frame) -> None:
        """One more frame; there must be room."""
        cob_id, data, t = frame
        PLACE.pack_into(self._memory, self.count * PLACE.size, cob_id & 0xFFFFFFFF, len(data), data, t)
        self.count += 1

    def clear(self) -> None:
        """All of them are done with."""
        self.count = self.taken[0] = 0


def filler(bus: Listener) -> Callable[[Batch, float], None]:
    """What fills an empty batch from a bus, waiting up to so many seconds for a first frame: its own ``fill``, else one by one."""
    own: Callable[[Batch, float], None] | None = getattr(bus, "fill", None)

    def one(batch: Batch, timeout: float) -> None:
        frame = bus.recv(timeout)
        if frame is not None:
            batch.put(frame)

    return own or one
