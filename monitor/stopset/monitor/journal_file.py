"""The journal's place: a file on a disk, written beside the loop, and what is counted in the system's memory, written by the loop itself.

A disk may hang, for a minute or for ever, and the loop must not hang with it. A thread writes; the loop waits a moment for it, so that
what is said next is on its way to the disk, and goes on without it where the disk does not answer. Memory is told first (the number of the
record and the counts), so a process that ends meanwhile has left word that the disk lacks something. A machine that loses its power leaves
no such word; but a life that ends in order, with all it has seen on the disk, says so there, and one that said nothing may have seen more.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import hashlib
import os
import re
import secrets
import stat
import threading
import time
from pathlib import Path
from typing import Any

from stopset.errors import OutputError
from stopset.monitor.journal import COUNTED, GONE, SLOT, blank, many_counted

LOOKED_AT = 1.0  # [s] between two looks whether the file is still where it was
PATIENCE = 0.005  # [s] the loop waits at most until the system has taken a write; while one is under way for longer, not at all
HUNG = 1.0  # [s] without an answer of the disk, then it is said
MEMORY = Path("/dev/shm")
RUNS, ENDED = b"runs \n", b"ended\n"  # as long as each other: the file needs no more room when it changes
_WORDS = (
    "A journal of stopset's monitor was begun beside this file. Where it is gone the monitor takes a violation for latched.\n"
)


class FileStore:
    """Two slots in a file, made at a first start, locked against a second daemon. Raises `OutputError`.

    ``mark``: another file, elsewhere, that remembers that the journal was begun; left out where it cannot be written. ``lost``: there was
    no first start to come: a journal that is not there is lost, and one that was in use when the machine's memory went is `interrupted`.
    """

    def __init__(self, path: Path, first: Any, mark: Path | None = None, *, lost: bool = False) -> None:
        try:
            if path.exists() and not path.is_file():
                raise OutputError(
                    f"the journal of the latch {path} is no file that lasts; expected one, or none yet: name another place"
                )
            name = _begun(path, first, mark, lost=lost)
            self._fd = os.open(path, os.O_RDWR | os.O_CLOEXEC)
        except OSError as e:
            raise OutputError(
                f"the journal of the latch {path} cannot be written ({e.strerror}); without it a restart would forget a "
                "violation: name a writable place with journal = in the configuration"
            ) from e
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as e:
            os.close(self._fd)
            raise OutputError(
                f"another monitor holds the journal {path}; expected one monitor per arm: stop the other, or give this arm "
                "a journal of its own"
            ) from e
        self._path, self._running, self._must = path, path.with_name(f".{path.name}.running"), lost
        self._in_memory, self._counts, found = _counts(path, name)
        self._before = "" if found else _interrupted(self._running, in_memory=self._in_memory is not None)
        self._runs = self._begin()
        self._turn = threading.Condition()  # what follows is shared with the thread
        self._waiting: dict[int, bytes] = {}  # by offset, of two for one place the newer
        self._given = self._taken = self._synced = 0
        self._late, self._closing = False, False
        self._count: bytes | None = None  # for a file on the disk
        self._refused = self._gone = ""
        self._since: float | None = None  # when the thread asked the disk for what it has no answer to yet
        self._thread = threading.Thread(target=self._work, daemon=True, name="journal")
        self._thread.start()

    # ---- the loop's side

    def read(self) -> bytes:
        return os.pread(self._fd, 2 * SLOT + 1, 0)

    def write(self, offset: int, data: bytes) -> None:
        with self._turn:
            self._waiting[offset] = data
            self._given += 1

    def flush(self) -> None:
        """Have it written; waits `PATIENCE` for the system to take it. Raises `OSError` for what it has refused by then."""
        with self._turn:
            self._refused, given = "", self._given
            self._turn.notify_all()
            if not self._late:
                self._late = not self._turn.wait_for(lambda: self._refused or self._taken >= given, PATIENCE)
            if self._refused:
                raise OSError(errno.EIO, self._refused)

    @property
    def settled(self) -> bool:
        return self._synced == self._given

    @property
    def astray(self) -> str:
        since = self._since
        if since is not None and time.monotonic() - since > HUNG:
            return (
                f"the disk of the journal of the latch {self._path} does not answer: what came since is in this machine's memory alone, "
                "which a loss of power would forget; look at the disk"
            )
        return self._gone or self._refused

    @property
    def interrupted(self) -> str:
        return self._before if self._must else ""

    @property
    def notice(self) -> str:
        said = [] if self._must or not self._before else [self._before]
        if self._in_memory is None:
            said.append(
                f"there is no room in the system's memory ({MEMORY}) for what the latch counts: it lies beside the journal, and a kill "
                "while the disk does not answer would forget what was seen meanwhile"
            )
        return "; ".join(said)

    def read_counts(self) -> bytes:
        return os.pread(self._counts, 4096, 0)

    def write_counts(self, data: bytes) -> None:
        if self._in_memory is not None:
            # within a page: a kill comes before it or after it. Not into mapped memory: where there is no room that ends who writes there
            os.pwrite(self._counts, data, 0)
            return
        with self._turn:  # a disk like any other
            self._count = data
            self._turn.notify_all()
            if not self._late:
                self._late = not self._turn.wait_for(lambda: self._count is None, PATIENCE)

    def close(self) -> None:
        """What waits is written if the disk answers; a thread that it holds goes with the process."""
        with self._turn:
            self._closing = True
            self._turn.notify_all()
        self._thread.join(timeout=1.0)
        if self._thread.is_alive():
            return
        if self._in_memory is not None and self.settled and not many_counted(self.read_counts()):
            self._in_memory.unlink(missing_ok=True)  # the disk has all of it
        for fd in (self._fd, self._counts, self._runs):
            if fd >= 0:
                os.close(fd)

    def _begin(self) -> int:
        """Whoever starts next without hearing `ENDED` finds that this life runs; -1 where that cannot be written. Raises `OutputError`."""
        try:
            if not self._running.exists():
                _make(self._running, RUNS)
            fd = os.open(self._running, os.O_RDWR | os.O_CLOEXEC)
            _mark(fd, RUNS)
        except OSError as e:
            if self._must:
                os.close(self._fd)
                os.close(self._counts)
                raise OutputError(
                    f"{self._running} cannot be written ({e.strerror}); expected room for it, as `must_remember` asks: look at the disk"
                ) from e
            return -1
        return fd

    # ---- the thread's

    def _work(self) -> None:
        while True:
            with self._turn:
                self._turn.wait_for(lambda: self._waiting or self._count or self._closing, LOOKED_AT)
                if self._closing and not self._waiting and not self._count:
                    break
                pieces, self._waiting, given, count = self._waiting, {}, self._given, self._count
            self._since = time.monotonic()
            if count is not None:  # before the record: what the disk never gets of that is missed at the next start
                self._write_count(count)
            if pieces:
                self._write(pieces, given)
            self._gone = self._looked_for()
            self._since = None
        if self.settled and self._runs >= 0:
            with contextlib.suppress(OSError):  # then the next start takes it for one that did not end
                _mark(self._runs, ENDED)

    def _write_count(self, data: bytes) -> None:
        try:
            os.pwrite(self._counts, data, 0)
        except OSError as e:
            self._refused = e.strerror or str(e)
        with self._turn:
            if self._count is data:
                self._count = None
            self._late = False
            self._turn.notify_all()

    def _write(self, pieces: dict[int, bytes], given: int) -> None:
        try:
            for offset, data in pieces.items():
                if os.pwrite(self._fd, data, offset) != len(data):
                    raise OSError(errno.EIO, "only a part was written")
            if os.fstat(self._fd).st_size > 2 * SLOT:  # what somebody put behind it would be damage at every start
                os.ftruncate(self._fd, 2 * SLOT)
            with self._turn:
                self._taken, self._late = given, False
                self._turn.notify_all()
            os.fdatasync(self._fd)
            self._synced = given
        except OSError as e:
            with self._turn:
                self._refused, self._late = e.strerror or str(e), False
                self._turn.notify_all()

    def _looked_for(self) -> str:
        """In words, that a restart would not find the file; empty if it would."""
        try:
            there, ours = self._path.stat(), os.fstat(self._fd)
            if (there.st_dev, there.st_ino) == (ours.st_dev, ours.st_ino):
                return ""
        except OSError:
            pass
        return (
            f"the journal of the latch is no longer at {self._path}, where a restart would look for it: what was seen may be forgotten then; "
            "start the monitor anew while somebody watches the arm"
        )


def _begun(path: Path, first: Any, mark: Path | None, *, lost: bool) -> str:
    """Journal and marks are there afterwards; the name that this journal was given when it was begun."""
    begun = path.with_name(f".{path.name}.begun")
    if not path.exists():
        known = lost or begun.exists() or (mark is not None and mark.exists())
        _make(path, GONE if known else blank(first))
    name = re.search(r"^name ([0-9a-f]{32})$", begun.read_text(errors="replace") if begun.exists() else "", re.MULTILINE)
    if name is None:  # only now: a start that ends in between is a first one still
        _make(begun, f"{_WORDS}name {secrets.token_hex(16)}\n".encode())
    if mark is not None and not mark.exists():
        with contextlib.suppress(OSError):  # a configuration is often not the monitor's to write
            _make(mark, f"{_WORDS}It is {path}\n".encode())
    return name[1] if name else _begun(path, first, None, lost=False)


def _interrupted(running: Path, *, in_memory: bool) -> str:
    """In words, that a life before did not end in order, and what it may have known is gone with the machine's memory; else empty."""
    try:
        if running.read_bytes() != RUNS:
            return ""
    except OSError:  # a first start, or one behind a version that left no such word
        return ""
    how = "the machine lost its power, or its memory," if in_memory else "the monitor did not end in order"
    return f"{how} while the monitor ran: what it saw last may never have reached the disk"


