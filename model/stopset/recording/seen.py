"""What a monitor has written down (MCAP with JSON joint states), read as a recording.

Every stretch without a lost cycle is a suite of one trial: none repeats another.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa

from stopset.errors import RecordingError
from stopset.unpacked import MESSAGE, Allowance, TooLargeError, mcap_records

SIGNALS = {"q": "position", "dq": "velocity", "tau": "effort", "temp": "temperature"}


def open_seen(path: Path) -> tuple[pa.Schema, Iterator[pa.RecordBatch]]:
    """The table of a recording, as if it stood in a Parquet file. Raises `RecordingError` for other MCAP files.

    A file that breaks off, because the machine lost its power, is read as far as it goes.
    """
    about, rows, causes = _read(path)
    if about is None:
        raise RecordingError(
            f"{path} is an MCAP file, but none that a monitor has written; expected its joint states: bring it in with stopset import"
        )
    try:
        joints, cycle = about["joints"].split(","), float(about["cycle_s"])
        table = _table(rows, joints, cycle)
        meta = {
            "robot": about["robot"], "joints": joints, "effort": about["effort"], "velocity": "measured", "clock": "recorded",
            "rate_hz": 1.0 / cycle, "said": [f"{c['kind'].replace('_', ' ')}: {c['says']}" for c in causes],
        }  # fmt: skip
    except (KeyError, TypeError, ValueError, ArithmeticError, pa.ArrowException) as e:
        raise RecordingError(f"{path} is no sound record of a monitor ({type(e).__name__}: {e}); copy it again") from e
    table = table.replace_schema_metadata({b"recording": json.dumps(meta).encode()})
    return table.schema, iter(table.to_batches())


def _read(path: Path) -> tuple[dict[str, str] | None, list[dict[str, Any]], list[dict[str, Any]]]:
    """What the file is about, its joint states, what the monitor took for the causes of violations."""
    try:
        from mcap.records import Channel, Message, Metadata
    except ImportError as e:
        raise RecordingError(f"{path} needs the package mcap to be read; install stopset[monitor]") from e
    about: dict[str, str] | None = None
    wanted = {"stopset/joint_states": (rows := list[dict[str, Any]]()), "stopset/cause": (causes := list[dict[str, Any]]())}
    channels: dict[int, list[dict[str, Any]]] = {}
    begun, allowance = False, Allowance.of(path.stat().st_size)
    with path.open("rb") as f:
        try:
            for record in mcap_records(f):
                begun = True
                if isinstance(record, Metadata) and record.name == "stopset":
                    about = record.metadata
                elif isinstance(record, Channel) and record.topic in wanted:
                    channels[record.id] = wanted[record.topic]
                elif isinstance(record, Message) and record.channel_id in channels:
                    allowance.take(MESSAGE + len(record.data))
                    channels[record.channel_id].append(json.loads(record.data))
        except TooLargeError as e:
            raise RecordingError(f"{path} {e}") from e
        except Exception as e:  # a damaged length or chunk ends the reader in the words of zstandard, struct or Python
            if not (begun and rows):
                raise RecordingError(f"{path} is not a readable MCAP file ({type(e).__name__}: {e}); copy it again") from e
    return about, rows, causes


def _table(rows: list[dict[str, Any]], joints: list[str], cycle_s: float) -> pa.Table:
    columns: dict[str, list[Any]] = {"phase": [], "suite": [], "trial": [], "t": []}
    signals = [s for s in SIGNALS if s != "temp" or all("temperature" in r for r in rows)]
    for s in signals:
        columns |= {f"{s}_{j}": [] for j in joints}
    stretch, before, start = -1, None, 0
    for r in rows:
        k = int(r["k"])
        values = [r[SIGNALS[s]] for s in signals]
        if any(v is None for row in values for v in row):  # no verdict was possible either
            before = None
            continue
        if before is None or k != before + 1:
            stretch, start = stretch + 1, k
        before = k
        for name, value in zip(("phase", "suite", "trial", "t"), ("closed_loop", stretch, 0, (k - start) * cycle_s), strict=True):
            columns[name].append(value)
        for s, row in zip(signals, values, strict=True):
            for j, x in zip(joints, row, strict=True):
                columns[f"{s}_{j}"].append(float(x))
    table = pa.table(columns)
    count = Counter(columns["suite"])  # a single sample between two gaps is no motion
    return table.filter(pa.array([count[k] > 1 for k in columns["suite"]], pa.bool_()))
