"""What must survive a restart: one small record on disk, replaced in place, so that it needs no free space when it counts.

The file has two slots of fixed size. The one that the disk surely holds is not touched: a write that power loss tears leaves the other
slot whole. A slot carries a running number and a digest. The file is born complete, so whatever is not two whole slots is damage, and
damage is `Unreadable`: the reader of it must assume the worst, and gets what is whole with it. So is a file that is gone from where one
was begun: a small one beside it, hidden, remembers that. A folder that is gone with both is a first start.

Counts change every cycle, too often for the disk. They stand in a hidden file of their own, in the system's memory, which outlives the
process but not the machine; they hold for the record whose number they carry.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import hashlib
import os
import struct
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

import msgspec

from stopset.errors import OutputError

SLOT = 16384
_HEAD = struct.Struct("<8sQI")  # mark, number, length of the record
_MARK = b"STPSLTCH"
_DIGEST = 16
_GONE = bytes(2 * SLOT)  # of a journal that was begun and is not there any more
_COUNTS = struct.Struct("<64Q")  # number of the record, how many counts, they themselves
MOST_COUNTS = 62
LOOKED_AT = 1.0  # [s] between two looks whether the file is still where it was
_WORDS = (
    b"A journal of stopset's monitor was begun beside this file. Where it is gone the monitor takes a violation for latched.\n"
)


class Store(Protocol):
    """Where the two slots lie, and the counts; may raise `OSError`.

    ``flush`` starts making what was written last, and need not wait: ``settled`` once the disk has all of it. ``astray``: a restart
    would not find it, in words, empty if it would.
    """

    @property
    def settled(self) -> bool: ...
    @property
    def astray(self) -> str: ...
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


def blank(record: Any) -> bytes:
    """A whole journal that holds ``record``."""
    return _slot(0, record) + _slot(1, record)


class Journal:
    """The record, read once with `read`, replaced with `write`. ``trouble``: words of the last failure, empty if none."""

    def __init__(self, store: Store) -> None:
        self.trouble = ""
        self._store, self._number, self._slot = store, 1, 1

    def read(self) -> Any:
        """The record written last; raises `Unreadable` for a damaged, foreign or torn journal."""
        try:
            data = self._store.read()
            if data == _GONE:
                raise Unreadable("the journal of the latch was taken away since it was begun")
            slots = [_read_slot(part) for at in (0, SLOT) if len(part := data[at : at + SLOT]) == SLOT]
        except (OSError, msgspec.MsgspecError, UnicodeDecodeError) as e:
            raise Unreadable(f"the journal of the latch cannot be read ({e})") from e
        whole = [(*found, k) for k, found in enumerate(slots) if found is not None]
        self._number, record, self._slot = max(whole, key=lambda s: s[0], default=(1, None, 1))
        if len(whole) < 2 or len(data) != 2 * SLOT:
            raise Unreadable("the journal of the latch is damaged, or its last write was torn", record)
        return record

    def write(self, record: Any) -> None:
        """Replace the record: it survives this process at once, and a loss of power when the disk has taken it."""
        # what the disk may be writing just now is written over: the other slot is the one it surely holds
        self._put(1 - self._slot if self._store.settled else self._slot, record)

    def renew(self, record: Any) -> None:
        """Write both slots: after damage one alone would leave the other torn."""
        self._put(0, record)
        self._put(1, record)
        self.count([])  # what stands there may be of a journal that is gone, and number higher

    def _put(self, slot: int, record: Any) -> None:
        try:
            self._number += 1
            self._store.write(SLOT * slot, _slot(self._number, record))
            self._slot = slot
            self._store.flush()
            self.trouble = ""
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
        try:
            data = self._store.read_counts()
        except OSError:
            return []
        body, digest = data[: _COUNTS.size], data[_COUNTS.size :]
        if len(body) != _COUNTS.size or hashlib.blake2b(body, digest_size=_DIGEST).digest() != digest:
            return []
        number, many, *counts = _COUNTS.unpack(body)
        return counts[:many] if number >= self._number else []

    def look(self) -> None:
        """Whether a restart would find it."""
        self.trouble = self._store.astray or self.trouble

    def close(self) -> None:
        self._store.close()


class FileStore:
    """Two slots in a file, made at a first start, locked against a second daemon. Raises `OutputError`.

    A thread waits for the disk, and looks whether the file is still where it was, so that the loop does not.
    """

    def __init__(self, path: Path, first: Any) -> None:
        begun, counts = path.with_name(f".{path.name}.begun"), path.with_name(f".{path.name}.counts")
        try:
            if path.exists() and not path.is_file():
                raise OutputError(
                    f"the journal of the latch {path} is no file that lasts; expected one, or none yet: name another place"
                )
            if not path.exists():
                _make(path, _GONE if begun.exists() else blank(first))
            if not begun.exists():  # only now: a start that ends in between is a first one still
                _make(begun, _WORDS)
            self._fd = os.open(path, os.O_RDWR | os.O_CLOEXEC)
            if not counts.exists():  # with room for all that is written there later
                _make(counts, bytes(_COUNTS.size + _DIGEST))
            self._counts = os.open(counts, os.O_RDWR | os.O_CLOEXEC)
        except OSError as e:
            raise OutputError(
                f"the journal of the latch {path} cannot be written ({e.strerror}); without it a restart would forget a "
                "violation: name a writable place with journal = in the configuration"
            ) from e
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as e:
            os.close(self._fd)
            os.close(self._counts)
            raise OutputError(
                f"another monitor holds the journal {path}; expected one monitor per arm: stop the other, or give this arm "
                "a journal of its own"
            ) from e
        self._path, self.astray = path, ""
        self._wake, self._closing = threading.Event(), False
        self._asked = self._synced = 0
        self._thread = threading.Thread(target=self._sync, daemon=True, name="journal")
        self._thread.start()

    def read(self) -> bytes:
        return os.pread(self._fd, 2 * SLOT + 1, 0)

    def write(self, offset: int, data: bytes) -> None:
        if os.pwrite(self._fd, data, offset) != len(data):
            raise OSError("only a part was written")
        if os.fstat(self._fd).st_size > 2 * SLOT:  # what somebody put behind it would be damage at every start
            os.ftruncate(self._fd, 2 * SLOT)

    def flush(self) -> None:
        self._asked += 1
        self._wake.set()

    @property
    def settled(self) -> bool:
        return self._synced == self._asked

    def read_counts(self) -> bytes:
        return os.pread(self._counts, 4096, 0)

    def write_counts(self, data: bytes) -> None:
        # within a page: a kill comes before it or after it. Not into mapped memory: a disk without room ends who writes there
        os.pwrite(self._counts, data, 0)

    def _sync(self) -> None:
        while not self._closing:
            woken = self._wake.wait(LOOKED_AT)
            self.astray = self._astray()
            if not woken:
                continue
            self._wake.clear()
            asked = self._asked
            with contextlib.suppress(OSError):  # the next write meets the same disk and says so
                os.fdatasync(self._fd)
                self._synced = asked

    def _astray(self) -> str:
        try:
            there, ours = self._path.stat(), os.fstat(self._fd)
            found = (there.st_dev, there.st_ino) == (ours.st_dev, ours.st_ino)
        except OSError:
            found = False
        return (
            ""
            if found
            else (
                f"the journal of the latch is no longer at {self._path}, where a restart would look for it: what was seen may be forgotten then; "
                "start the monitor anew while somebody watches the arm"
            )
        )

    def close(self) -> None:
        self._closing = True
        self._wake.set()
        self._thread.join(timeout=1.0)
        with contextlib.suppress(OSError):
            os.fdatasync(self._fd)
        os.close(self._fd)
        os.close(self._counts)


def _make(path: Path, data: bytes) -> None:
    """The file is there whole, also after a loss of power, or not at all."""
    part = path.with_name(f".{path.name}.{os.getpid()}")
    fd = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    try:
        if os.write(fd, data) != len(data):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        os.fsync(fd)
        part.rename(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
    finally:
        os.close(fd)
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
