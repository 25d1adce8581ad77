"""``joint_states`` in both encodings met on zenoh: JSON, and the CDR of ``sensor_msgs/JointState`` that ROS 2 bridges send.

JSON: ``{"stamp": seconds, "name": [...], "position": [...], "velocity": [...], "effort": [...]}``.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import msgspec

from stopset.errors import BusError

# what goes beyond these is a damaged message or an attack, not an arm
MAX_JOINTS = 64
MAX_BYTES = 65536
MAX_NAME = 256
MAX_STAMP_NS = 2**62  # the year 2116
MAX_VALUE = 1e9  # of any angle, speed or torque


@dataclass(frozen=True, slots=True)
class JointState:
    """One message: ``stamp_ns`` of the sampling instant; SI values by joint name order, NaN where the sender has none: ROS 2's
    broadcaster says so of an interface that a joint lacks."""

    stamp_ns: int
    name: tuple[str, ...]
    position: tuple[float, ...]
    velocity: tuple[float, ...]
    effort: tuple[float, ...]


def decode(data: bytes) -> JointState:
    """Either encoding, told apart by the first byte; raises `BusError` for anything else, whatever the bytes are."""
    if len(data) > MAX_BYTES:
        raise BusError(f"joint_states message of {len(data)} bytes; expected at most {MAX_BYTES}: look at the sender")
    try:
        state = _from_json(data) if data[:1] == b"{" else _from_cdr(data)
    except (ValueError, struct.error, msgspec.MsgspecError, RecursionError) as e:
        raise BusError(
            f"joint_states message of {len(data)} bytes is neither JSON nor CDR JointState ({e}); look at the sender"
        ) from e
    return _sound(state)


def decode_ros1(data: bytes) -> JointState:
    """As ROS 1 packs a message: without alignment. Raises `BusError`."""
    if len(data) > MAX_BYTES:
        raise BusError(f"joint state of {len(data)} bytes; expected at most {MAX_BYTES}: look at the sender")
    try:
        r = _Reader(b"\0\1\0\0" + data, aligned=False)
        r.take("I")  # seq
        sec, nanosec = int(r.take("I")), int(r.take("I"))
        r.text()  # frame_id
        names = tuple(r.text() for _ in range(r.count()))
        values = [tuple(float(r.take("d")) for _ in range(r.count())) for _ in range(3)]
    except (ValueError, struct.error) as e:
        raise BusError(f"a message of {len(data)} bytes is no JointState of ROS 1 ({e}); look at the sender") from e
    return _sound(JointState(sec * 1_000_000_000 + nanosec, names, *values))


def _sound(state: JointState) -> JointState:
    """``state``, with plausible values for all joints. Raises `BusError`."""
    n = len(state.name)
    if not all(len(x) in (0, n) for x in (state.position, state.velocity, state.effort)):
        raise BusError(f"joint_states names {n} joints but carries other numbers of values; look at the sender")
    if len(set(state.name)) != n:
        raise BusError("joint_states names a joint twice; expected each once: look at the sender")
    if not 0 <= state.stamp_ns < MAX_STAMP_NS:
        raise BusError(f"joint_states is stamped {state.stamp_ns} ns; expected the time since 1970: look at the sender's clock")
    if any(abs(x) > MAX_VALUE for x in (*state.position, *state.velocity, *state.effort)):
        raise BusError(f"joint_states carries a value beyond {MAX_VALUE:g}; look at the sender")
    return state


_Row = Annotated[tuple[float, ...], msgspec.Meta(max_length=MAX_JOINTS)]


class _Json(msgspec.Struct):
    name: Annotated[tuple[Annotated[str, msgspec.Meta(max_length=MAX_NAME)], ...], msgspec.Meta(max_length=MAX_JOINTS)]
    stamp_ns: Annotated[int, msgspec.Meta(ge=0, lt=MAX_STAMP_NS)] | None = None
    stamp: float | None = None
    position: _Row = ()
    velocity: _Row = ()
    effort: _Row = ()


_decode_json = msgspec.json.Decoder(_Json).decode


def _from_json(data: bytes) -> JointState:
    d = _decode_json(data)
    if d.stamp_ns is None and d.stamp is None:
        raise ValueError("no stamp")
    stamp = d.stamp_ns
    if stamp is None:
        assert d.stamp is not None
        stamp = round(d.stamp * 1e9) if abs(d.stamp) < 1e10 else -1
    return JointState(stamp, d.name, d.position, d.velocity, d.effort)


class _Reader:
    def __init__(self, data: bytes, *, aligned: bool = True) -> None:
        if len(data) < 4 or data[0] != 0 or data[1] not in (0, 1):
            raise ValueError(f"unknown encapsulation {data[:4].hex()}")
        self.order = "<" if data[1] == 1 else ">"
        self.data, self.at, self.aligned = data, 4, aligned

    def take(self, code: str) -> float | int:
        size = struct.calcsize("<" + code)
        if self.aligned:
            self.at += -(self.at - 4) % size  # CDR aligns to the size, counted after the encapsulation
        (value,) = struct.unpack_from(self.order + code, self.data, self.at)
        self.at += size
        return value  # type: ignore[no-any-return]

    def text(self) -> str:
        length = int(self.take("I"))
        if length > MAX_NAME:
            raise ValueError(f"text of {length} bytes")
        raw = self.data[self.at : self.at + length]
        if len(raw) < length:
            raise ValueError("text runs over the end")
        self.at += length
        return raw.rstrip(b"\0").decode()

    def count(self) -> int:
        n = int(self.take("I"))
        if n > MAX_JOINTS:
            raise ValueError(f"list of {n}")
        return n


def _from_cdr(data: bytes) -> JointState:
    r = _Reader(data)
    sec, nanosec = int(r.take("i")), int(r.take("I"))
    r.text()  # frame_id
    names = tuple(r.text() for _ in range(r.count()))
    values = [tuple(float(r.take("d")) for _ in range(r.count())) for _ in range(3)]
    return JointState(sec * 1_000_000_000 + nanosec, names, *values)


def to_json(s: JointState) -> bytes:
    """JSON text with full precision; a value that is not a number cannot be written."""
    if any(not math.isfinite(x) for x in (*s.position, *s.velocity, *s.effort)):
        raise BusError("a joint state holds a value that is not a number; it cannot be sent")
    body = {"stamp_ns": s.stamp_ns, "name": s.name, "position": s.position, "velocity": s.velocity, "effort": s.effort}
    return json.dumps(body, separators=(",", ":")).encode()


def to_cdr(s: JointState) -> bytes:
    """Little-endian CDR, as ROS 2 middlewares write it."""
    out = bytearray(b"\0\1\0\0")

    def put(code: str, value: float) -> None:
        size = struct.calcsize("<" + code)
        out.extend(b"\0" * (-(len(out) - 4) % size))
        out.extend(struct.pack("<" + code, value))

    def text(x: str) -> None:
        raw = x.encode() + b"\0"
        put("I", len(raw))
        out.extend(raw)

    def doubles(values: Sequence[float]) -> None:
        put("I", len(values))
        for v in values:
            put("d", v)

    put("i", s.stamp_ns // 1_000_000_000)
    put("I", s.stamp_ns % 1_000_000_000)
    text("")
    put("I", len(s.name))
    for name in s.name:
        text(name)
    for values in (s.position, s.velocity, s.effort):
        doubles(values)
    return bytes(out)
