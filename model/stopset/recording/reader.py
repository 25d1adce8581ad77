"""Read recordings (Parquet, or CSV with its metadata in a JSON beside it) one trial at a time, checked at the door.

Memory stays at one batch and one trial, whatever the file's size.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from stopset.errors import RecordingError
from stopset.recording.csv_table import open_csv
from stopset.recording.ends import sound_part
from stopset.recording.seen import open_seen
from stopset.recording.types import EFFORTS, PHASES, Meta, Recording, Recordings, counted
from stopset.robot import Robot
from stopset.types import Array
from stopset.unpacked import Allowance, TooLargeError

BATCH_ROWS = 65_536
TICKS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}  # [s] of a time of day
PAUSE = 1.0  # [s] between samples from which on nobody was recording
SLOWER = 10.0  # times the usual distance of samples, of a slow clock's pause
FEWEST_STAMPS = 30  # of a trial whose clock is looked at
PRINTED = (0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001, 0.0005, 0.0002, 0.0001)  # [s] what stamps are printed to
ROUGH = 0.05  # of the period: stamps printed to less are as good as exact
# Beyond these a number cannot be SI: 4 turns as an angle, 40 rad/s as a joint speed (fast small arms reach 10)
PLAUSIBLE_ANGLE = 8 * np.pi
PLAUSIBLE_SPEED = 40.0


def _paths(paths: str | Path | Sequence[str | Path]) -> list[Path]:
    out = [Path(paths)] if isinstance(paths, (str, Path)) else [Path(p) for p in paths]
    for p in out:
        if p.is_dir():
            raise RecordingError(f"{p} is a directory; expected a recording (Parquet or CSV): name its files")
        if not p.exists():
            raise RecordingError(f"{p}: no such file; expected a recording (Parquet or CSV)")
        if p.stat().st_size == 0:
            raise RecordingError(f"{p} is empty (0 bytes); expected a recording: record or copy it again")
    return out


def _open(path: Path) -> tuple[pa.Schema, Iterator[pa.RecordBatch]]:
    if path.suffix.lower() == ".mcap":
        return open_seen(path)
    try:
        if path.suffix.lower() == ".csv":
            reader = open_csv(path, _is_signal)
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


def _sha256(path: Path) -> str:
    with path.open("rb") as f:
        return hashlib.file_digest(f, "sha256").hexdigest()


def _meta(path: Path, schema: pa.Schema) -> Meta:
    columns = schema.names
    joints = tuple(c[2:] for c in columns if c.startswith("q_"))
    slow = [f"dq_{j}" for j in joints if f"dq_{j}" not in columns]
    derived = len(slow) == len(joints)
    missing = [c for c in ("t",) if c not in columns] + ([] if derived else slow)
    if not joints or missing:
        what = ", ".join(missing[:6]) if missing else "q_<joint>"
        raise RecordingError(
            f"{path}: column {what} missing (it has {', '.join(columns[:8])}{' ...' if len(columns) > 8 else ''}); "
            "expected suite, trial, t and q_, dq_, tau_ of every joint"
        )
    notes = _assumed(path, columns) + (
        (f"{path.name} has no dq_: speeds are differences of neighbouring angles",) if derived else ()
    )
    _check_types(path, schema)
    raw = (schema.metadata or {}).get(b"recording")
    if raw is None:
        lacking = [f"tau_{j}" for j in joints if f"tau_{j}" not in columns]
        if lacking:
            where = f"beside it in {path.with_suffix('.json').name}" if path.suffix.lower() == ".csv" else "in the file"
            current = f" (it has currents, i_{joints[0]}...)" if f"i_{joints[0]}" in columns else ""
            raise RecordingError(
                f"{path} has no {', '.join(lacking)}{current}, and no metadata 'recording'; expected torque [N m], or currents and metadata "
                f'{where}: {{"effort": "motor_current", "torque_constant": [N m/A of each joint, on the link side]}}'
            )
        note = (
            f"{path.name} has no metadata: taken as motor torque, {'derived' if derived else 'measured'} velocity, recorded clock"
        )
        return Meta(joints=joints, velocity="derived" if derived else "measured", warnings=(note, *notes))
    try:
        d = json.loads(raw)
        effort = str(d["effort"])
        constant = d.get("torque_constant")
        meta = Meta(
            joints=tuple(d.get("joints", joints)),
            robot=str(d.get("robot", "")),
            effort=effort,
            velocity="derived" if derived else str(d.get("velocity", "measured")),
            clock=str(d.get("clock", "recorded")),
            rate_hz=float("nan" if d.get("rate_hz") is None else d["rate_hz"]),
            torque_constant=None if constant is None else tuple(float(c) for c in constant),
            warnings=notes,
            said=tuple(str(x) for x in d.get("said", ())),
        )
    except (ValueError, TypeError, KeyError) as e:
        raise RecordingError(
            f"{path}: its metadata 'recording' is unusable ({type(e).__name__}: {e}); expected JSON with effort, "
            "velocity, clock, rate_hz"
        ) from e
    if effort not in EFFORTS:
        raise RecordingError(f"{path}: effort is {effort!r}; expected one of {', '.join(EFFORTS)}")
    if set(meta.joints) != set(joints):
        raise RecordingError(
            f"{path}: its metadata names joints {', '.join(meta.joints)}, its columns {', '.join(joints)}; make them agree"
        )
    lacking = [f"tau_{j}" for j in meta.joints if f"tau_{j}" not in columns]
    if lacking and effort != "motor_current":
        raise RecordingError(f"{path}: column {', '.join(lacking[:6])} missing; expected the effort of every joint")
    if effort == "motor_current":
        lacking = [f"i_{j}" for j in meta.joints if f"i_{j}" not in columns]
        if lacking or meta.torque_constant is None or len(meta.torque_constant) != len(meta.joints):
            raise RecordingError(
                f"{path}: effort is motor_current but {', '.join(lacking[:3]) or 'torque_constant'} is missing or has the "
                "wrong length; expected i_<joint> columns and one torque constant [N m/A] per joint"
            )
    return meta


def _assumed(path: Path, columns: Sequence[str]) -> tuple[str, ...]:
    """What is taken for granted where a file does not say which motion a row is of."""
    lacking = [c for c in ("phase", "suite", "trial") if c not in columns]
    if not lacking:
        return ()
    how = "open loop" if lacking == ["phase"] else "closed loop"
    how += f", a trial wherever t goes back or rests for {PAUSE:g} s" if "trial" in lacking else ""
    return (f"{path.name} has no {', '.join(lacking)}: taken as {how}; what stands still throughout as a held pose",)


def _is_signal(column: str) -> bool:
    return column == "t" or column.startswith(("q_", "dq_", "tau_", "temp_", "i_"))


def _check_types(path: Path, schema: pa.Schema) -> None:
    for field in schema:
        signal, kind, wanted = _is_signal(field.name), field.type, "numbers"
        # a column without any value has no type: what it should hold is checked row by row
        ok = pa.types.is_floating(kind) or pa.types.is_integer(kind) or (pa.types.is_null(kind) and field.name != "t")
        if field.name in ("suite", "trial"):
            signal, ok, wanted = True, pa.types.is_integer(kind), "whole numbers"
        if signal and not ok:
            raise RecordingError(f"{path}: column {field.name} holds {kind}; expected {wanted}: convert it")


def read_meta(path: str | Path) -> Meta:
    """Metadata of one file, from its header; the whole file is read for its SHA-256 only."""
    (p,) = _paths(path)
    return replace(_meta(p, _open(p)[0]), sources=((p.name, _sha256(p)),))


def sources_of(metas: Sequence[Meta]) -> tuple[tuple[str, str], ...]:
    """Names and SHA-256 of all files. Raises `RecordingError` for one given twice: a motion that is counted again vouches for itself."""
    seen: dict[str, str] = {}
    for name, sha256 in (s for m in metas for s in m.sources):
        if sha256 in seen:
            raise RecordingError(
                f"{name} and {seen[sha256]} are the same recording, byte for byte; expected each once, as a motion that is counted "
                "twice would vouch for itself: leave one out"
            )
        seen[sha256] = name
    return tuple((name, sha256) for sha256, name in seen.items())


def _check_robot(path: Path, meta: Meta, robot: Robot) -> None:
    absent = [j for j in robot.joints if j not in meta.joints]
    if absent:
        raise RecordingError(
            f"{path} records joints {', '.join(meta.joints)}, the robot {robot.name} has {', '.join(robot.joints)}; "
            "robot and data do not belong together: give the matching pair"
        )


def _check_trial(path: Path, r: Recording, joints: Sequence[str], robot: Robot | None) -> None:
    if len(r.t) < 2:
        raise RecordingError(f"{path}: {r.label} has {len(r.t)} sample; expected at least 2")
    for name, x in (("t", r.t[:, None]), ("q", r.q), ("dq", r.dq), ("tau", r.tau), ("temp", r.temp)):
        if x is not None and not np.isfinite(x).all():
            row, col = np.argwhere(~np.isfinite(x))[0]
            where = "t" if name == "t" else f"{name}_{joints[col]}"
            raise RecordingError(
                f"{path}: {where} is {x[row, col]} at row {row} of {r.label}; expected finite numbers: remove or repair"
            )
    dt = np.diff(r.t)
    if (dt <= 0).any():
        k = int(np.argmax(dt <= 0))
        raise RecordingError(
            f"{path}: time goes from {r.t[k]:.6g} s to {r.t[k + 1]:.6g} s at row {k + 1} of {r.label}; "
            "expected increasing t within a trial: sort it or split it into trials"
        )
    big = np.abs(r.q).max(axis=0)
    fast = np.abs(r.dq).max(axis=0)
    limit = np.full(len(joints), PLAUSIBLE_ANGLE)
    if robot is not None:
        reach = np.abs(robot.q_limit).max(axis=1)
        limit = np.where(np.isfinite(reach), np.minimum(limit, 3 * reach), limit)
    for j, name in enumerate(joints):
        if big[j] > limit[j] or fast[j] > PLAUSIBLE_SPEED:
            raise RecordingError(
                f"{path}: q_{name} reaches {big[j]:.4g} and dq_{name} {fast[j]:.4g} in {r.label}; "
                f"expected rad and rad/s (at most {limit[j]:.3g} rad): this looks like degrees, convert it"
            )


def stream_recordings(paths: str | Path | Sequence[str | Path], robot: Robot | None = None) -> Iterator[Recording]:
    """Yield the trials of the files one by one, in campaign order, signals in the robot's (or the file's) joint order.

    Raises `RecordingError` with one sentence for anything that is not a sound recording.
    """
    return counted(_stream(paths, robot))


def _stream(paths: str | Path | Sequence[str | Path], robot: Robot | None) -> Iterator[Recording]:
    place = 0
    for number, path in enumerate(_paths(paths)):
        schema, batches = _open(path)
        meta = _meta(path, schema)
        if robot is not None:
            _check_robot(path, meta, robot)
        joints = robot.joints if robot is not None else meta.joints
        seen: set[tuple[str, int, int]] = set()
        for phase, suite, trial, columns in _runs(path, batches):
            key = (phase, suite, trial)
            if key in seen:
                raise RecordingError(
                    f"{path}: {phase} suite {suite} trial {trial} comes in two pieces; expected the rows of a trial together"
                )
            seen.add(key)
            r = replace(_trial(path, key, place, columns, joints, meta), file=number)
            _check_trial(path, r, joints, robot)
            yield sound_part(r)
            place += 1
        if not seen:
            raise RecordingError(f"{path} has no rows; expected at least one trial: record it again")


def _runs(path: Path, batches: Iterable[pa.RecordBatch]) -> Iterator[tuple[str, int, int, dict[str, Any]]]:
    """Consecutive rows with the same (phase, suite, trial), across batches."""
    key: tuple[str, int, int] | None = None
    parts: list[dict[str, Any]] = []
    begun, last = 0, float("nan")  # where no column says which trial a row is of: trials before it, its stamp
    try:
        for batch in batches:
            columns = {c: batch.column(c).to_numpy(zero_copy_only=False) for c in batch.schema.names}
            rows = batch.num_rows
            if rows == 0:
                continue
            phase = columns.get("phase")
            usual = "open_loop" if {"suite", "trial"} <= columns.keys() else "closed_loop"
            names = np.full(rows, usual, object) if phase is None else phase
            columns.setdefault("suite", np.zeros(rows, np.int64))
            if "trial" not in columns:
                columns["trial"] = begun + np.cumsum(_anew(columns["t"], last))
                begun, last = int(columns["trial"][-1]), float(columns["t"][-1])
            change = (np.diff(columns["suite"]) != 0) | (np.diff(columns["trial"]) != 0) | (names[1:] != names[:-1])
            edges = [0, *(np.flatnonzero(change) + 1).tolist(), rows]
            for lo, hi in pairwise(edges):
                here = (str(names[lo]), int(columns["suite"][lo]), int(columns["trial"][lo]))
                if here[0] not in PHASES:
                    raise RecordingError(f"{path}: phase {here[0]!r}; expected one of {', '.join(PHASES)}")
                if key is not None and here != key:
                    yield (*key, _joined(parts))
                    parts = []
                key = here
                parts.append({c: v[lo:hi] for c, v in columns.items()})
    except (pa.ArrowInvalid, OSError) as e:
        raise RecordingError(f"{path} breaks off ({str(e).splitlines()[0]}); expected a whole file: copy it again") from e
    except (ValueError, TypeError) as e:
        raise RecordingError(f"{path}: suite or trial is not a whole number ({e}); expected integers") from e
    if key is not None:
        yield (*key, _joined(parts))


def _anew(t: Array, before: float) -> NDArray[np.bool_]:
    """Where stamps (N,) that follow ``before`` [s] begin a trial: the clock went back, or nothing was recorded for a while."""
    dt = np.diff(t, prepend=before)
    return (dt < 0) | (dt >= max(PAUSE, SLOWER * float(np.nanmedian(dt)) if len(t) > 1 else 0.0))


def _joined(parts: list[dict[str, Any]]) -> dict[str, Any]:
    return parts[0] if len(parts) == 1 else {c: np.concatenate([p[c] for p in parts]) for c in parts[0]}


def _trial(
    path: Path, key: tuple[str, int, int], place: int, columns: dict[str, Any], joints: Sequence[str], meta: Meta
) -> Recording:
    def table(prefix: str) -> Array | None:
        names = [f"{prefix}_{j}" for j in joints]
        if not all(c in columns for c in names):
            return None
        try:
            return np.column_stack([np.asarray(columns[c], dtype=np.float64) for c in names])
        except (ValueError, TypeError) as e:
            raise RecordingError(f"{path}: a column {prefix}_<joint> holds no number ({e}); expected numbers: convert it") from e

    current = table("i")
    tau = table("tau")
    if meta.effort == "motor_current" and current is not None and meta.torque_constant is not None:
        constants = dict(zip(meta.joints, meta.torque_constant, strict=True))
        tau = current * np.array([constants[j] for j in joints])
    q, dq = table("q"), table("dq")
    assert q is not None and tau is not None  # _meta checked the columns
    trigger = columns.get("stop_trigger")
    temp = table("temp")
    t, rounded = _evened(np.array(columns["t"], dtype=np.float64))  # a copy: a view keeps the whole batch alive
    return Recording(
        *key, place, t, q, _differences(q, t) if dq is None else dq, tau, rounded=rounded, condition=_condition(path, columns.get("condition")),
        temp=None if temp is None or np.isnan(temp).all() else temp,
        current=current,
        stop_trigger=None if trigger is None else np.asarray(trigger, dtype=bool),
    )  # fmt: skip


def _differences(q: Array, t: Array) -> Array:
    """Speeds [rad/s] of angles (N, n) at stamps (N,) that nobody recorded; zero where the stamps give none, which is refused after."""
    return np.gradient(q, t, axis=0) if len(t) > 1 and (np.diff(t) > 0).all() else np.zeros_like(q)


def _condition(path: Path, column: Any) -> str:
    """The condition of a trial, from its column; empty where there is none."""
    values = [] if column is None else list(dict.fromkeys(str(v) for v in column if v is not None))
    if len(values) > 1:
        raise RecordingError(
            f"{path}: the condition changes from {values[0]!r} to {values[1]!r} within a trial; expected one per trial: split it"
        )
    return values[0] if values else ""


def _evened(t: Array) -> tuple[Array, float]:
    """Stamps, and what they were printed to: where that hides an even clock (all lie on one within a print), the clock itself."""
    if len(t) < FEWEST_STAMPS:
        return t, 0.0
    h, first = (float(x) for x in np.polyfit(np.arange(len(t)), t, 1))
    printed = next((g for g in PRINTED if np.abs(t / g - np.round(t / g)).max() < 1e-4), 0.0)
    even = first + h * np.arange(len(t))
    off = t - even
    if not ROUGH * h < printed or np.abs(np.diff(t) - h).max() <= ROUGH * h or np.ptp(off) > 1.02 * printed:
        return t, 0.0
    return even + 0.5 * (off.max() + off.min()), printed


def read_recordings(paths: str | Path | Sequence[str | Path], robot: Robot | None = None) -> Recordings:
    """All trials of the files in memory; see `stream_recordings` for one at a time and for what is checked."""
    files = _paths(paths)
    metas = [read_meta(p) for p in files]
    sources = sources_of(metas)
    first = metas[0]
    for p, m in zip(files[1:], metas[1:], strict=True):
        if m.effort != first.effort:
            raise RecordingError(f"{p} holds {m.effort}, {files[0]} holds {first.effort}; one identification takes one kind")
    joints = robot.joints if robot is not None else first.joints
    meta = replace(
        first,
        joints=joints,
        sources=sources,
        warnings=tuple(w for m in metas for w in m.warnings),
        said=tuple(c for m in metas for c in m.said),
    )
    return Recordings(meta, tuple(stream_recordings(files, robot)))
