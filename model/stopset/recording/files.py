"""Files of recordings, opened: Parquet, CSV with its metadata in a JSON beside it, or an MCAP file that a monitor wrote."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from stopset.errors import RecordingError
from stopset.recording.csv_table import open_csv
from stopset.recording.meta import is_signal
from stopset.recording.seen import open_seen
from stopset.unpacked import Allowance, TooLargeError

BATCH_ROWS = 65_536
# what `stopset import` makes recordings of
LOGS = frozenset({".bag", ".db3", ".zstd", ".log", ".asc", ".blf", ".trc", ".gz", ".txt", ".tsv", ".dat", ".npz", ".mat"})
TICKS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}  # [s] of a time of day


def files_of(paths: str | Path | Sequence[str | Path]) -> list[Path]:
    """The files named. Raises `RecordingError` for what is none."""
    out = [Path(paths)] if isinstance(paths, (str, Path)) else [Path(p) for p in paths]
    for p in out:
        if p.is_dir():
            raise RecordingError(f"{p} is a directory; expected a recording (Parquet or CSV): name its files")
        if not p.exists():
            raise RecordingError(f"{p}: no such file; expected a recording (Parquet or CSV)")
        if p.stat().st_size == 0:
            raise RecordingError(f"{p} is empty (0 bytes); expected a recording: record or copy it again")
    return out


def opened(path: Path) -> tuple[pa.Schema, Iterator[pa.RecordBatch]]:
    """Columns and batches of rows, ``t`` in seconds. Raises `RecordingError` for what is no such file."""
    if path.suffix.lower() == ".mcap":
        return open_seen(path)
    if path.suffix.lower() in LOGS:
        raise RecordingError(
            f"{path} is a log or a table of another tool; expected a recording (Parquet or CSV): make one with "
            f"`stopset import {path.name} --out REC.parquet`"
        )
    try:
        if path.suffix.lower() == ".csv":
            reader = open_csv(path, is_signal)
            side = path.with_suffix(".json")
            meta = {b"recording": side.read_bytes()} if side.exists() else None
            return _in_seconds(reader.schema.with_metadata(meta), iter(reader))
        file = pq.ParquetFile(path, pre_buffer=False)  # else all of the file is read ahead, and memory grows with it
        Allowance.of(path.stat().st_size, most=sys.maxsize).take(_unpacked_size(file.metadata))
        return _in_seconds(file.schema_arrow, file.iter_batches(batch_size=BATCH_ROWS))
    except TooLargeError as e:
        raise RecordingError(f"{path} {e}") from e
    except (pa.ArrowInvalid, pa.ArrowException, OSError) as e:
        first = str(e).splitlines()[0]
        kind = "CSV table" if path.suffix.lower() == ".csv" else "Parquet file"
        raise RecordingError(f"{path} is not a readable {kind} ({first}); expected a recording: export it again") from e
    except UnicodeDecodeError as e:
        raise RecordingError(
            f"{path} is no text in UTF-8 ({e.reason} at byte {e.start}); expected a CSV table: export it as UTF-8"
        ) from e


def _in_seconds(schema: pa.Schema, batches: Iterator[pa.RecordBatch]) -> tuple[pa.Schema, Iterator[pa.RecordBatch]]:
    """Column t in seconds where it holds times of day, as tables of dates and times do; any other as it is."""
    at = schema.get_field_index("t")
    kind = schema.field(at).type if at >= 0 else None
    if kind is None or not (pa.types.is_timestamp(kind) or pa.types.is_duration(kind)):
        return schema, batches
    tick = TICKS[kind.unit]

    def seconds(batch: pa.RecordBatch) -> pa.RecordBatch:
        t = np.asarray(batch.column(at).cast(pa.int64()).to_numpy(zero_copy_only=False), dtype=float) * tick
        return batch.set_column(at, pa.field("t", pa.float64()), pa.array(t))

    return schema.set(at, pa.field("t", pa.float64())), map(seconds, batches)


def _unpacked_size(file: pq.FileMetaData) -> int:
    """Bytes that a Parquet file says it has without compression, or its columns as numbers of four: what repeats takes none of it."""
    pages = sum(file.row_group(k).total_byte_size for k in range(file.num_row_groups))
    return int(max(pages, 4 * file.num_rows * file.num_columns))


def sha256_of(path: Path) -> str:
    """Of the whole file."""
    with path.open("rb") as f:
        return hashlib.file_digest(f, "sha256").hexdigest()
