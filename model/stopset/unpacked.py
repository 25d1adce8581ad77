"""What comes out of compressed files, bounded: a few bytes may claim, or unpack to, more than any machine holds.

A file gives at most `RATIO` times its size, a piece that is held at once at most `PIECE`, and never more than it has declared.
"""

from __future__ import annotations

import io
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from mcap.records import Chunk, McapRecord

RATIO = 100  # candump of an arm that stands still: 16 by gzip, 46 by zstd at its level 19, 8 as BLF; moving 6, 12 and 5
FREE = 64 * 2**20  # bytes that are too much for nobody, whatever they were
PIECE = (
    64 * 2**20
)  # bytes of a container or chunk; writers make 64 KiB to 8 MiB, one message of a camera or a scanner some 30 MiB
TOTAL = 8 * 2**30  # bytes of one file; a candump of six joints at 250 Hz is sixteen hours long by then
MESSAGE = 200  # bytes that Python takes for a message beside its own


class TooLargeError(ValueError):
    """A file unpacks to more than is taken; what it says goes on after the file's name."""


@dataclass(slots=True)
class Allowance:
    """Bytes that may still come out of a file."""

    most: int
    left: int

    @classmethod
    def of(cls, packed: int, most: int = TOTAL) -> Allowance:
        """For a file of ``packed`` bytes, at most ``most``: `TOTAL` where memory grows with what comes out."""
        allowed = min(most, max(FREE, RATIO * packed))
        return cls(allowed, allowed)

    def take(self, size: int) -> None:
        """Count what came out, or will. Raises `TooLargeError` where it is too much."""
        self.left -= size
        if self.left < 0:
            raise TooLargeError(
                f"unpacks to more than {self.most / 2**20:.0f} MiB; expected at most {RATIO} times its size and {TOTAL / 2**30:.0f} GiB, as "
                "of a log or a recording: export it again, or unpack it yourself if you trust it"
            )


class Readable(Protocol):
    """What bytes are read from."""

    def read(self, size: int, /) -> bytes: ...
    def close(self) -> None: ...


class Unpacking(io.RawIOBase):
    """The bytes of ``source``, counted as they come."""

    def __init__(self, source: Readable, allowance: Allowance) -> None:
        self._source, self._allowance = source, allowance

    def readable(self) -> bool:
        return True

    def readinto(self, into: memoryview) -> int:  # type: ignore[override]
        data = self._source.read(len(into))
        self._allowance.take(len(data))
        into[: len(data)] = data
        return len(data)

    def close(self) -> None:
        self._source.close()
        super().close()


def check_piece(claimed: int) -> None:
    """Raises ValueError for a piece that says it is larger than any."""
    if claimed > PIECE:
        raise ValueError(f"a piece of {claimed} bytes, expected at most {PIECE}")


def inflated(data: bytes, declared: int) -> bytes:
    """A zlib stream that makes what it has ``declared``. Raises ValueError where it does not, zlib.error where it is none."""
    check_piece(declared)
    stream = zlib.decompressobj()
    return as_declared(stream.decompress(data, declared + 1), declared)


def chunk_data(chunk: Chunk) -> bytes:
    """What an MCAP chunk holds. Raises ValueError where it is not of the size declared, and what its library raises for damage."""
    declared = chunk.uncompressed_size
    check_piece(declared)
    if chunk.compression == "zstd":
        import zstandard

        stream: IO[bytes] = zstandard.ZstdDecompressor().stream_reader(chunk.data, read_across_frames=True)
    elif chunk.compression == "lz4":
        import lz4.frame

        stream = lz4.frame.open(io.BytesIO(chunk.data))
    elif not chunk.compression:
        stream = io.BytesIO(chunk.data)
    else:
        raise ValueError(f"compression {chunk.compression!r}, expected zstd or lz4")
    with stream:
        return as_declared(stream.read(declared + 1), declared)


def as_declared(data: bytes, declared: int) -> bytes:
    """``data``. Raises ValueError where it is not of the size declared."""
    if len(data) != declared:
        raise ValueError(f"a piece that declares {declared} bytes and holds {'more' if len(data) > declared else len(data)}")
    return data


def mcap_records(stream: IO[bytes]) -> Iterator[McapRecord]:
    """The records of an MCAP file in its order, those of a chunk at its place."""
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader, breakup_chunk

    for record in StreamReader(stream, emit_chunks=True).records:
        if isinstance(record, Chunk):
            yield from breakup_chunk(replace(record, compression="", data=chunk_data(record)))
        else:
            yield record


def check_zip(file: Path | io.BytesIO) -> None:
    """Raises `TooLargeError` where the files in an archive say that they are too large together; zipfile holds them to it."""
    packed = len(file.getbuffer()) if isinstance(file, io.BytesIO) else file.stat().st_size
    with zipfile.ZipFile(file) as archive:
        Allowance.of(packed).take(sum(member.file_size for member in archive.infolist()))
