"""One violation, one file: what was read before and after it, what it was held against, what the bus said, and its class."""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from stopset.errors import OutputError
from stopset.files import replacing
from stopset.monitor.evidence.cause import Cause
from stopset.monitor.evidence.dynamics import Dynamics
from stopset.monitor.evidence.mcap_file import ERROR, McapFile, logged, stamp
from stopset.monitor.evidence.rows import messages, nanoseconds
from stopset.monitor.evidence.trace import Window

if TYPE_CHECKING:
    from stopset.monitor.verdict import Deviation

MARGIN = 0.1  # [s] of the bus's log before the first row
AT_ONCE = 8  # messages written before the loop may have the interpreter


@dataclass(slots=True)
class Incident:
    """A sample outside its prediction: ``row`` of the trace, the worst deviation, its stamp ``t`` [s], when it was ``noticed``
    [s, monotonic], whether it was ``tried`` to write it, and the file it was written to already; ``head`` of the trace as it was last
    seen, and when that ``came`` [s, monotonic]."""

    row: int
    first: Deviation
    t: float
    noticed: float
    tried: bool = False
    written: Path | None = None
    head: int = -1
    came: float = float("-inf")


@dataclass(frozen=True, slots=True)
class BundleContents:
    """What a bundle holds: the ``window`` of readings, the ``model`` to predict them with (None: none looks back), ``frames`` of
    the bus as (time [s], identifier, bytes)."""

    incident: Incident
    cause: Cause
    window: Window
    model: Dynamics | None
    joints: tuple[str, ...]
    frames: list[tuple[float, int, bytes]]


def span(w: Window) -> tuple[float, float]:
    """Between which stamps [s] the frames of a window were on the bus."""
    return (float(w.t[0]) - MARGIN, float(w.t[-1]) + MARGIN) if len(w) else (0.0, 0.0)


def name_of(incident: Incident) -> str:
    """By the time of the violation, in UTC."""
    at = time.gmtime(max(0.0, min(incident.t, 4e9)))
    return f"violation-{time.strftime('%Y%m%dT%H%M%S', at)}-{int(incident.t % 1 * 1e6):06d}-{incident.row}.mcap"


def write_bundle(
    folder: Path, keep_mb: float, contents: BundleContents, about: Mapping[str, str], pause: Callable[[], None]
) -> tuple[Path, str]:
    """Write it and return its name and SHA-256; it is on the disk, whole, when this returns. Raises `OSError`, `OutputError`.

    Bundles are never deleted: when they fill ``keep_mb`` no further one is written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    incident = contents.incident
    path = incident.written or folder / name_of(incident)
    used = sum(p.stat().st_size for p in folder.glob("violation-*.mcap") if p != path) / 1e6
    if used > keep_mb:
        raise OutputError(f"{folder} holds {used:.0f} MB of violations; at most {keep_mb:g} MB are kept: take them away")
    with replacing(path) as part, part.open("wb") as f:
        _write(McapFile(f, "stopset", {**about, "kind": "violation", "t": repr(incident.t)}), contents, pause)
    _sync(folder)
    with path.open("rb") as f:
        return path, hashlib.file_digest(f, "sha256").hexdigest()


def _write(file: McapFile, x: BundleContents, pause: Callable[[], None]) -> None:
    w, incident, cause = x.window, x.incident, x.cause
    age = 1 if x.model is None else max(1, round(incident.first.age / x.model.dt))
    for k, (topic, t, message) in enumerate(messages(w, 0, x.model, x.joints, age)):
        file.add(topic, t, message)
        if k % AT_ONCE == 0:
            pause()
    for k, (t_frame, identifier, data) in enumerate(x.frames):
        t = nanoseconds(t_frame)
        file.add("can", t, {"timestamp": stamp(t), "id": identifier, "data": data.hex()})
        if k % (4 * AT_ONCE) == 0:
            pause()
    t = nanoseconds(incident.t)
    file.add("cause", t, cause.plain())
    file.add("log", t, logged(t, ERROR, "stopset", f"{cause.kind.value}: {cause.says}"))
    file.finish()


def _sync(folder: Path) -> None:
    fd = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
