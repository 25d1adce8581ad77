"""A bus profile: which number of which frame is which signal of which joint, and what one count is worth.

A TOML file beside a DCF (or EDS). Shipped ones are named ``lwa4p/monitor``; any other is a path.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from stopset.errors import BusError
from stopset.types import Array

SIGNALS = ("q", "dq", "tau", "temp", "status")
SLOW = ("temp", "status")  # may come when they change; the others belong to an instant
SYNC_ID = 0x080  # usual COB-ID of SYNC, object 0x1005
AXIS = 0x800  # from an object of one axis to that of the next (CiA 402, multi-axis devices: 0x6000 to 0x9FFF)
MOST_AXES = 8


@dataclass(frozen=True, slots=True)
class Signal:
    """An object of the dictionary and the SI value of one count, per joint: ``scale`` (n,)."""

    object: int
    sub: int
    scale: Array


@dataclass(frozen=True, slots=True)
class Profile:
    """How to read one arm's bus. ``nodes``: node id by joint; ``axes``: which axis of its node a joint is, 0 the first;
    ``cycle_s``: SYNC period; ``sync_id``: its COB-ID; ``sync_overflow``: 0 = no counter; ``heartbeat_s``: period of every
    drive's heartbeat (object 0x1017), 0 = they send none."""

    name: str
    dcf: Path
    bitrate: int
    cycle_s: float
    sync_overflow: int
    nodes: dict[str, int]
    signals: dict[str, Signal]
    heartbeat_s: float = 0.0
    sync_id: int = SYNC_ID
    axes: tuple[int, ...] = ()

    @property
    def joints(self) -> tuple[str, ...]:
        return tuple(self.nodes)

    def quantum(self, signal: str) -> Array:
        """(n,) greatest rounding error of a signal on this bus: half a count [SI]; 0 for a signal the bus does not carry."""
        s = self.signals.get(signal)
        return np.zeros(len(self.nodes)) if s is None else 0.5 * np.abs(s.scale)


def shipped_profiles() -> list[str]:
    """Names of the profiles in the package."""
    root = resources.files("stopset.monitor") / "profiles"
    return sorted(
        f"{arm.name}/{f.name.removesuffix('.toml')}"
        for arm in root.iterdir() if arm.is_dir()
        for f in arm.iterdir() if f.name.endswith(".toml")
    )  # fmt: skip


def load_profile(where: str | Path) -> Profile:
    """Read a profile by shipped name or path; raises `BusError` for anything unusable."""
    if str(where) in shipped_profiles():
        arm, name = str(where).split("/")
        path = Path(str(resources.files("stopset.monitor") / "profiles" / arm / f"{name}.toml"))
    else:
        path = Path(where)
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as e:
        shipped = ", ".join(shipped_profiles())
        raise BusError(f"bus profile {where}: no such file; expected a path or one of {shipped}") from e
    except (OSError, ValueError, RecursionError) as e:
        raise BusError(f"bus profile {path} is not readable TOML ({e}); mend it") from e
    try:
        return _profile(raw, str(where), path)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError, OSError) as e:
        raise BusError(
            f"bus profile {path} is unusable ({type(e).__name__}: {e}); expected dcf, bitrate, cycle_s, [nodes] and [signals.q]"
        ) from e


def _profile(raw: dict[str, Any], name: str, path: Path) -> Profile:
    unknown = set(raw) - {"dcf", "bitrate", "cycle_s", "sync_overflow", "sync_id", "heartbeat_s", "nodes", "signals"}
    unknown |= set(raw["signals"]) - set(SIGNALS)
    if unknown:
        raise ValueError(f"unknown key {', '.join(sorted(unknown))}")
    places = {str(k): _place(v) for k, v in raw["nodes"].items()}
    nodes = {joint: node for joint, (node, _) in places.items()}
    if not nodes or len(set(places.values())) != len(nodes) or not all(1 <= v <= 127 for v in nodes.values()):
        raise ValueError(
            f"node ids {list(nodes.values())} are not distinct numbers from 1 to 127, or axes of one node not distinct"
        )
    dcf = path.with_name(str(raw["dcf"]))
    if not dcf.is_file():
        raise ValueError(f"{dcf.name} is not beside it")
    signals = {k: _signal(s, len(nodes)) for k, s in raw["signals"].items()}
    if "q" not in signals or "dq" not in signals:
        raise ValueError("signals q and dq are needed")
    cycle = float(raw["cycle_s"])
    if not 1e-4 <= cycle <= 1.0:
        raise ValueError(f"cycle_s is {cycle}")
    heartbeat, overflow = float(raw.get("heartbeat_s", 0.0)), int(raw.get("sync_overflow", 0))
    if not 0.0 <= heartbeat <= 60.0:
        raise ValueError(f"heartbeat_s is {heartbeat}, expected 0 (none) to 60")
    if not (overflow == 0 or 2 <= overflow <= 240):
        raise ValueError(f"sync_overflow is {overflow}, expected 0 (no counter) or 2 to 240")
    sync_id = int(raw.get("sync_id", SYNC_ID))
    if not 1 <= sync_id <= 0x7FF:
        raise ValueError(f"sync_id is {sync_id}, expected a COB-ID from 1 to 0x7FF")
    axes = tuple(axis for _, axis in places.values())
    return Profile(name, dcf, int(raw["bitrate"]), cycle, overflow, nodes, signals, heartbeat, sync_id, axes)


def _place(x: Any) -> tuple[int, int]:
    """A joint's node and axis: ``3``, or ``{node = 3, axis = 1}`` where one node moves several joints."""
    if not isinstance(x, dict):
        return int(x), 0
    if set(x) - {"node", "axis"}:
        raise ValueError(f"unknown key {', '.join(sorted(set(x) - {'node', 'axis'}))}")
    axis = int(x.get("axis", 0))
    if not 0 <= axis < MOST_AXES:
        raise ValueError(f"axis {axis}, expected 0 to {MOST_AXES - 1}")
    return int(x["node"]), axis


def _signal(s: dict[str, Any], n: int) -> Signal:
    if set(s) - {"object", "sub", "scale"}:
        raise ValueError(f"unknown key {', '.join(sorted(set(s) - {'object', 'sub', 'scale'}))}")
    scale = np.broadcast_to(np.asarray(s.get("scale", 1.0), float), (n,)).copy()
    if not np.all(np.isfinite(scale)) or np.any(scale == 0):
        raise ValueError(f"scale {scale.tolist()} is not finite and non-zero")
    return Signal(int(s["object"]), int(s.get("sub", 0)), scale)
