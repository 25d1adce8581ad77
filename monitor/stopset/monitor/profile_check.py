"""Does a bus profile fit its drives, its bus and, where there is one, a log of it? Said before the monitor listens."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stopset.monitor.links.batch import Frame
from stopset.monitor.links.canopen_map import frame_maps
from stopset.monitor.links.decoder import Decoder
from stopset.monitor.nodes import EMCY, HEARTBEAT
from stopset.monitor.profile import SIGNALS, Profile

FULL = 0.7  # part of the bus's time that a cycle may take before commands
OFF = 0.05  # of the period that SYNC may be off
FEW = 20  # cycles in a log below which nothing is told
SERVICES = 0x580  # COB-IDs from here on are SDO, heartbeats and the like


@dataclass(slots=True)
class ProfileCheck:
    """``wrong``: what keeps the monitor from a verdict; ``notes``: what somebody should know; ``frames``: one row per frame."""

    name: str
    frames: list[dict[str, Any]] = field(default_factory=list)
    load: float = 0.0
    wrong: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    heard: dict[str, Any] = field(default_factory=dict)

    def plain(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "profile": self.name, "usable": not self.wrong, "wrong": self.wrong, "notes": self.notes, "frames": self.frames,
            "bus_load": self.load, "log": self.heard or None,
        }  # fmt: skip


def bits(length: int) -> int:
    """Longest classic CAN frame of ``length`` bytes on the wire, stuffing and the pause after it included."""
    return 8 * length + 47 + (34 + 8 * length - 1) // 4


def check_profile(profile: Profile) -> ProfileCheck:
    """Of the profile by itself; raises `BusError` where its DCF cannot be used at all."""
    out, maps = ProfileCheck(profile.name), frame_maps(profile)
    every = bits(1 if profile.sync_overflow else 0)
    for m in maps.values():
        carried = [f"{SIGNALS[t[0]]} {profile.joints[t[1]]}" if t else "-" for t in m.targets]
        out.frames.append({"cob_id": m.cob_id, "bytes": m.layout.size, "synchronous": m.synchronous, "carries": carried})
        every += bits(m.layout.size) if m.synchronous else 0
    out.load = every / (profile.bitrate * profile.cycle_s)
    if out.load > 1.0:
        out.wrong.append(
            f"a cycle needs {out.load:.0%} of the bus's time; expected less than all of it: a longer cycle or a faster bus"
        )
    elif out.load > FULL:
        out.notes.append(
            f"a cycle takes {out.load:.0%} of the bus's time, before commands: frames may come later than their cycle"
        )
    if "tau" not in profile.signals:
        out.notes.append("no torque: stop bounds are published, but conformance stays UNKNOWN")
    if "status" not in profile.signals:
        out.notes.append("no statusword: the drives are taken to be in operation whenever they send")
    if not profile.sync_overflow:
        out.notes.append("SYNC has no counter (0x1019): lost cycles are told by the clock alone")
    if not profile.heartbeat_s:
        out.notes.append("no heartbeats (0x1017): a drive that has stopped is noticed by its missing frames alone")
    if profile.sync_id in maps or not 0 < profile.sync_id < SERVICES:
        out.wrong.append(
            f"sync_id 0x{profile.sync_id:03X} is another service's or a PDO's; expected SYNC's own COB-ID (object 0x1005)"
        )
    return out


def against_log(out: ProfileCheck, profile: Profile, frames: Iterable[Frame]) -> None:
    """The same, held against what was heard on the bus."""
    decoder, seen, syncs = Decoder(profile), Counter[int](), []
    values = []
    for f in frames:
        seen[f.cob_id] += 1
        if f.cob_id == profile.sync_id:
            syncs.append(f.t)
        cycle = decoder.frame(f.cob_id, f.data, f.t)
        if cycle is not None:
            values.append(cycle.values)
    period = float(np.median(np.diff(syncs))) if len(syncs) > 1 else float("nan")
    silent = [f"0x{c:03X}" for c in decoder.maps if not seen[c] and decoder.maps[c].synchronous]
    nodes = set(profile.nodes.values())
    known = {profile.sync_id, *decoder.maps, *(EMCY + n for n in nodes), *(HEARTBEAT + n for n in nodes), 0}
    foreign = {f"0x{c:03X}": n for c, n in sorted(seen.items()) if c not in known}
    out.heard = {
        "sync": len(syncs), "period_s": period if np.isfinite(period) else None, "cycles": len(values),
        "incomplete_cycles": decoder.incomplete, "silent": silent, "others": foreign,
    }  # fmt: skip
    if len(syncs) < FEW:
        out.wrong.append(
            f"the log holds {len(syncs)} SYNC on 0x{profile.sync_id:03X}; expected some seconds of them: sync_id, or the log"
        )
        return
    if abs(period - profile.cycle_s) > OFF * profile.cycle_s:
        out.wrong.append(
            f"SYNC comes every {period * 1e3:.4g} ms; expected cycle_s = {profile.cycle_s * 1e3:g} ms: put the bus's"
        )
    if silent:
        out.wrong.append(f"nothing was heard on {', '.join(silent)}; expected those PDOs: node ids, or the drives' mapping")
    elif len(values) < 0.5 * len(syncs):
        out.wrong.append(
            f"{len(values)} of {len(syncs)} cycles were whole; expected nearly all: PDOs of another length, or later than the next SYNC"
        )
    if values:
        _plausible(out, profile, np.array(values))


def _plausible(out: ProfileCheck, profile: Profile, x: np.ndarray[Any, np.dtype[np.float64]]) -> None:
    """Do positions change as speeds say? A wrong scale or sign shows there."""
    n = len(profile.joints)
    q, dq = x[:, 0], x[:, 1]
    for j in range(n):
        moved, said = np.diff(q[:, j]), 0.5 * (dq[1:, j] + dq[:-1, j]) * profile.cycle_s
        if np.abs(said).sum() < 50 * profile.quantum("q")[j]:
            out.notes.append(f"{profile.joints[j]} stands still in the log: its scales cannot be checked")
            continue
        factor = float(moved @ said / (said @ said))
        if abs(factor - 1.0) > 0.1:
            out.wrong.append(
                f"{profile.joints[j]} turns by {factor:.3g} times what its speed says; expected 1: the scale or sign of q or dq"
            )
