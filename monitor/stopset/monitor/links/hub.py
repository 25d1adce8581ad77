"""A CAN bus over TCP for one machine: every client hears every frame, nothing is lost, python-can's socketcand can join.

The protocol is socketcand's raw mode: ``< frame 183 23.424242 0011 >`` to the clients, ``< send 183 2 0 11 >`` from them.
"""

from __future__ import annotations

import contextlib
import select
import socket
import threading
import time
from dataclasses import dataclass, field

from stopset.errors import BusError
from stopset.monitor.links.batch import SIZE, Batch, Frame

# python-can's client expects the last answer of the greeting alone in one read
_QUIET_AFTER_GREETING = 0.2
LONGEST = 4096  # bytes without an end: not this protocol


@dataclass(slots=True)
class _Client:
    socket: socket.socket
    text: bytes = b""
    raw_from: float = float("inf")  # frames go to it from this moment on
    pending: bytearray = field(default_factory=bytearray)


class Hub:
    """The bus itself, served on ``host:port``; also a node that can `send`. ``client_frames``: what others have sent."""

    def __init__(self, host: str, port: int) -> None:
        self.client_frames = 0
        self._clients: list[_Client] = []
        self._lock = threading.Lock()
        self._open = True
        try:
            self._server = socket.create_server((host, port), reuse_port=False)
        except OSError as e:
            raise BusError(f"hub {host}:{port} cannot be served ({e}); choose another port") from e
        self.port = int(self._server.getsockname()[1])
        self._thread = threading.Thread(target=self._serve, daemon=True, name="hub")
        self._thread.start()

    @property
    def clients(self) -> int:
        """Clients that hear frames now."""
        with self._lock:
            return sum(c.raw_from < time.monotonic() for c in self._clients)

    def send(self, cob_id: int, data: bytes) -> None:
        self._broadcast(f"< frame {cob_id:03X} {time.time():.6f} {data.hex()} >".encode(), None)

    def _broadcast(self, text: bytes, sender: _Client | None) -> None:
        now = time.monotonic()
        with self._lock:
            for c in list(self._clients):
                if c is sender or c.raw_from > now:
                    continue
                try:
                    c.socket.sendall(text)
                except OSError:
                    self._drop(c)

    def _drop(self, c: _Client) -> None:
        if c in self._clients:
            self._clients.remove(c)
        c.socket.close()

    def _serve(self) -> None:
        while self._open:
            with self._lock:
                sockets = {c.socket: c for c in self._clients}
            with contextlib.suppress(OSError, ValueError):
                ready, _, _ = select.select([self._server, *sockets], [], [], 0.05)
                for s in ready:
                    if s is self._server:
                        self._accept()
                    else:
                        self._read(sockets[s])

    def _accept(self) -> None:
        s, _ = self._server.accept()
        s.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        s.settimeout(5.0)  # a client that does not read is dropped rather than blocking the bus
        s.sendall(b"< hi >")
        with self._lock:
            self._clients.append(_Client(s))

    def _read(self, c: _Client) -> None:
        try:
            data = c.socket.recv(65536)
        except OSError:
            data = b""
        if not data:
            with self._lock:
                self._drop(c)
            return
        c.text += data
        if b">" not in c.text and len(c.text) > LONGEST:
            c.text = b""
        while b">" in c.text:
            command, c.text = c.text.split(b">", 1)
            self._command(c, command.decode("ascii", "replace").strip("< ").split())

    def _command(self, c: _Client, words: list[str]) -> None:
        if words[:1] == ["send"] and len(words) >= 3:
            try:
                cob_id, payload = int(words[1], 16), bytes(int(b, 16) for b in words[3:])
            except ValueError:
                return  # no frame: a bus would not have carried it either
            self.client_frames += 1
            self._broadcast(f"< frame {cob_id:03X} {time.time():.6f} {payload.hex()} >".encode(), c)
        else:
            c.socket.sendall(b"< ok >")
            if words == ["rawmode"]:
                c.raw_from = time.monotonic() + _QUIET_AFTER_GREETING

    def close(self) -> None:
        """Let the clients read what is on its way, then end."""
        self._open = False
        self._thread.join(timeout=1.0)
        with self._lock:
            for c in list(self._clients):
                with contextlib.suppress(OSError):
                    c.socket.shutdown(socket.SHUT_WR)
                self._drop(c)
        self._server.close()


def _frame(words: list[bytes]) -> Frame:
    payload = bytes.fromhex(words[4].decode("ascii")) if len(words) > 4 else b""
    cob_id, t = int(words[2], 16), float(words[3])
    if not 0 <= cob_id <= 0x7FF or len(payload) > 8:
        raise ValueError("not a classic CAN frame")
    return Frame(cob_id, payload, t)


class HubClient:
    """Listens on a hub; raises `BusError` when the hub is gone, so silence and absence are told apart."""

    def __init__(self, host: str, port: int) -> None:
        try:
            self._socket = socket.create_connection((host, port), timeout=5.0)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            for say in (b"", b"< open can0 >", b"< rawmode >"):
                if say:
                    self._socket.sendall(say)
                if not self._socket.recv(64):
                    raise OSError("closed during the greeting")
        except OSError as e:
            raise BusError(f"no hub at {host}:{port} ({e}); start the replay that serves it") from e
        self.garbled = 0
        self._text = b""
        self._ready: list[Frame] = []
        self._next = 0

    def fill(self, batch: Batch, timeout: float) -> None:
        """As many frames as are there, of which the first is waited for."""
        batch.clear()
        while batch.count < SIZE and (frame := self.recv(0.0 if batch.count else timeout)) is not None:
            batch.put(frame)

    def recv(self, timeout: float) -> Frame | None:
        if self._next < len(self._ready):
            self._next += 1
            return self._ready[self._next - 1]
        if not select.select([self._socket], [], [], timeout)[0]:
            return None
        try:
            data = self._socket.recv(65536)
        except OSError as e:
            raise BusError(f"the hub failed ({e}); restart the replay") from e
        if not data:
            raise BusError("the hub has closed; nobody is on the bus any more")
        *whole, self._text = (self._text + data).split(b">")
        if len(self._text) > LONGEST:
            self._text, self.garbled = b"", self.garbled + 1
        self._ready, self._next = [], 0
        for text in whole:
            words = text.split()
            if len(words) >= 4 and words[1] == b"frame":
                try:
                    self._ready.append(_frame(words))
                except ValueError:
                    self.garbled += 1
        return self.recv(0.0) if self._ready else None

    def close(self) -> None:
        self._socket.close()
