"""Frames of CAN log files, by python-can's readers."""

from __future__ import annotations

import gzip
import io
import math
import re
import struct
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import BinaryIO, TextIO

import can
from can.io.generic import MessageReader

from stopset.errors import RecordingError
from stopset.monitor.links.batch import Frame
from stopset.unpacked import Allowance, TooLargeError, Unpacking, check_piece, inflated

LOG_SUFFIXES = frozenset({".log", ".asc", ".blf", ".trc"})


def log_suffix(path: Path) -> str:
    """The format by name, ``.gz`` taken off."""
    return Path(path.stem if path.suffix.lower() == ".gz" else path.name).suffix.lower()


def read_log(path: str | Path) -> Iterator[Frame]:
    """Classic data frames in file order; raises `RecordingError` for a file that is none of candump, ASC, BLF, TRC."""
    p = Path(path)
    if not p.is_file():
        what = "is a folder without a bag's metadata.yaml" if p.is_dir() else "no such file"
        raise RecordingError(f"{p}: {what}; expected a candump (.log), ASC, BLF or TRC log")
    suffix = log_suffix(p)
    if suffix not in LOG_SUFFIXES:
        raise RecordingError(
            f"{p}: expected a log named .log (candump), .asc, .blf or .trc, perhaps .gz; or .mcap, .db3, .bag, .csv of RTDE to import"
        )
    try:
        for frame in _frames(p, suffix):
            if not math.isfinite(frame.t):
                raise ValueError(f"frame {frame.cob_id:03X} is stamped {frame.t}")
            yield frame
    except TooLargeError as e:
        raise RecordingError(f"{p} {e}") from e
    except Exception as e:
        why = f"{type(e).__name__}: {str(e)[:200]}"
        raise RecordingError(f"{p} is not a readable {suffix} log ({why}); export it again") from e


def _frames(p: Path, suffix: str) -> Iterator[Frame]:
    if suffix == ".log" and (screen := _screen_lines(p)) is not None:
        yield from screen
        return
    with _reader(p, suffix) as reader:
        for m in reader:
            if not (m.is_extended_id or m.is_remote_frame or m.is_error_frame):
                yield Frame(m.arbitration_id, m.data, m.timestamp)


def _reader(p: Path, suffix: str) -> MessageReader:
    allowance = Allowance.of(p.stat().st_size)
    if suffix == ".blf":
        return _Blf(_bytes(p, allowance), allowance)
    text = _text(p, allowance)
    if suffix == ".asc":
        return can.ASCReader(text, relative_timestamp=False)
    return can.TRCReader(text) if suffix == ".trc" else can.CanutilsLogReader(text)


def _bytes(p: Path, allowance: Allowance) -> BinaryIO:
    """What a log holds, unpacked where it is .gz."""
    return io.BufferedReader(Unpacking(gzip.open(p), allowance)) if p.suffix.lower() == ".gz" else p.open("rb")


def _text(p: Path, allowance: Allowance) -> TextIO:
    return io.TextIOWrapper(_bytes(p, allowance), encoding="utf-8-sig", errors="replace")


_OBJECT = struct.Struct("<4s4xII")  # head of any object in a BLF file: LOBJ, its size with the head, its kind
_CONTAINER = struct.Struct("<H6xI4x")  # a container's own head: how it is packed, bytes unpacked
_KIND_CONTAINER, _STORED, _ZLIB = 10, 0, 2


class _Blf(can.BLFReader):
    """Takes no more out of a container than it declares, and no object that is shorter than its own head, at which python-can stays
    for ever."""

    def __init__(self, file: BinaryIO, allowance: Allowance) -> None:
        super().__init__(file)
        self._allowance = allowance

    def __iter__(self) -> Iterator[can.Message]:  # type: ignore[override]
        while head := self.file.read(_OBJECT.size):
            signature, size, kind = _OBJECT.unpack(head)
            if signature != b"LOBJ":
                raise ValueError("no object where one should begin")
            _check_object(size)
            body = self.file.read(size - _OBJECT.size)
            self.file.read(size % 4)
            if kind != _KIND_CONTAINER:
                continue
            packing, declared = _CONTAINER.unpack_from(body)
            data = body[_CONTAINER.size :]
            if packing not in (_STORED, _ZLIB):
                raise ValueError(f"a container packed by method {packing}, expected {_STORED} or {_ZLIB}")
            if packing == _ZLIB:
                data = inflated(data, declared)
            self._allowance.take(len(data))
            yield from self._parse_container(data)
        self.stop()

    def _parse_container(self, data: bytes) -> Iterator[can.Message]:
        at, whole = 0, self._tail + data
        while (at := whole.find(b"LOBJ", at, at + 8)) >= 0 and at + _OBJECT.size <= len(whole):
            _, size, _ = _OBJECT.unpack_from(whole, at)
            _check_object(size)
            at += size
        return super()._parse_container(data)


def _check_object(size: int) -> None:
    if size < _OBJECT.size:
        raise ValueError(f"an object of {size} bytes, shorter than its head of {_OBJECT.size}")
    check_piece(size)


# what candump shows on the screen: "(1436509052.249713)  can0  123   [2]  11 22"; with -x "RX - -" before the identifier, with -a
# the bytes as text behind; of CAN FD the length has two digits
_SCREEN = re.compile(
    r"^\s*(?:\(([\d.: -]+)\)\s+)?\S+\s+(?:[RT]X\s+\S+\s+\S+\s+)?([0-9A-Fa-f]{3,8})\s+\[(\d+)\]((?:\s+[0-9A-Fa-f]{2})*)\s*(?:'.*|ERRORFRAME)?$"
)
_LOGGED = re.compile(r"^\s*\([\d.]+\)\s+\S+\s+[0-9A-Fa-f]+#")  # "(1436509052.249713) can0 123#1122"
_CLASSIC = 8  # bytes


def _screen_lines(p: Path) -> Iterator[Frame] | None:
    """Frames of a log in candump's screen format; None if it is its own. Raises ValueError for lines that are none, or unstamped."""
    with _text(p, Allowance.of(p.stat().st_size)) as f:
        first = next((line for line in f if line.strip()), "")
    if first and not _SCREEN.match(first) and not _LOGGED.match(first):
        raise ValueError(f"its first line is not candump's: {first.strip()[:60]!r}")
    return _frames_of_screen(p) if _SCREEN.match(first) else None


def _frames_of_screen(p: Path) -> Iterator[Frame]:
    with _text(p, Allowance.of(p.stat().st_size)) as f:
        began = last = math.nan
        for number, line in enumerate(f, 1):
            found = _SCREEN.match(line)
            if found is None and line.strip() and "remote request" not in line:
                raise ValueError(f"line {number} is not candump's")
            if found is None or len(found[2]) > 3 or int(found[3]) > _CLASSIC:  # an extended identifier, an error, CAN FD
                continue
            data = bytes.fromhex(found[4])
            if found[1] is None or len(data) != int(found[3]):
                raise ValueError(f"line {number} has no absolute stamp (candump -t a), or not the bytes it says")
            t = _stamp(found[1])
            began = t if math.isnan(began) else began
            if began == 0.0 and t < last:
                raise ValueError(
                    f"line {number}: its stamps are the pauses between frames (candump -t d), of which some may be lost; use -t a"
                )
            last = t
            yield Frame(int(found[2], 16), data, t)


def _stamp(text: str) -> float:
    """[s] of "1436509052.249713" (-t a, -t z) or, at this place's time, "2015-07-10 05:10:52.249713" (-t A)."""
    return float(text) if text.count("-") < 2 else datetime.fromisoformat(text).timestamp()
