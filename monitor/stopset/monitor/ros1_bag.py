"""The bags of ROS 1 (format 2.0): records of named fields, most of them packed into chunks.

Source: the format's description at wiki.ros.org/Bags/Format/2.0. What a file claims of its sizes is held against what it is.
"""

from __future__ import annotations

import bz2
import mmap
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path

from stopset.errors import BusError, RecordingError
from stopset.monitor.jointstate import JointState, decode_ros1
from stopset.unpacked import MESSAGE, Allowance, TooLargeError, as_declared, check_piece

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE_DATA, CHUNK, CONNECTION = 0x02, 0x05, 0x07  # of a record's field `op`
JOINT_STATE = "sensor_msgs/JointState"


@dataclass(frozen=True, slots=True)
class Connection:
    """Who wrote what: its ``topic`` and the ``kind`` of its messages."""

    topic: str
    kind: str


def joint_states(path: Path, topic: str) -> list[JointState]:
    """Messages of a topic, by the time at which they were recorded. Raises `RecordingError`."""
    found: list[tuple[int, bytes]] = []
    theirs: dict[int, Connection] = {}
    try:
        for op, fields, data in _unpacked(path):
            if op == CONNECTION:
                theirs[_number(fields, b"conn")] = _connection(fields, data)
            elif op == MESSAGE_DATA:
                by = theirs.get(_number(fields, b"conn"))
                if by == Connection(topic, JOINT_STATE):
                    seconds, nanoseconds = struct.unpack("<II", _field(fields, b"time", 8))
                    found.append((seconds * 1_000_000_000 + nanoseconds, data))
        return [decode_ros1(data) for _, data in sorted(found, key=itemgetter(0))]
    except TooLargeError as e:
        raise RecordingError(f"{path} {e}") from e
    except (ValueError, RuntimeError, OSError, EOFError, struct.error, MemoryError, BusError) as e:
        why = f"{type(e).__name__}: {str(e)[:200]}"
        raise RecordingError(
            f"{path} is not a readable bag of ROS 1 ({why}); copy it again, or mend it with rosbag reindex"
        ) from e


def topics(path: Path) -> dict[str, str]:
    """Name and kind of what a readable bag holds."""
    found = (_connection(fields, data) for op, fields, data in _unpacked(path) if op == CONNECTION)
    return {c.topic: c.kind for c in found}


def _unpacked(path: Path) -> Iterator[tuple[int, dict[bytes, bytes], bytes]]:
    """Kind, fields and data of all records, those of a chunk at its place."""
    with (
        path.open("rb") as f,
        mmap.mmap(f.fileno(), 0, access=mmap.ACCESS_READ) as whole,
    ):  # with cameras a bag is larger than memory
        if whole[: len(MAGIC)] != MAGIC:
            raise ValueError(f"begins with {whole[: len(MAGIC)]!r}, expected {MAGIC!r}")
        allowance = Allowance.of(len(whole))
        for op, fields, data in _records(whole, len(MAGIC)):
            if op == CHUNK:
                inside = _chunk(fields, data)
                allowance.take(len(inside))
                yield from _counted(_records(inside, 0), allowance)
            else:
                yield op, fields, data


def _counted(
    records: Iterator[tuple[int, dict[bytes, bytes], bytes]], allowance: Allowance
) -> Iterator[tuple[int, dict[bytes, bytes], bytes]]:
    for record in records:
        allowance.take(MESSAGE)
        yield record


def _records(data: bytes | mmap.mmap, at: int) -> Iterator[tuple[int, dict[bytes, bytes], bytes]]:
    while at < len(data):
        header, at = _piece(data, at)
        body, at = _piece(data, at)
        fields = {}
        k = 0
        while k < len(header):
            field, k = _piece(header, k)
            name, _, value = field.partition(b"=")
            fields[name] = value
        yield _field(fields, b"op", 1)[0], fields, body


def _piece(data: bytes | mmap.mmap, at: int) -> tuple[bytes, int]:
    """What stands behind its length at ``at``, and where it ends."""
    (size,) = struct.unpack_from("<I", data, at)
    end = at + 4 + size
    if end > len(data):
        raise ValueError(f"breaks off: {size} bytes are announced at {at} of {len(data)}")
    return data[at + 4 : end], end


def _chunk(fields: dict[bytes, bytes], data: bytes) -> bytes:
    declared, how = _number(fields, b"size"), _field(fields, b"compression")
    check_piece(declared)
    if how == b"bz2":
        data = bz2.BZ2Decompressor().decompress(data, max_length=declared + 1)
    elif how == b"lz4":
        import lz4.frame

        data = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=declared + 1)
    elif how != b"none":
        raise ValueError(f"compression {how[:20]!r}, expected none, bz2 or lz4")
    return as_declared(data, declared)


def _connection(fields: dict[bytes, bytes], data: bytes) -> Connection:
    head, k = {}, 0
    while k < len(data):
        field, k = _piece(data, k)
        name, _, value = field.partition(b"=")
        head[name] = value
    return Connection(_field(fields, b"topic").decode(), _field(head, b"type").decode())


def _field(fields: dict[bytes, bytes], name: bytes, size: int | None = None) -> bytes:
    value = fields.get(name)
    if value is None or (size is not None and len(value) != size):
        raise ValueError(f"a record without a {name.decode()} of its size")
    return value


def _number(fields: dict[bytes, bytes], name: bytes) -> int:
    return int.from_bytes(_field(fields, name, 4), "little")
