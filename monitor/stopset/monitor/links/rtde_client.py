"""The Real-Time Data Exchange of a Universal Robots controller, as far as listening goes: version 2 of its protocol.

Every package is a big-endian length, a type and a payload.  A client asks for the version, names the outputs it wants and how
often, and has them started; from then on the controller sends, and the client only reads.

Source: Universal Robots, Real-Time Data Exchange (RTDE) Guide.
"""

from __future__ import annotations

import contextlib
import socket
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field

from stopset.errors import BusError

PORT = 30004
VERSION = 2
ASK_VERSION, DATA, TEXT, OUTPUTS, START = ord("V"), ord("U"), ord("M"), ord("O"), ord("S")
LONGEST = 4096  # bytes of a package; the controller's own limit is lower
CODES = {"DOUBLE": "d", "VECTOR6D": "6d", "INT32": "i", "UINT32": "I", "VECTOR6INT32": "6i"}  # types of the outputs asked for
HEAD = struct.Struct(">HB")
PATIENCE = 5.0  # [s] of the controller's answers

Values = dict[str, tuple[float, ...]]


@dataclass(slots=True)
class RtdeClient:
    """A connection on which the outputs ``wanted`` come ``rate`` [Hz] times a second. Raises `BusError` whatever goes wrong."""

    address: tuple[str, int]
    wanted: tuple[str, ...]
    rate: float
    said: list[str] = field(default_factory=list)  # by the controller, in words
    _socket: socket.socket = field(init=False)
    _bytes: bytearray = field(default_factory=bytearray)
    _row: struct.Struct = field(init=False)
    _widths: list[int] = field(init=False)
    _recipe: int = 0

    def __post_init__(self) -> None:
        try:
            self._socket = socket.create_connection(self.address, timeout=PATIENCE)
        except OSError as e:
            raise BusError(f"no controller at {self._name} ({e}); check its address, the cable, and that RTDE is enabled") from e
        try:
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._agree()
        except BusError:
            self.close()
            raise

    @property
    def _name(self) -> str:
        return f"{self.address[0]}:{self.address[1]}"

    def _agree(self) -> None:
        self._send(ASK_VERSION, struct.pack(">H", VERSION))
        if self._answer(ASK_VERSION) != b"\1":
            raise BusError(
                f"the controller at {self._name} does not speak version {VERSION} of RTDE; expected software 3.4 or later: renew it"
            )
        self._send(OUTPUTS, struct.pack(">d", self.rate) + ",".join(self.wanted).encode())
        answer = self._answer(OUTPUTS)
        types = answer[1:].decode("ascii", "replace").split(",")
        if lacking := [name for name, kind in zip(self.wanted, types, strict=False) if kind == "NOT_FOUND"]:
            raise BusError(
                f"the controller at {self._name} has no {', '.join(lacking)}; its software is too old for it: state another torque"
            )
        if len(types) != len(self.wanted) or not answer[:1] or any(kind not in CODES for kind in types):
            raise BusError(
                f"the controller at {self._name} gives outputs of types {', '.join(types)[:200]}; expected one of {', '.join(CODES)} each"
            )
        codes = [CODES[kind] for kind in types]
        self._recipe, self._row = answer[0], struct.Struct(">" + "".join(codes))
        self._widths = [int(c[:-1] or 1) for c in codes]
        self._send(START, b"")
        if self._answer(START) != b"\1":
            raise BusError(f"the controller at {self._name} does not start sending; look at its log")

    def _send(self, kind: int, payload: bytes) -> None:
        try:
            self._socket.sendall(HEAD.pack(HEAD.size + len(payload), kind) + payload)
        except OSError as e:
            raise BusError(f"the controller at {self._name} does not listen ({e}); look whether it runs") from e

    def _answer(self, kind: int) -> bytes:
        """The payload of the next package of this type."""
        self._socket.settimeout(PATIENCE)
        for _ in range(100):
            while (package := self._whole()) is None:
                self._fill()
            if package[0] == kind:
                return package[1]
            self._aside(*package)
        raise BusError(f"the controller at {self._name} does not answer; is this its RTDE port?")

    def _fill(self) -> None:
        """Wait for bytes."""
        try:
            data = self._socket.recv(65536)
        except TimeoutError as e:
            raise BusError(f"the controller at {self._name} is silent; look whether it runs") from e
        except OSError as e:
            raise BusError(f"the connection to the controller at {self._name} failed ({e}); check the cable") from e
        if not data:
            raise BusError(f"the controller at {self._name} has closed the connection; is another client using up its outputs?")
        self._bytes += data

    def _whole(self) -> tuple[int, bytes] | None:
        """Type and payload of a package that has come whole, taken off what was read."""
        if len(self._bytes) < HEAD.size:
            return None
        length, kind = HEAD.unpack_from(self._bytes)
        if not HEAD.size <= length <= LONGEST:
            raise BusError(
                f"a package of {length} bytes from {self._name}; expected {HEAD.size} to {LONGEST}: is this its RTDE port?"
            )
        if len(self._bytes) < length:
            return None
        payload = bytes(self._bytes[HEAD.size : length])
        del self._bytes[:length]
        return kind, payload

    def _aside(self, kind: int, payload: bytes) -> None:
        """What the controller says besides."""
        if kind == TEXT and payload:
            self.said = [*self.said[-9:], payload[1 : 1 + payload[0]].decode("utf-8", "replace")]

    def rows(self, silence: float) -> Iterator[Values]:
        """What was asked for, package by package; a `BusError` ends it, also after ``silence`` [s] without one."""
        self._socket.settimeout(silence)
        while True:
            while (package := self._whole()) is None:
                self._fill()
            kind, payload = package
            if kind != DATA:
                self._aside(kind, payload)
                continue
            if len(payload) != 1 + self._row.size or payload[0] != self._recipe:
                raise BusError(
                    f"a data package of {len(payload)} bytes from {self._name}; expected {1 + self._row.size}, as was agreed"
                )
            numbers, out, at = self._row.unpack_from(payload, 1), {}, 0
            for name, width in zip(self.wanted, self._widths, strict=True):
                out[name] = numbers[at : at + width]
                at += width
            yield out

    def close(self) -> None:
        """Hang up; who waits for bytes in another thread hears of it."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
