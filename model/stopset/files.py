"""Files appear whole or not at all."""

from __future__ import annotations

import errno
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from stopset.errors import OutputError


def writable(path: str | Path) -> Path:
    """``path`` if a file can be created there, checked before hours of work; raises `OutputError` otherwise."""
    target = Path(path)
    try:
        if target.is_dir():
            raise OutputError(f"{target} is a directory; expected the name of the file to write: add one")
        if not target.parent.is_dir():
            raise OutputError(f"{target.parent} does not exist; create the directory or choose another place")
        # a trial file tells more than permission bits do: the file system itself may refuse
        with tempfile.NamedTemporaryFile(dir=target.parent, prefix=f".{target.name}."):
            pass
    except OSError as e:
        raise _failure(target, e) from e
    return target


# what the system says when there is no room: the disk, the user's share of it, the largest file allowed
NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def _failure(target: Path, e: OSError) -> OutputError:
    if e.errno in NO_ROOM:
        what = "the disk is full" if e.errno == errno.ENOSPC else f"no room to write it ({e.strerror})"
        return OutputError(f"{target}: {what}; nothing was written: free space or choose another place, then run again")
    if e.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
        return OutputError(f"{target.parent} is not writable ({e.strerror}); change its permissions or choose another place")
    return OutputError(f"{target} cannot be written ({e.strerror or e}); choose another place")


def cache_folder() -> Path | None:
    """The user's cache folder for what can be made again, or None where nothing can be written."""
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "stopset"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    return folder if os.access(folder, os.W_OK) else None


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """A temporary file beside ``path`` that takes its name when the block ends well, and vanishes when it does not."""
    target = writable(path)
    part: Path | None = None
    try:
        handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.", suffix=target.suffix)
        os.close(handle)
        part = Path(name)
        yield part
        umask = os.umask(0)
        os.umask(umask)
        part.chmod(0o666 & ~umask)
        with part.open("rb") as f:
            os.fsync(f.fileno())
        part.replace(target)
    except OSError as e:
        raise _failure(target, e) from e
    finally:
        if part is not None:
            part.unlink(missing_ok=True)


def write_text(path: str | Path, text: str) -> None:
    """Write ``text`` (UTF-8) to ``path``, whole or not at all; raises `OutputError`."""
    with replacing(path) as part:
        part.write_text(text, encoding="utf-8")


def write_bytes(path: str | Path, data: bytes) -> None:
    """Write ``data`` to ``path``, whole or not at all; raises `OutputError`."""
    with replacing(path) as part:
        part.write_bytes(data)


def write_private(path: str | Path, data: bytes) -> None:
    """Write ``data`` to ``path`` for its owner's eyes alone, whole or not at all; raises `OutputError`."""
    target = writable(path)
    try:
        with os.fdopen(os.open(target, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as f:
            f.write(data)
            os.fsync(f.fileno())
    except OSError as e:
        raise _failure(target, e) from e
