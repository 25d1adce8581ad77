"""Messages made in place, one after another: only what changes is written anew."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from stopset.core.library import ffi, lib
from stopset.monitor.layout import (
    AT,
    CHECKED,
    FIELDS,
    KINDS,
    LAYOUT_VERSION,
    LENGTH,
    MAC,
    MAGIC,
    Field,
    outward_all,
)


class Signer(Protocol):
    """A key's number, and the authentication code it makes of some bytes; see `stopset.monitor.authentication`."""

    @property
    def key_id(self) -> int: ...

    def code(self, data: bytes | bytearray | memoryview) -> bytes: ...


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


# what changes with every message stands in three places: whole numbers first, three real ones, whole numbers at the end
_FIRST, _NUMBERS, _LAST = (
    _between("seq", "violation_count"),
    _between("holding_margin_min", "room_min"),
    _between("nonces", "reserved2"),
)
_FIRST_STRUCT, _LAST_STRUCT = _struct(_FIRST), _struct(_LAST)
_FIRST_NAMES, _NUMBER_NAMES = tuple(f.name for f in _FIRST), tuple(f.name for f in _NUMBERS)
_SIDES = tuple(1 if f.rounds == "up" else -1 for f in _NUMBERS)


class Packer:
    """Makes messages; ``signer`` adds its authentication code."""

    def __init__(self, signer: Signer | None = None) -> None:
        self.signer = signer
        self._bytes = bytearray(LENGTH)
        self._view, self._memory = memoryview(self._bytes), ffi.from_buffer("uint8_t[]", self._bytes)
        self._real = np.zeros(len(_WORDS))
        self._floats = np.frombuffer(self._bytes, "<f4")
        self._block: Mapping[str, Any] | None = None
        self._views = {
            f.name: np.frombuffer(self._bytes, "<" + {"B": "u1", "H": "u2", "I": "u4", "Q": "u8"}[KINDS[f.kind][0]], f.count, AT[f.name])
            for f in _WHOLE
        }  # fmt: skip
        self._numbers, self._sides = ffi.new("double[]", len(_NUMBERS)), ffi.new("int8_t[]", _SIDES)
        self._bits = ffi.cast("uint32_t *", self._memory + AT[_NUMBER_NAMES[0]])

    def pack(self, values: Mapping[str, Any]) -> bytes:
        """One message from field values; magic, version, length, code and checks are filled in, missing fields are 0."""
        self._start(values)
        self._block = None
        return self._finish()

    def again(self, values: Mapping[str, Any], block: Mapping[str, Any]) -> bytes:
        """The same where many fields stay: ``block`` is only looked at if it is another object than the last time, and holds
        what does not change; ``values`` holds all that does."""
        if block is not self._block:
            self._start(block)
            self._block = block
        now = [values[name] if name in values else block[name] for name in _FIRST_NAMES]
        _FIRST_STRUCT.pack_into(self._bytes, AT["seq"], *now)
        for k, name in enumerate(_NUMBER_NAMES):
            self._numbers[k] = values[name] if name in values else block[name]
        lib.stopset_outward(len(_SIDES), self._numbers, self._sides, self._bits)
        _LAST_STRUCT.pack_into(self._bytes, AT["nonces"], *values["nonces"], 0, values["bad_nodes"], values["dropped"], 0)
        return self._finish()

    def _start(self, values: Mapping[str, Any]) -> None:
        self._bytes[:] = bytes(LENGTH)
        self._real[:] = 0.0
        for name, value in {**values, **_FIXED}.items():
            place = _SLOTS.get(name)
            if place is None:
                self._views[name][: np.size(value)] = value
            else:
                self._real[place.start : place.start + np.size(value)] = value
        self._floats[_WORDS] = outward_all(self._real, _UP)

    def _finish(self) -> bytes:
        lib.stopset_seal(AT[CHECKED[0][0]], self._memory)
        if self.signer is not None:
            self._views["key_id"][0] = self.signer.key_id
            at = AT["mac"]
            self._view[at : at + MAC] = self.signer.code(self._view[:at])
        lib.stopset_seal(AT[CHECKED[1][0]], self._memory)
        return bytes(self._bytes)