def _counts(path: Path, name: str) -> tuple[Path | None, int, bool]:
    """The counts' file, open; where it is if it is in the system's memory, else it is beside the journal; and whether it was there already."""
    # a copy of the folder is another arm's
    place = MEMORY / f"stopset-{hashlib.sha256(f'{name} {path.resolve()}'.encode()).hexdigest()[:32]}"
    beside = path.with_name(f".{path.name}.counts")
    fd = -1
    with contextlib.suppress(OSError):
        fd = os.open(place, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
        found = os.fstat(fd)
        if stat.S_ISREG(found.st_mode) and found.st_uid == os.geteuid() and not found.st_mode & 0o077:
            if found.st_size >= COUNTED:
                return place, fd, True
            if _room(fd, beside):  # for all that is written later
                beside.unlink(missing_ok=True)
                return place, fd, False
            place.unlink()
    if fd >= 0:
        os.close(fd)
    try:
        if not beside.exists():
            _make(beside, bytes(COUNTED))
        return None, os.open(beside, os.O_RDWR | os.O_CLOEXEC), False
    except OSError as e:
        raise OutputError(
            f"the counts of the latch {beside} cannot be written ({e.strerror}); expected room there: look at the disk"
        ) from e


def _room(fd: int, beside: Path) -> bool:
    """Make it, with what a life without any counted beside the journal."""
    counted = beside.read_bytes()[:COUNTED] if beside.exists() else b""
    try:
        return os.pwrite(fd, counted.ljust(COUNTED, b"\0"), 0) == COUNTED
    except OSError:
        return False


def _mark(fd: int, word: bytes) -> None:
    """In place, and on the disk afterwards."""
    if os.pwrite(fd, word, 0) != len(word):
        raise OSError(errno.EIO, os.strerror(errno.EIO))
    os.fdatasync(fd)


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
