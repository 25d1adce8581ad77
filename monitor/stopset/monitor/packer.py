"""Messages made in place, one after another: only what changes is written anew."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from typing import Any

import msgspec
import numpy as np

from stopset.core.library import ffi, lib
from stopset.monitor.authentication import Key
from stopset.monitor.layout import AT, CHECKED, FIELDS, KINDS, LAYOUT_VERSION, LENGTH, MAC, MAGIC, Field, outward_all

_WHOLE = tuple(f for f in FIELDS if f.kind != "f32")
_REAL = tuple(f for f in FIELDS if f.kind == "f32")
_SLOTS = {f.name: slice(at, at + f.count) for f, at in zip(_REAL, np.cumsum([0, *(f.count for f in _REAL)]), strict=False)}
_WORDS = np.concatenate([AT[f.name] // 4 + np.arange(f.count) for f in _REAL])
_UP = np.concatenate([np.full(f.count, f.rounds == "up") for f in _REAL])
_FIXED = {"magic": MAGIC, "layout_version": LAYOUT_VERSION, "length": LENGTH}


def _between(first: str, last: str) -> tuple[Field, ...]:
    names = [f.name for f in FIELDS]
    return FIELDS[names.index(first) : names.index(last) + 1]


def _struct(fields: tuple[Field, ...]) -> struct.Struct:
    return struct.Struct("<" + "".join(f"{f.count if f.count > 1 else ''}{KINDS[f.kind][0]}" for f in fields))


class Changing(msgspec.Struct):  # as `stopset.monitor.sample.Sample`
    """The fields of a message that what is observed decides, in the order in which they stand in it."""

    t_meas_ns: int
    state: int
    conformance: int
    first_joint: int
    violation_class: int
    flags: int
    violation_count: int
    oldest_age: float
    room_min: float
    bad_nodes: int
    dropped: int


# what changes with every message stands in three places: whole numbers first, some that stay among them, three real ones, whole numbers
_FIRST, _NUMBERS, _LAST = (
    _between("seq", "violation_count"),
    _between("holding_margin_min", "room_min"),
    _between("nonces", "reserved2"),
)
_FIRST_STRUCT, _NUMBER_STRUCT, _LAST_STRUCT = _struct(_FIRST), struct.Struct(f"={len(_NUMBERS)}d"), _struct(_LAST)
_FIRST_AT, _LAST_AT, _CHECK_AT, _END_AT = AT["seq"], AT["nonces"], *(AT[iso] for iso, _ in CHECKED)
_MAC = slice(AT["mac"], AT["mac"] + MAC)
_STAYING = ("model_hash", "config_hash", "valid_for_ms", "cycle_us", "joints", "holding_margin_min")
_SIDES = tuple(1 if f.rounds == "up" else -1 for f in _NUMBERS)


class Packer:
    """Makes messages; ``key`` adds its authentication code."""

    def __init__(self, key: Key | None = None) -> None:
        self.key, self._key_id = key, 0 if key is None else key.key_id
        self._bytes = bytearray(LENGTH)
        self._signed = memoryview(self._bytes)[: AT["mac"]]
        self._real = np.zeros(len(_WORDS))
        self._floats = np.frombuffer(self._bytes, "<f4")
        self._block: Mapping[str, Any] | None = None
        self._staying: list[Any] = []  # of the block, what stands among what changes
        self._views = {
            f.name: np.frombuffer(self._bytes, "<" + {"B": "u1", "H": "u2", "I": "u4", "Q": "u8"}[KINDS[f.kind][0]], f.count, AT[f.name])
            for f in _WHOLE
        }  # fmt: skip
        self._numbers = bytearray(_NUMBER_STRUCT.size)
        place = ffi.from_buffer("uint8_t[]", self._bytes), ffi.from_buffer("double[]", self._numbers), ffi.new("int8_t[]", _SIDES)
        self._pinned = place  # what the struct points at
        self._message = ffi.new("StopsetMessage *", {
            "bytes": place[0], "numbers": place[1], "side": place[2], "first": AT[_NUMBERS[0].name],
        })  # fmt: skip

    def pack(self, values: Mapping[str, Any]) -> bytes:
        """One message from field values; magic, version, length, code and checks are filled in, missing fields are 0."""
        self._start(values)
        self._block, self._message.count = None, 0
        return self._finish()

    def again(self, now: Changing, number: tuple[int, int, int], nonces: Iterable[int], block: Mapping[str, Any]) -> bytes:
        """The same where many fields stay: ``block`` is only looked at if it is another object than the last time, and holds what does not
        change. ``number``: ``seq``, ``boot_id`` and ``t_pub_ns``."""
        if block is not self._block:
            self._start(block)
            self._block, self._message.count = block, len(_NUMBERS)
            self._staying = [block.get(name, 0) for name in _STAYING]
        seq, boot, t_pub = number
        model, config, valid, cycle, joints, margin = self._staying
        place = self._bytes
        _FIRST_STRUCT.pack_into(
            place, _FIRST_AT, seq, boot, now.t_meas_ns, t_pub, model, config, valid, now.state, now.conformance, cycle, joints,
            now.first_joint, now.violation_class, now.flags, now.violation_count,
        )  # fmt: skip
        _NUMBER_STRUCT.pack_into(self._numbers, 0, margin, now.oldest_age, now.room_min)
        _LAST_STRUCT.pack_into(place, _LAST_AT, *nonces, self._key_id, now.bad_nodes, now.dropped, 0)
        return self._finish()

    def _start(self, values: Mapping[str, Any]) -> None:
        self._bytes[:] = bytes(LENGTH)
        self._real[:] = 0.0
        for name, value in {**values, **_FIXED, "key_id": self._key_id}.items():
            place = _SLOTS.get(name)
            if place is None:
                self._views[name][: np.size(value)] = value
            else:
                self._real[place.start : place.start + np.size(value)] = value
        self._floats[_WORDS] = outward_all(self._real, _UP)

    def _finish(self) -> bytes:
        lib.stopset_message(self._message, _CHECK_AT)
        if self.key is not None:
            self._bytes[_MAC] = self.key.code(self._signed)
        lib.stopset_seal(self._message, _END_AT)
        return bytes(self._bytes)
