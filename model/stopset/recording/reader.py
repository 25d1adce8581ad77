"""Read recordings (Parquet, or CSV with its metadata in a JSON beside it) one trial at a time, checked at the door.

Memory stays at one batch and one trial, whatever the file's size.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from stopset.errors import RecordingError
from stopset.recording.clock import anew, evened
from stopset.recording.ends import sound_part
from stopset.recording.files import files_of, opened, sha256_of
from stopset.recording.held import each_once
from stopset.recording.meta import meta_of
from stopset.recording.polled import on_its_clock
from stopset.recording.rows import sound_rows
from stopset.recording.spikes import without_spikes
from stopset.recording.types import PHASES, Meta, Recording, Recordings, counted
from stopset.robot import Robot
from stopset.types import Array

# Beyond these a number cannot be SI: 4 turns as an angle, 40 rad/s as a joint speed (fast small arms reach 10)
PLAUSIBLE_ANGLE = 8 * np.pi
PLAUSIBLE_SPEED = 40.0


def read_meta(path: str | Path) -> Meta:
    """Metadata of one file, from its header; the whole file is read for its SHA-256 only."""
    (p,) = files_of(path)
    return replace(meta_of(p, opened(p)[0]), sources=((p.name, sha256_of(p)),))


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
        raise RecordingError(
            f"{path}: {r.label} has {len(r.t)} sample; expected at least 2: are its rows together? sort them by phase, suite, trial and t"
        )
    for name, x in (("t", r.t[:, None]), ("q", r.q), ("dq", r.dq), ("tau", r.tau), ("temp", r.temp)):
        if x is not None and not np.isfinite(x).all():
            row, col = np.argwhere(~np.isfinite(x))[0]
            where = "t" if name == "t" else f"{name}_{joints[col]}"
            raise RecordingError(
                f"{path}: {where} is {x[row, col]} at row {row} of {r.label}, and {int((~np.isfinite(x)).any(axis=1).sum())} of its "
                f"{len(x)} rows are so; expected finite numbers: remove or repair"
            )
    dt = np.diff(r.t)
    if (dt <= 0).any():
        k = int(np.argmax(dt <= 0))
        if dt[k] == 0:
            raise RecordingError(
                f"{path}: two different samples are stamped {r.t[k]:.6g} s at row {k + 1} of {r.label}, {int((dt == 0).sum())} times in "
                "all; expected increasing t within a trial: stamps of the logger, or printed too short? write those of the controller"
            )
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


def stream_recordings(
    paths: str | Path | Sequence[str | Path], robot: Robot | None = None, *, garbled: bool = False
) -> Iterator[Recording]:
    """Yield the trials of the files one by one, in campaign order, signals in the robot's (or the file's) joint order.

    ``garbled``: with the samples that `on_its_clock` and `without_spikes` leave out, as a monitor would get them.
    Raises `RecordingError` with one sentence for anything that is not a sound recording.
    """
    return counted(_stream(paths, robot, garbled=garbled))


def _stream(paths: str | Path | Sequence[str | Path], robot: Robot | None, *, garbled: bool) -> Iterator[Recording]:
    place = 0
    for number, path in enumerate(files_of(paths)):
        schema, batches = opened(path)
        meta = meta_of(path, schema)
        if robot is not None:
            _check_robot(path, meta, robot)
        joints = robot.joints if robot is not None else meta.joints
        seen: set[tuple[str, int, int]] = set()
        for phase, suite, trial, alone, columns in _runs(path, batches):
            key = (phase, suite, trial)
            if key in seen:
                raise RecordingError(
                    f"{path}: {phase} suite {suite} trial {trial} comes in two pieces; expected the rows of a trial together"
                )
            seen.add(key)
            r = replace(_trial(path, key, place, columns, joints, meta), file=number)
            _check_trial(path, r, joints, robot)
            derived = meta.velocity == "derived"
            # of readings that were written many times one each: what bends at the ends is looked for in these
            if not garbled:
                r = each_once(r, derived=derived)
            r = sound_part(r, alone=alone)
            yield r if garbled else without_spikes(on_its_clock(r, derived=derived))
            place += 1
        if not seen:
            raise RecordingError(f"{path} has no rows; expected at least one trial: record it again")


def _runs(path: Path, batches: Iterable[pa.RecordBatch]) -> Iterator[tuple[str, int, int, bool, dict[str, Any]]]:
    """Consecutive rows with the same (phase, suite, trial), across batches.

    Of each also whether no column says its phase and the trials before and after it are of other suites.
    """
    key: tuple[str, int, int] | None = None
    before: int | None = None  # the suite of the trial before
    assumed = False
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
            assumed = phase is None
            columns.setdefault("suite", np.zeros(rows, np.int64))
            if "trial" not in columns:
                columns["trial"] = begun + np.cumsum(anew(columns["t"], last))
                begun, last = int(columns["trial"][-1]), float(columns["t"][-1])
            change = (np.diff(columns["suite"]) != 0) | (np.diff(columns["trial"]) != 0) | (names[1:] != names[:-1])
            edges = [0, *(np.flatnonzero(change) + 1).tolist(), rows]
            for lo, hi in pairwise(edges):
                here = (str(names[lo]), int(columns["suite"][lo]), int(columns["trial"][lo]))
                if here[0] not in PHASES:
                    raise RecordingError(f"{path}: phase {here[0]!r}; expected one of {', '.join(PHASES)}")
                if key is not None and here != key:
                    yield (*key, assumed and key[1] not in (before, here[1]), _joined(parts))
                    parts, before = [], key[1]
                key = here
                parts.append({c: v[lo:hi] for c, v in columns.items()})
    except (pa.ArrowInvalid, OSError) as e:
        raise RecordingError(f"{path} breaks off ({str(e).splitlines()[0]}); expected a whole file: copy it again") from e
    except (ValueError, TypeError) as e:
        raise RecordingError(f"{path}: suite or trial is not a whole number ({e}); expected integers") from e
    if key is not None:
        yield (*key, assumed and key[1] != before, _joined(parts))


def _joined(parts: list[dict[str, Any]]) -> dict[str, Any]:
    return parts[0] if len(parts) == 1 else {c: np.concatenate([p[c] for p in parts]) for c in parts[0]}


def _trial(
    path: Path, key: tuple[str, int, int], place: int, columns: dict[str, Any], joints: Sequence[str], meta: Meta
) -> Recording:
    def table(prefix: str, needed: Callable[[Iterable[bool]], bool] = all) -> Array | None:
        names = [f"{prefix}_{j}" for j in joints]
        if not needed(c in columns for c in names):
            return None
        none = np.full(len(columns["t"]), np.nan)
        try:
            return np.column_stack([np.asarray(columns.get(c, none), dtype=np.float64) for c in names])
        except (ValueError, TypeError) as e:
            raise RecordingError(f"{path}: a column {prefix}_<joint> holds no number ({e}); expected numbers: convert it") from e

    current, q, dq, tau, temp = (table(x) for x in ("i", "q", "dq", "tau", "temp"))
    behind = table("q_link", any)
    if meta.effort == "motor_current" and current is not None and meta.torque_constant is not None:
        constants = dict(zip(meta.joints, meta.torque_constant, strict=True))
        tau = current * np.array([constants[j] for j in joints])
    assert q is not None and tau is not None  # `meta_of` checked the columns
    t = np.array(columns["t"], dtype=np.float64)  # a copy: a view keeps the whole batch alive
    sound = sound_rows(t, [x for x in (q, dq, tau) if x is not None])

    def rows(x: Any) -> Any:
        return x if x is None or sound.rows.all() else x[sound.rows]

    q = rows(q)
    t, rounded = evened(rows(t), q)
    trigger = columns.get("stop_trigger")
    return Recording(
        *key, place, t, q, _differences(q, t) if dq is None else rows(dq), rows(tau),
        temp=None if temp is None or np.isnan(temp).all() else rows(temp),
        current=rows(current),
        q_link=rows(behind),
        stop_trigger=None if trigger is None else rows(np.asarray(trigger, dtype=bool)),
        condition=_condition(path, columns.get("condition")),
        rounded=rounded, twice=sound.twice, unread=sound.unread,
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


def read_recordings(paths: str | Path | Sequence[str | Path], robot: Robot | None = None) -> Recordings:
    """All trials of the files in memory; see `stream_recordings` for one at a time and for what is checked."""
    files = files_of(paths)
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
