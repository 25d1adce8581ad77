"""The message a PLC reads: one table of fields, from which packing, C header, Structured Text and documentation follow.

Little endian, fixed offsets, every field naturally aligned. Numbers are rounded to the safe side: what bounds from above goes
up, what bounds from below goes down, so a float32 never promises more than the float64 it came from.

Version 2 adds its fields behind those of version 1, whose offsets stay; a reader of version 1 refuses it by its version.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from itertools import accumulate
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stopset.core.library import ffi, lib
from stopset.errors import BusError

MAGIC = 0x53505453  # "STPS" in memory
LAYOUT_VERSION = 2
MAX_JOINTS = 8
NONCES = 4
MAC = 16
CATEGORIES = ("0", "1", "1 guaranteed", "2")
PREFIX = {"0": "stop0", "1": "stop1", "1 guaranteed": "stop1g", "2": "stop2"}


class State(IntEnum):
    """One byte; any two codes differ in at least four bits, and anything else means FAULT to the consumer."""

    NEVER_SENT = 0x00
    INIT = 0x17
    OK = 0x2B
    DEGRADED = 0x4D
    VIOLATION = 0x71
    UNKNOWN = 0x8E
    FAULT = 0xB2
    SHUTDOWN = 0xD4


class Flag(IntFlag):
    """Why the state is what it is."""

    VIOLATION_LATCHED = 1
    OUT_OF_DOMAIN = 2
    BUS_GAP = 4
    BUS_STALE = 8
    NO_STOP_PROVABLE = 16
    DEADLINE_MISS = 32
    DRIVES_NOT_POWERED = 64
    NO_TORQUE = 128
    FALLBACK_IN_FORCE = 256
    STOP_NOT_FRESH = 512
    NODE_NOT_GOOD = 1024
    EVIDENCE_YOUNG = 2048
    RECOVERING = 4096
    END_STOP = 8192


@dataclass(frozen=True, slots=True)
class Field:
    """``kind``: a key of `KINDS`; ``rounds``: "up" or "down" for floats that bound something."""

    name: str
    kind: str
    count: int
    unit: str
    means: str
    rounds: str = ""


KINDS = {"u8": ("B", 1), "u16": ("H", 2), "u32": ("I", 4), "u64": ("Q", 8), "f32": ("f", 4)}


def _category(name: str, prefix: str) -> list[Field]:
    said = {"0": "STOP 0", "1": "STOP 1, the ramp works", "1 guaranteed": "STOP 1, the ramp fails", "2": "STOP 2"}[name]
    return [
        Field(f"{prefix}_provable", "u32", 1, "", f"{said}: bit i set = joint i+1 has a proven bound"),
        Field(f"{prefix}_time", "f32", MAX_JOINTS, "s", f"{said}: stop time per joint, +Inf if not provable", "up"),
        Field(f"{prefix}_angle_forward", "f32", MAX_JOINTS, "rad", f"{said}: travel in + direction per joint", "up"),
        Field(f"{prefix}_angle_back", "f32", MAX_JOINTS, "rad", f"{said}: travel in - direction per joint", "up"),
        Field(f"{prefix}_time_max", "f32", 1, "s", f"{said}: stop time of the arm", "up"),
        Field(f"{prefix}_tcp", "f32", 1, "m", f"{said}: travel of the flange", "up"),
        Field(f"{prefix}_reaction", "f32", 1, "s", f"{said}: reaction time in the numbers (0: yours to add)", "up"),
    ]


FIELDS: tuple[Field, ...] = (
    Field("magic", "u32", 1, "", "0x53505453"),
    Field("layout_version", "u16", 1, "", "this table's version"),
    Field("length", "u16", 1, "byte", "of the whole message"),
    Field("data_id", "u32", 1, "", "identity of the source: site, cell, arm; from the configuration"),
    Field("seq", "u32", 1, "", "+1 per message and boot"),
    Field("boot_id", "u64", 1, "", "random per start of the daemon"),
    Field("t_meas_ns", "u64", 1, "ns", "sampling instant (SYNC), clock of the bus adapter"),
    Field("t_pub_ns", "u64", 1, "ns", "when this message was made, CLOCK_REALTIME of the daemon"),
    Field("model_hash", "u64", 1, "", "first 8 bytes of the model file's SHA-256"),
    Field("config_hash", "u64", 1, "", "first 8 bytes of the configuration's SHA-256"),
    Field("valid_for_ms", "u16", 1, "ms", "do not use the numbers longer than this after t_meas"),
    Field("state", "u8", 1, "", "see the state codes; anything unknown means FAULT"),
    Field("conformance", "u8", 1, "", "of this sample: 0 unknown, 1 conformant, 2 violation, 3 check failed"),
    Field("cycle_us", "u32", 1, "us", "nominal cycle of the messages"),
    Field("joints", "u8", 1, "", "number of joints in use; later slots are 0"),
    Field("first_joint", "u8", 1, "", "first joint of the latched violation, 1 = joint 1; 0 none"),
    Field("violation_class", "u16", 1, "", "of the latched violation, by the evidence: see the class codes; 0 none"),
    Field("flags", "u32", 1, "", "see the flag bits"),
    Field("violation_count", "u32", 1, "", "samples outside their prediction since the last reset"),
    Field("holding_margin_min", "f32", 1, "N m", "least torque to spare in holding the arm on its brakes", "down"),
    Field("oldest_age", "f32", 1, "s", "oldest prediction this sample was held against", "down"),
    Field("room_min", "f32", 1, "", "distance to the nearest bound over the half width; negative outside", "down"),
    *(f for c in CATEGORIES for f in _category(c, PREFIX[c])),
    Field("check", "u32", 1, "", "CRC-32/ISO-HDLC of all bytes before this field"),
    Field("crc", "u32", 1, "", "CRC-32C of all bytes before this field"),
    # version 2
    Field("nonces", "u64", NONCES, "", "first 8 bytes of the last challenges heard, newest first; 0 none"),
    Field("key_id", "u32", 1, "", "key of the authentication code; 0 no code"),
    Field("bad_nodes", "u32", 1, "", "bit i set = the drive of joint i+1 is silent, not operational, or in an emergency"),
    Field("dropped", "u32", 1, "", "samples dropped unread since the start because newer ones were there"),
    Field("reserved2", "u32", 1, "", "0"),
    Field("mac", "u8", MAC, "", "HMAC-SHA256 of all bytes before this field, its first 16 bytes"),
    Field("end_check", "u32", 1, "", "CRC-32/ISO-HDLC of all bytes before this field"),
    Field("end_crc", "u32", 1, "", "CRC-32C of all bytes before this field"),
)
_F32, _U32 = struct.Struct("<f"), struct.Struct("<I")
LARGEST_F32 = float(np.finfo(np.float32).max)
_STRUCT = struct.Struct("<" + "".join(f"{f.count if f.count > 1 else ''}{KINDS[f.kind][0]}" for f in FIELDS))
LENGTH = _STRUCT.size
_PLACES = [  # of every field's number, or numbers, among all
    (f.name, at if f.count == 1 else slice(at, at + f.count))
    for f, at in zip(FIELDS, accumulate((f.count for f in FIELDS), initial=0), strict=False)
]


def offsets() -> dict[str, int]:
    """Byte offset of every field."""
    out, at = {}, 0
    for f in FIELDS:
        out[f.name] = at
        at += f.count * KINDS[f.kind][1]
    return out


def crc32c(data: bytes | bytearray | memoryview) -> int:
    """CRC-32C (Castagnoli) of ``data``."""
    return int(lib.stopset_crc32c(len(data), ffi.from_buffer("uint8_t[]", data)))


def outward_all(x: NDArray[np.float64], up: NDArray[np.bool_]) -> NDArray[np.float32]:
    """`outward` of many numbers at once."""
    sign = np.where(up, 1.0, -1.0)
    with np.errstate(over="ignore", invalid="ignore"):
        y = (sign * x).astype(np.float32)  # bounds from below are bounds from above of the negative
        y = np.where(y < sign * x, np.nextafter(y, np.float32(np.inf)), y)
    return np.asarray(np.where(np.isnan(y), np.inf, y) * sign, np.float32)


AT = offsets()
CHECKED = (("check", "crc"), ("end_check", "end_crc"))


def unpack(data: bytes) -> dict[str, Any]:
    """Field values of a message; raises `BusError` if it is not one or was damaged on the way. Who sent it is not checked."""
    if len(data) != LENGTH:
        raise BusError(f"state message has {len(data)} bytes, expected {LENGTH}; sender and reader have different versions")
    items = _STRUCT.unpack(data)
    out: dict[str, Any] = {name: items[place] for name, place in _PLACES}
    if out["magic"] != MAGIC or out["layout_version"] != LAYOUT_VERSION or out["length"] != LENGTH:
        raise BusError(f"state message has magic {out['magic']:#x}, version {out['layout_version']}; expected {LAYOUT_VERSION}")
    for iso, castagnoli in CHECKED:
        if out[castagnoli] != crc32c(data[: AT[castagnoli]]) or out[iso] != zlib.crc32(data[: AT[iso]]):
            raise BusError("state message is damaged: its checksum does not match; drop it and look at the network")
    return out
