"""Write recordings in the format that `stopset.recording.reader` reads."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from stopset.files import replacing
from stopset.recording.types import Meta, Recording

GROUP_ROWS = 65_536  # rows gathered before they are written: one group per short trial costs more in headers than in data


def write_recordings(path: str | Path, meta: Meta, trials: Iterable[Recording]) -> None:
    """Write ``trials`` one after the other to a Parquet file, float32 signals, zstd; the file appears only when complete.

    Raises `OutputError` when the place cannot be written.
    """
    head: dict[str, Any] = {
        "robot": meta.robot, "joints": list(meta.joints), "effort": meta.effort, "velocity": meta.velocity,
        "clock": meta.clock, "rate_hz": None if np.isnan(meta.rate_hz) else meta.rate_hz,
    }  # fmt: skip
    if meta.torque_constant is not None:
        head["torque_constant"] = list(meta.torque_constant)
    with replacing(path) as part:
        writer: pq.ParquetWriter | None = None
        waiting: list[pa.Table] = []

        def flush() -> None:
            nonlocal writer
            if waiting:
                table = pa.concat_tables(waiting).combine_chunks()
                writer = writer or pq.ParquetWriter(part, table.schema, compression="zstd")
                writer.write_table(table)
                waiting.clear()

        try:
            for r in trials:
                waiting.append(_table(r, meta).replace_schema_metadata({"recording": json.dumps(head)}))
                if sum(t.num_rows for t in waiting) >= GROUP_ROWS:
                    flush()
            flush()
        finally:
            if writer is not None:
                writer.close()


def _table(r: Recording, meta: Meta) -> pa.Table:
    rows = len(r.t)
    columns: dict[str, pa.Array] = {
        "suite": pa.array(np.full(rows, r.suite, np.int32)),
        "trial": pa.array(np.full(rows, r.trial, np.int32)),
        "phase": pa.array([r.phase] * rows),
        "t": pa.array(r.t),
    }
    for prefix, signal in (("q", r.q), ("dq", r.dq), ("tau", r.tau), ("temp", r.temp), ("i", r.current), ("q_link", r.q_link)):
        if signal is not None:
            for k, j in enumerate(meta.joints):
                if prefix == "q_link" and np.isnan(signal[:, k]).all():
                    continue  # that joint has no second encoder
                columns[f"{prefix}_{j}"] = pa.array(signal[:, k].astype(np.float32))
    if r.stop_trigger is not None:
        columns["stop_trigger"] = pa.array(r.stop_trigger)
    return pa.table(columns)
