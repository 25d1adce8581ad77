"""Frames of a raw CAN socket of Linux, all that wait with one call to the system.

python-can asks the system twice for every frame and makes several objects of it; a bus of six drives brings thirteen a cycle. It opens
and sets up the socket here as everywhere; only the taking is another.
"""

from __future__ import annotations

import ctypes
import errno
import math
import os
import select
import socket
import struct
import sys
from typing import Any

from stopset.errors import BusError
from stopset.monitor.links.batch import SIZE, Batch, Frame

EXTENDED, REMOTE, ERROR = 0x80000000, 0x40000000, 0x20000000  # bits of an identifier, as linux/can.h has them
SO_TIMESTAMPNS, SO_RXQ_OVFL = 35, 40  # of asm-generic/socket.h; the messages that answer them are named alike
CONTROL = 64  # bytes of such messages behind a frame: when it came, and how many found no room before it


class _Vector(ctypes.Structure):
    _fields_ = (("base", ctypes.c_void_p), ("length", ctypes.c_size_t))


class _Message(ctypes.Structure):
    """A ``struct mmsghdr``."""

    _fields_ = (
        ("name", ctypes.c_void_p), ("name_length", ctypes.c_uint), ("vectors", ctypes.c_void_p), ("count", ctypes.c_size_t),
        ("control", ctypes.c_void_p), ("control_length", ctypes.c_size_t), ("flags", ctypes.c_int), ("_", ctypes.c_uint), ("length", ctypes.c_uint),
    )  # fmt: skip


FRAME = struct.Struct("=IB3x8s")  # a struct can_frame
FILLED = struct.Struct("=40xQi4xI4x")  # of a _Message: bytes of control messages, flags, bytes of the frame
STAMP = struct.Struct("=16xqq16xI12x")  # the two control messages: seconds and nanoseconds, frames lost
STAMPED = 32  # bytes of the first, which always comes; the second does from the first loss on


def usable() -> bool:
    """Whether this system has the call, with the memory layout that is written down here."""
    return sys.platform == "linux" and ctypes.sizeof(_Message) == FILLED.size and hasattr(ctypes.CDLL(None), "recvmmsg")


class SocketCanListener:
    """Listens on the raw socket of ``bus``, python-can's of this kind. ``lost``: frames that found no room in the system's buffer,
    which keeps the older ones."""

    def __init__(self, bus: Any) -> None:
        self.lost = 0
        self._bus, self._fd = bus, bus.socket.fileno()
        bus.socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        bus.socket.setsockopt(socket.SOL_SOCKET, SO_RXQ_OVFL, 1)
        self._take: Any = ctypes.CDLL(None, use_errno=True).recvmmsg
        self._data, self._control = bytearray(SIZE * FRAME.size), bytearray(SIZE * CONTROL)
        data, control = (ctypes.addressof((ctypes.c_char * len(x)).from_buffer(x)) for x in (self._data, self._control))
        self._vectors = (_Vector * SIZE)(*[_Vector(data + i * FRAME.size, FRAME.size) for i in range(SIZE)])
        vectors = ctypes.addressof(self._vectors)
        messages = [
            _Message(None, 0, vectors + i * ctypes.sizeof(_Vector), 1, control + i * CONTROL, CONTROL, 0, 0, 0)
            for i in range(SIZE)
        ]
        self._messages = (_Message * SIZE)(*messages)
        self._empty = bytes(self._messages)  # the system writes into them
        self._filled = memoryview(self._messages).cast("B")
        self._waiting = Batch()

    def fill(self, batch: Batch, timeout: float) -> None:
        """As many frames as are there, of which the first is waited for. Raises `BusError`."""
        batch.clear()
        if timeout > 0.0 and not select.select([self._fd], [], [], timeout)[0]:
            return
        count = self._take(self._fd, self._messages, SIZE, socket.MSG_DONTWAIT, None)
        if count < 0:
            code = ctypes.get_errno()
            if code in (errno.EAGAIN, errno.EINTR):
                return
            raise BusError(f"the bus failed ({os.strerror(code)}); check cable, power and termination")
        try:
            self._put(batch, count)
        finally:
            ctypes.memmove(self._messages, self._empty, count * FILLED.size)

    def _put(self, batch: Batch, count: int) -> None:
        failed = False
        filled, stamps = FILLED.iter_unpack(self._filled[: count * FILLED.size]), STAMP.iter_unpack(self._control)
        for (identifier, length, data), (control, flags, size), (seconds, nano, lost) in zip(
            FRAME.iter_unpack(self._data), filled, stamps, strict=False
        ):
            if control > STAMPED:
                self.lost = max(self.lost, lost)
            if size != FRAME.size or flags & socket.MSG_TRUNC:  # CAN FD frames are longer, and cut
                continue
            if identifier & ERROR:  # whatever else is set with it
                failed = True
                continue
            if identifier & (EXTENDED | REMOTE):
                continue
            t = seconds + 1e-9 * nano if control >= STAMPED else math.nan  # which counts as old as can be
            batch.put(Frame(identifier, data[:length], t))
        if failed:
            raise BusError("error frame on the bus; check termination and bit rate")

    def recv(self, timeout: float) -> Frame | None:
        """The next frame, if it comes in time. Raises `BusError`."""
        batch = self._waiting
        if batch.taken[0] == batch.count:
            self.fill(batch, timeout)
        if not batch.count:
            return None
        frame = batch.frames[batch.taken[0]]
        batch.taken[0] += 1
        return Frame(frame.id, bytes(frame.data)[: frame.length], frame.t)

    def close(self) -> None:
        self._bus.shutdown()
