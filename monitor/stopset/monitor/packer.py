"""Messages made in place, one after another: only what changes is written anew."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from stopset.core.library import ffi
from stopset.monitor.layout import (
    AT,
    FIELDS,
    KINDS,
    LAYOUT_VERSION,
    LENGTH,
    MAGIC,
    Field,
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
