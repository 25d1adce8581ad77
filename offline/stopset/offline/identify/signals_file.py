"""The signals of all recordings behind a model in one compressed file: what an update reads in place of the old recordings.

A Parquet table, written and read one trial at a time, so memory does not grow with the campaign.  Numbers are those that the
reader of recordings gave, as float64 split into byte planes: exact to the last bit, and small where they were short before.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from stopset.artifact import Model
from stopset.effects.base import Fitted
from stopset.errors import ModelFileError
from stopset.files import replacing
from stopset.offline.campaign.source import Campaign
from stopset.recording import Meta, Recording, counted

FORMAT = "stopset signals"
SCHEMA = 1
KEY = b"stopset_state"
MAGIC = b"PAR1"  # begins every Parquet file
GROUP_ROWS = 65_536  # rows compressed and read together
SIGNALS = ("q", "dq", "tau", "temp")
Columns = Mapping[str, NDArray[Any]]


@dataclass(frozen=True, slots=True)
class RetainedSignals:
    """All recordings of a model, ``places`` trials; ``known``: numbers of effects that its identification was given."""

    campaign: Campaign
    places: int
    known: tuple[Fitted, ...] = ()


def save_signals(path: str | Path, retained: RetainedSignals, model: Model) -> None:
    """Write every trial behind ``model`` (as saved, with its SHA-256), whole or not at all."""
    head = {
        "format": FORMAT, "schema": SCHEMA, "model_sha256": model.sha256, "meta": asdict(retained.campaign.meta),
        "places": retained.places, "known": [asdict(f) for f in retained.known],
    }  # fmt: skip
    schema = _schema(model.joints).with_metadata({KEY: json.dumps(head).encode()})
    waiting: list[pa.Table] = []
    with replacing(path) as part, pq.ParquetWriter(
        part, schema, compression="zstd", use_dictionary=["phase"], write_page_checksum=True,
        column_encoding={f.name: "BYTE_STREAM_SPLIT" for f in schema if pa.types.is_floating(f.type)},
    ) as writer:  # fmt: skip
        for r in retained.campaign.trials():
            waiting.append(_table(r, schema))
            if sum(len(t) for t in waiting) >= GROUP_ROWS:
                writer.write_table(pa.concat_tables(waiting).combine_chunks())
                waiting.clear()
        if waiting:
            writer.write_table(pa.concat_tables(waiting).combine_chunks())


def load_signals(path: str | Path, model: Model) -> RetainedSignals:
    """What was kept for ``model``; the trials are read when they are asked for.

    Raises `ModelFileError` for a file that is damaged, foreign, of another version or of another model.
    """
    try:
        raw = (pq.read_schema(path).metadata or {})[KEY]
        head = json.loads(raw)
        if head["format"] != FORMAT:
            raise ValueError(f"format {head['format']!r}")
        if head["schema"] != SCHEMA:
            raise ModelFileError(f"{path} has schema {head['schema']!r}, this stopset reads {SCHEMA}; identify again with --keep")
        if head["model_sha256"] != model.sha256:
            raise ModelFileError(
                f"{path} belongs to the model {str(head['model_sha256'])[:16]}..., not to {model.sha256[:16]}...; give the model it was "
                "kept with"
            )
        meta, places, known = meta_of(head["meta"]), int(head["places"]), tuple(Fitted(**f) for f in head["known"])
    except (OSError, pa.ArrowException, KeyError, ValueError, TypeError) as e:
        raise ModelFileError(
            f"{path} is damaged or no kept state ({type(e).__name__}); expected what `stopset identify --keep` wrote: identify again"
        ) from e
    return RetainedSignals(Campaign(meta, lambda: counted(_trials(path, model.joints))), places, known)


def meta_of(m: Mapping[str, Any]) -> Meta:
    """`Meta` from its JSON."""
    constant = m["torque_constant"]
    return Meta(
        **dict(m) | {
            "joints": tuple(m["joints"]), "warnings": tuple(m["warnings"]), "sources": tuple((a, b) for a, b in m["sources"]),
            "torque_constant": None if constant is None else tuple(constant), "said": tuple(m.get("said", ())),
        }
    )  # fmt: skip


def _schema(joints: tuple[str, ...]) -> pa.Schema:
    whole = [(name, pa.int64()) for name in ("file", "place", "suite", "trial")]
    numbers = [(f"{s}_{j}", pa.float64()) for s in SIGNALS for j in joints]
    return pa.schema([*whole, ("phase", pa.string()), ("t", pa.float64()), *numbers, ("stop_trigger", pa.bool_())])


def _table(r: Recording, schema: pa.Schema) -> pa.Table:
    """One trial; what was not recorded is null."""
    rows, n = len(r.t), r.q.shape[1]
    columns: list[Any] = [np.full(rows, x) for x in (r.file, r.place, r.suite, r.trial)]
    columns += [pa.array([r.phase] * rows), r.t]
    for name in SIGNALS:
        x = getattr(r, name)
        columns += [pa.nulls(rows, pa.float64())] * n if x is None else [np.ascontiguousarray(c) for c in x.T]
    columns.append(pa.nulls(rows, pa.bool_()) if r.stop_trigger is None else r.stop_trigger)
    return pa.Table.from_arrays([pa.array(c) if isinstance(c, np.ndarray) else c for c in columns], schema=schema)


def _trials(path: str | Path, joints: tuple[str, ...]) -> Iterator[Recording]:
    """The trials in the order they were kept in."""
    parts: list[Columns] = []
    try:
        for batch in pq.ParquetFile(path, pre_buffer=False, page_checksum_verification=True).iter_batches(GROUP_ROWS):
            columns = {c: batch.column(c).to_numpy(zero_copy_only=False) for c in batch.schema.names}
            edges = [0, *(np.flatnonzero(np.diff(columns["place"])) + 1).tolist(), batch.num_rows]
            for lo, hi in pairwise(edges):
                if parts and columns["place"][lo] != parts[0]["place"][0]:
                    yield _recording(parts, joints)
                    parts = []
                parts.append({c: x[lo:hi] for c, x in columns.items()})
    except (OSError, pa.ArrowException, KeyError, ValueError) as e:
        raise ModelFileError(
            f"{path} is damaged ({str(e).splitlines()[0]}); expected what `stopset identify --keep` wrote: identify again"
        ) from e
    if parts:
        yield _recording(parts, joints)


def _recording(parts: list[Columns], joints: tuple[str, ...]) -> Recording:
    # a copy in any case: a view would keep the whole batch alive
    x = {c: np.concatenate([p[c] for p in parts]) for c in parts[0]}
    q, dq, tau, temp = (np.column_stack([x[f"{s}_{j}"] for j in joints]) for s in SIGNALS)
    trigger = x["stop_trigger"]
    return Recording(
        str(x["phase"][0]), int(x["suite"][0]), int(x["trial"][0]), int(x["place"][0]), x["t"], q, dq, tau,
        temp=None if np.isnan(temp).any() else temp, file=int(x["file"][0]),
        stop_trigger=None if trigger[0] is None else trigger.astype(bool),
    )  # fmt: skip
