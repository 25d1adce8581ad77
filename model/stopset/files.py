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
    if target.is_dir():
        raise OutputError(f"{target} is a directory; expected the name of the file to write: add one")
    if not target.parent.is_dir():
        raise OutputError(f"{target.parent} does not exist; create the directory or choose another --out")
    if not os.access(target.parent, os.W_OK):
        raise OutputError(f"{target.parent} is not writable; change its permissions or choose another --out")
    return target


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """A temporary file beside ``path`` that takes its name when the block ends well, and vanishes when it does not."""
    target = writable(path)
    handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.", suffix=target.suffix)
    os.close(handle)
    part = Path(name)
    try:
        yield part
        umask = os.umask(0)
        os.umask(umask)
        part.chmod(0o666 & ~umask)
        with part.open("rb") as f:
            os.fsync(f.fileno())
        part.replace(target)
    except OSError as e:
        if e.errno in (errno.ENOSPC, errno.EDQUOT):
            raise OutputError(f"{target}: the disk is full; nothing was written: free space and run again") from e
        raise OutputError(f"{target} cannot be written ({e.strerror or e}); choose another place") from e
    finally:
        part.unlink(missing_ok=True)


def write_text(path: str | Path, text: str) -> None:
    """Write ``text`` (UTF-8) to ``path``, whole or not at all; raises `OutputError`."""
    with replacing(path) as part:
        part.write_text(text, encoding="utf-8")


def write_bytes(path: str | Path, data: bytes) -> None:
    """Write ``data`` to ``path``, whole or not at all; raises `OutputError`."""
    with replacing(path) as part:
        part.write_bytes(data)
