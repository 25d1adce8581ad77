"""What a file says of how its samples were taken, held against its columns."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import pyarrow as pa

from stopset.errors import RecordingError
from stopset.recording.clock import PAUSE
from stopset.recording.types import EFFORTS, Meta


def meta_of(path: Path, schema: pa.Schema) -> Meta:
    """Metadata of a file with these columns; what it does not say is assumed and said. Raises `RecordingError`."""
    columns = schema.names
    behind = {f"q_link_{c[2:]}" for c in columns if c.startswith("q_")}  # a second encoder's is no joint of its own
    joints = tuple(c[2:] for c in columns if c.startswith("q_") and c not in behind)
    slow = [f"dq_{j}" for j in joints if f"dq_{j}" not in columns]
    derived = len(slow) == len(joints)
    missing = [c for c in ("t",) if c not in columns] + ([] if derived else slow)
    if not joints or missing:
        what = ", ".join(missing[:6]) if missing else "q_<joint>"
        raise RecordingError(
            f"{path}: column {what} missing (it has {', '.join(columns[:8])}{' ...' if len(columns) > 8 else ''}); "
            f"expected suite, trial, t and q_, dq_, tau_ of every joint: `stopset import {path.name} --out REC.parquet` takes tables of other tools"
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


def is_signal(column: str) -> bool:
    """Whether a column holds a signal."""
    return column == "t" or column.startswith(("q_", "dq_", "tau_", "temp_", "i_"))


def _check_types(path: Path, schema: pa.Schema) -> None:
    for field in schema:
        signal, kind, wanted = is_signal(field.name), field.type, "numbers"
        # a column without any value has no type: what it should hold is checked row by row
        ok = pa.types.is_floating(kind) or pa.types.is_integer(kind) or (pa.types.is_null(kind) and field.name != "t")
        if field.name in ("suite", "trial"):
            signal, ok, wanted = True, pa.types.is_integer(kind), "whole numbers"
        if signal and not ok:
            raise RecordingError(f"{path}: column {field.name} holds {kind}; expected {wanted}: convert it")
