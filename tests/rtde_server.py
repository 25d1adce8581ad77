"""A Universal Robots controller as its clients see it: RTDE version 2 over TCP, told by a motion what to send."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
import time
from collections.abc import Callable
from typing import Any

TYPES = {
    "timestamp": "DOUBLE", "actual_q": "VECTOR6D", "actual_qd": "VECTOR6D", "actual_current": "VECTOR6D", "target_moment": "VECTOR6D",
    "actual_current_as_torque": "VECTOR6D", "joint_temperatures": "VECTOR6D", "robot_mode": "INT32", "safety_status": "INT32",
    "robot_status_bits": "UINT32", "safety_status_bits": "UINT32", "runtime_state": "UINT32", "joint_mode": "VECTOR6INT32",
    "payload": "DOUBLE", "speed_scaling": "DOUBLE",
}  # fmt: skip
CODES = {"DOUBLE": "d", "VECTOR6D": "6d", "INT32": "i", "UINT32": "I", "VECTOR6INT32": "6i"}


class Controller:
    """Serves ``state(k)`` for k = 0, 1, ... every ``cycle`` [s]; ``spoil`` changes the bytes of a package on their way."""

    def __init__(self, state: Callable[[int], dict[str, Any]], cycle: float, port: int = 0, host: str = "127.0.0.1") -> None:
        self.state, self.cycle, self.k = state, cycle, 0
        self.old: set[str] = set()  # outputs that its software does not have
        self.spoil: Callable[[bytes], bytes] = lambda b: b
        self.pause = False
        self.open = True
        self.heard = b""  # from clients, beyond what the protocol asks of a listener
        self._server = socket.create_server((host, port))
        self.port = int(self._server.getsockname()[1])
        self._sockets: list[socket.socket] = []
        self._threads: list[threading.Thread] = []
        self._start(self._accept)

    def _start(self, work: Callable[..., None], *about: Any) -> None:
        self._threads.append(threading.Thread(target=work, args=about, daemon=True))
        self._threads[-1].start()

    def _accept(self) -> None:
        while self.open:
            try:
                s, _ = self._server.accept()
            except OSError:
                return
            self._sockets.append(s)
            self._start(self._serve, s)

    def _serve(self, s: socket.socket) -> None:
        names: list[str] = []
        with contextlib.suppress(OSError, ConnectionError, struct.error):
            while self.open:
                length, kind = struct.unpack(">HB", self._read(s, 3))
                payload = self._read(s, length - 3)
                if kind == ord("V"):
                    self._send(s, kind, b"\1" if payload == b"\0\2" else b"\0")
                elif kind == ord("v"):
                    self._send(s, kind, struct.pack(">4I", 5, 22, 0, 0))
                elif kind == ord("O"):
                    names = payload[8:].decode().rstrip(",").split(",")
                    types = ["NOT_FOUND" if n in self.old else TYPES.get(n, "NOT_FOUND") for n in names]
                    self._send(s, kind, bytes(["NOT_FOUND" not in types]) + ",".join(types).encode())
                elif kind == ord("S"):
                    self._send(s, kind, b"\1")
                    self._start(self._feed, s, names)
                elif kind == ord("P"):
                    self._send(s, kind, b"\1")
                else:
                    self.heard += payload

    def _feed(self, s: socket.socket, names: list[str]) -> None:
        begin = time.monotonic() - self.k * self.cycle
        text = b"hello from the controller"
        with contextlib.suppress(OSError):  # the client, or `close`, has hung up
            self._send(s, ord("M"), bytes([len(text)]) + text + bytes([3]) + b"arm" + b"\1")
            while self.open:
                time.sleep(max(0.0, begin + self.k * self.cycle - time.monotonic()))
                row = {"timestamp": (1000.0 + self.k * self.cycle,), **self.state(self.k)}
                self.k += 1
                if self.pause:
                    continue
                body = b"".join(struct.pack(">" + CODES[TYPES[n]], *row[n]) for n in names)
                self._send(s, ord("U"), b"\1" + body)

    def _send(self, s: socket.socket, kind: int, payload: bytes) -> None:
        s.sendall(self.spoil(struct.pack(">HB", 3 + len(payload), kind) + payload))

    @staticmethod
    def _read(s: socket.socket, count: int) -> bytes:
        out = b""
        while len(out) < count:
            data = s.recv(count - len(out))
            if not data:
                raise ConnectionError
            out += data
        return out

    def hang_up(self) -> None:
        """On all that are connected now."""
        while self._sockets:
            s = self._sockets.pop()
            with contextlib.suppress(OSError):
                s.shutdown(socket.SHUT_RDWR)
            s.close()

    def close(self) -> None:
        self.open = False
        with contextlib.suppress(OSError):
            self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()
        self._threads[0].join()  # who is let in after this is hung up on too
        self.hang_up()
        for thread in self._threads:
            thread.join()
