"""Frames of CAN log files, by python-can's readers."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import can

from stopset.errors import RecordingError
from stopset.monitor.links.hub import Frame

LOG_SUFFIXES = frozenset({".log", ".asc", ".blf", ".trc"})


def read_log(path: str | Path) -> Iterator[Frame]:
    """Classic data frames in file order; raises `RecordingError` for a file that is none of candump, ASC, BLF, TRC."""
    p = Path(path)
    if not p.is_file():
        what = "is a directory" if p.is_dir() else "no such file"
        raise RecordingError(f"{p}: {what}; expected a candump (.log), ASC, BLF or TRC log")
    if p.suffix.lower() not in LOG_SUFFIXES:
        raise RecordingError(f"{p}: expected a log named .log (candump), .asc, .blf or .trc")
    try:
        with can.LogReader(str(p), **({"relative_timestamp": False} if p.suffix.lower() == ".asc" else {})) as reader:
            for m in reader:
                if not (m.is_extended_id or m.is_remote_frame or m.is_error_frame):
                    yield Frame(m.arbitration_id, m.data, m.timestamp)
    except Exception as e:
        why = f"{type(e).__name__}: {str(e)[:200]}"
        raise RecordingError(f"{p} is not a readable {p.suffix} log ({why}); export it again") from e
