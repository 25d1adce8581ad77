"""What must survive a restart: one small record on disk, replaced in place, so that it needs no free space when it counts.

The file has two slots of fixed size. The one that the disk surely holds is not touched: a write that power loss tears leaves the other
slot whole. A slot carries a running number and a digest. The file is born complete, so whatever is not two whole slots is damage, and
damage is `Unreadable`: the reader of it must assume the worst, and gets what is whole with it. So is a file that is gone from where one
was begun, and a record that the disk never got: `stopset.monitor.journal_file`.

Counts change every cycle, too often for the disk. They stand in the system's memory, which outlives the process but not the machine;
they hold for the record whose number they carry, and if that number is not on the disk the journal lacks what was written last.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Sequence
from typing import Any, Protocol

import msgspec

SLOT = 16384
_HEAD = struct.Struct("<8sQI")  # mark, number, length of the record
_MARK = b"STPSLTCH"
_DIGEST = 16
GONE = bytes(2 * SLOT)  # of a journal that was begun and is not there any more
_COUNTS = struct.Struct("<64Q")  # number of the record, how many counts, they themselves
MOST_COUNTS = 62
COUNTED = _COUNTS.size + _DIGEST  # bytes of the counts


class Store(Protocol):
    """Where the two slots lie, and the counts; may raise `OSError`.

    ``flush`` starts making what was written last, and need not wait: ``settled`` once the disk has all of it. ``astray``: why a restart
    would not find it, or the disk has not got it, empty if neither is so. ``interrupted``: why what was seen last may be missing, for a
    journal that must miss nothing; ``notice``: what else is to be said at the start. Both empty as a rule.
    """

    @property
    def settled(self) -> bool: ...
    @property
    def astray(self) -> str: ...
    @property
    def interrupted(self) -> str: ...
    @property
    def notice(self) -> str: ...
    def read(self) -> bytes: ...
    def write(self, offset: int, data: bytes) -> None: ...
    def flush(self) -> None: ...
    def read_counts(self) -> bytes: ...
    def write_counts(self, data: bytes) -> None: ...
    def close(self) -> None: ...


class Unreadable(Exception):
    """The journal holds damage, in words; ``record``: what was whole in it all the same, None if nothing was."""

    def __init__(self, words: str, record: Any = None) -> None:
        super().__init__(words)
        self.record = record


def has_room(record: Any) -> bool:
    """Whether a slot takes the record."""
    return _HEAD.size + len(_encoded(record)) <= SLOT - _DIGEST


def _encoded(record: Any) -> bytes:
    return msgspec.json.encode(record, enc_hook=float)


def _slot(number: int, record: Any) -> bytes:
    body = _encoded(record)
    whole = _HEAD.pack(_MARK, number, len(body)) + body
    if len(whole) > SLOT - _DIGEST:
        raise ValueError(f"the record has {len(body)} bytes, a slot {SLOT}")
    whole = whole.ljust(SLOT - _DIGEST, b"\0")  # also what is empty is held, or half a write could go unseen
    return whole + hashlib.blake2b(whole, digest_size=_DIGEST).digest()


def _read_slot(data: bytes) -> tuple[int, Any] | None:
    mark, number, length = _HEAD.unpack_from(data)
    end = _HEAD.size + length
    whole, digest = data[: SLOT - _DIGEST], data[SLOT - _DIGEST :]
    if mark != _MARK or end > len(whole) or hashlib.blake2b(whole, digest_size=_DIGEST).digest() != digest:
        return None
    return number, msgspec.json.decode(data[_HEAD.size : end])


def many_counted(data: bytes) -> int:
    """How many counts stand in what `Store.read_counts` gives."""
    return int.from_bytes(data[8:16], "little")


def blank(record: Any) -> bytes:
    """A whole journal that holds ``record``."""
    return _slot(0, record) + _slot(1, record)


class Journal:
    """The record, read once with `read`, replaced with `write`. ``trouble``: words of the last failure, empty if none."""

    def __init__(self, store: Store) -> None:
        self.trouble, self.notice = "", store.notice
        self._store, self._number, self._slot = store, 1, 1

    def read(self) -> Any:
        """The record written last; raises `Unreadable` for a damaged, foreign or torn journal."""
        try:
            data = self._store.read()
            if data == GONE:
                raise Unreadable(
                    "the journal of the latch was taken away since it was begun, or `must_remember` takes this start for no first one"
                )
            slots = [_read_slot(part) for at in (0, SLOT) if len(part := data[at : at + SLOT]) == SLOT]
        except (OSError, msgspec.MsgspecError, UnicodeDecodeError) as e:
            raise Unreadable(f"the journal of the latch cannot be read ({e})") from e
        whole = [(*found, k) for k, found in enumerate(slots) if found is not None]
        self._number, record, self._slot = max(whole, key=lambda s: s[0], default=(1, None, 1))
        if len(whole) < 2 or len(data) != 2 * SLOT:
            raise Unreadable("the journal of the latch is damaged, or its last write was torn", record)
        if self._in_memory()[0] > self._number:
            raise Unreadable("the disk never got what was written to the journal of the latch last", record)
        if self._store.interrupted:
            raise Unreadable(self._store.interrupted, record)
        return record

    def write(self, record: Any, counts: Sequence[int] = ()) -> None:
        """Replace the record, and the counts with it: it survives this process at once, and a loss of power when the disk has taken it."""
        # what the disk may be writing just now is written over: the other slot is the one it surely holds
        self._put(1 - self._slot if self._store.settled else self._slot, record, counts)

    def renew(self, record: Any) -> None:
        """Write both slots: after damage one alone would leave the other torn."""
        self._put(0, record)
        self._put(1, record)

    def _put(self, slot: int, record: Any, counts: Sequence[int] = ()) -> None:
        self._number, self.trouble = self._number + 1, ""
        self.count(counts)  # before the disk: what that never gets is missed at the next start
        try:
            self._store.write(SLOT * slot, _slot(self._number, record))
            self._slot = slot
            self._store.flush()
        except (OSError, ValueError, TypeError, msgspec.MsgspecError) as e:
            self.trouble = f"the journal of the latch cannot be written ({e}); a restart would not know of what came last"

    def count(self, counts: Sequence[int]) -> None:
        """What has grown since the record was written, at most `MOST_COUNTS` of them: survives this process, not the machine."""
        counts = counts[:MOST_COUNTS]  # the first is the sum: of joints by the dozen it is what a restart must know
        try:
            body = _COUNTS.pack(self._number, len(counts), *counts, *[0] * (MOST_COUNTS - len(counts)))
            self._store.write_counts(body + hashlib.blake2b(body, digest_size=_DIGEST).digest())
        except (OSError, struct.error) as e:
            self.trouble = f"the counts of the latch cannot be written ({e}); a restart would know those of a second ago"

    def counted(self) -> list[int]:
        """What `count` was given last, with the record that was read or after it; empty if that was nothing."""
        number, counts = self._in_memory()
        return counts if number >= self._number else []

    def _in_memory(self) -> tuple[int, list[int]]:
        """The number of the record that was counted for last, and what; zero where nothing was, or nothing whole."""
        try:
            data = self._store.read_counts()
        except OSError:
            return 0, []
        body, digest = data[: _COUNTS.size], data[_COUNTS.size :]
        if len(body) != _COUNTS.size or hashlib.blake2b(body, digest_size=_DIGEST).digest() != digest:
            return 0, []
        number, many, *counts = _COUNTS.unpack(body)
        return number, counts[:many]

    def look(self) -> None:
        """Whether a restart would find it, and the disk has got it."""
        self.trouble = self._store.astray or self.trouble

    def close(self) -> None:
        self._store.close()
