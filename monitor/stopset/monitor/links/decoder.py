"""Frames in, complete cycles out: the PDOs of one SYNC as the readings of one instant, taken apart by the core."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np

from stopset.artifact.taped import Pinned
from stopset.core.library import ffi, lib
from stopset.monitor.links.batch import Batch, Frame
from stopset.monitor.links.canopen_map import FrameMap, frame_maps
from stopset.monitor.nodes import Nodes
from stopset.monitor.profile import SIGNALS, Profile
from stopset.types import Array

KINDS = {
    "b": lib.STOPSET_I8, "h": lib.STOPSET_I16, "i": lib.STOPSET_I32, "q": lib.STOPSET_I64, "B": lib.STOPSET_U8, "H": lib.STOPSET_U16,
    "I": lib.STOPSET_U32, "Q": lib.STOPSET_U64, "f": lib.STOPSET_F32, "d": lib.STOPSET_F64, "?": lib.STOPSET_BOOL,
}  # fmt: skip
LOOKED_AT = 1024  # frames, a fraction of a millisecond
FRAME = np.dtype([("id", "=u4"), ("length", "=i4"), ("data", "u1", 8), ("t", "=f8")])  # as the core's `StopsetFrame`
BYTES = {"b": 1, "h": 2, "i": 4, "q": 8, "B": 1, "H": 2, "I": 4, "Q": 8, "f": 4, "d": 8, "?": 1}


class Cycle(msgspec.Struct):  # as `stopset.monitor.sample.Sample`
    """All PDOs of one SYNC: its ``counter`` or None, its reception ``t`` [s], SI ``values`` (signals, n), NaN if absent; bit i of
    ``lacks`` set: some joint's signal i is, ``powered``: no drive says that it is not in operation."""

    counter: int | None
    t: float
    values: Array
    lacks: int
    powered: bool


@dataclass(slots=True)
class Decoder:
    """Frames in, complete cycles out; the sampling instant is the SYNC, not the frames after it.

    A frame that comes after the next SYNC would be counted there, so after an incomplete or doubled cycle the next one only
    serves to find the rhythm again and is not given out.  Two kinds of cycles are held back until the next SYNC, and given
    out if no frame came twice, no SYNC is missing, and it does not come with the last frame: those completed about a period
    after their SYNC, perhaps by the next one's frames, and for 0.2 s after a loss all, because what was lost may still come.
    What the drives say besides goes to ``nodes``.  ``cycle_s``: period on the wire, 0 = the profile's; ``room``: frames kept;
    ``joined``: the bus ran before, so the first cycle may hold a late frame of one that was not seen, and is not given out either.
    """

    profile: Profile
    cycle_s: float = 0.0
    room: int = 1
    joined: bool = False
    maps: dict[int, FrameMap] = field(init=False)
    nodes: Nodes = field(init=False)
    _struct: Any = field(init=False)  # the core's `StopsetDecoder`
    _pinned: Pinned = field(init=False)  # what it points at
    _log: Any = field(init=False)
    _values: Array = field(init=False)
    _one: Batch = field(default_factory=Batch)

    def __post_init__(self) -> None:
        self.cycle_s = self.cycle_s or self.profile.cycle_s
        self.maps = frame_maps(self.profile)
        self.nodes = Nodes(self.profile.nodes, self.profile.heartbeat_s)
        n, maps, pinned = len(self.profile.nodes), list(self.maps.values()), Pinned([])
        shape = (len(SIGNALS), n)
        scale, raw = np.ones(shape), np.full(shape, np.nan)
        for name, s in self.profile.signals.items():
            scale[SIGNALS.index(name)] = s.scale
        for m in maps:
            for target in m.targets:
                if target is not None and not m.synchronous and SIGNALS[target[0]] == "status":
                    raw[target] = 0.0  # as long as it has not said so, a drive is not in operation
        place = np.full(lib.STOPSET_IDS, -1, np.int32)
        pdos: list[tuple[int, bool, int, int]] = []
        fields: list[tuple[int, int, int]] = []
        for k, m in enumerate(maps):
            place[m.cob_id], first = k, len(fields)
            fields += _fields(m, n)
            pdos.append((m.layout.size, m.synchronous, first, len(fields) - first))
        place[self.profile.sync_id] = lib.STOPSET_SYNC
        self._values, self._log = np.empty(shape), ffi.new("StopsetFrame[]", self.room)
        structs = ffi.new("StopsetPdo[]", pdos), ffi.new("StopsetField[]", fields)
        pinned.held.extend(structs)
        self._struct = ffi.new("StopsetDecoder *", {
            "n": n, "signals": len(SIGNALS), "pdos": len(maps), "synchronous": sum(m.synchronous for m in maps),
            "overflow": self.profile.sync_overflow, "cycle_s": self.cycle_s, "place": pinned.array(place, np.int32),
            "pdo": structs[0], "field": structs[1], "scale": pinned.array(scale), "raw": pinned.array(raw),
            "held": pinned.array(np.empty(shape)), "values": pinned.shared(self._values), "came": pinned.array(np.zeros(len(maps)), np.uint8),
            "node": pinned.shared(self.nodes.standing), "heard": pinned.shared(self.nodes.heard), "patience": self.nodes.patience,
            "foreign": -1, "shift": np.inf, "doubtful": self.joined, "log": self._log, "room": self.room,
            "status": SIGNALS.index("status"),
        })  # fmt: skip
        self._pinned = pinned

    @property
    def incomplete(self) -> int:
        """Cycles that lacked a frame, or had one twice."""
        return int(self._struct.incomplete)

    @property
    def begun(self) -> int:
        """Cycles whose SYNC has come. Each is given out, incomplete, doubtful or underway."""
        return int(self._struct.syncs)

    @property
    def doubtful(self) -> int:
        """Whole cycles that were not given out, because a frame in them may be of the one before."""
        return int(self._struct.doubted)

    @property
    def underway(self) -> int:
        """The cycle (0 or 1) that lacks frames yet, or is held back until the next SYNC."""
        s = self._struct
        return int(s.holds or (s.synced and s.seen < s.synchronous))

    @property
    def unknown(self) -> int:
        """Frames of no signal that is looked at."""
        return int(self._struct.unknown)

    @property
    def frames(self) -> int:
        """Frames seen."""
        return int(self._struct.frames)

    @property
    def nodes_good(self) -> bool:
        """Whether all drives were, as of the cycle given out last."""
        return bool(self._struct.nodes_good)

    def take(self, batch: Batch, now: float) -> Cycle | None:
        """Look at the frames of ``batch``, received by ``now`` [s], until one completes a cycle, or none are left."""
        s = self._struct
        while what := lib.stopset_decode(s, batch.frames, batch.count, now, batch.taken):
            if what == lib.STOPSET_CYCLE:
                counter = s.out_counter
                return Cycle(None if counter < 0 else counter, s.out_t, self._values.copy(), s.out_lacks, bool(s.out_powered))
            self.nodes.frame(*self._frame(s.frames - 1))
        return None

    def frame(self, cob_id: int, data: bytes | bytearray, t: float) -> Cycle | None:
        """Take one frame received at ``t`` [s]; returns the cycle it completes, if it does."""
        self._one.clear()
        self._one.put(Frame(cob_id, data, t))
        return self.take(self._one, t)

    def came_since(self, number: int) -> set[int]:
        """Identifiers of the frames from this number on; of a great many, of the last."""
        return {self._log[k % self.room].id for k in range(max(number, self.frames - min(self.room, LOOKED_AT)), self.frames)}

    def _frame(self, number: int) -> Frame:
        f = self._log[number % self.room]
        return Frame(f.id, bytes(ffi.buffer(f.data, min(f.length, 8))), f.t)

    def heard(self, first: float = -np.inf, last: float = np.inf) -> list[tuple[float, int, bytes]]:
        """The frames kept that were stamped between ``first`` and ``last`` [s], in the order they came, as (time [s], identifier, bytes).

        Only these are taken apart: seconds of a violation, of the minute that is kept.
        """
        seen, log = self.frames, np.frombuffer(ffi.buffer(self._log), FRAME)
        entries = log[:seen] if seen <= self.room else np.concatenate([log[seen % self.room :], log[: seen % self.room]])
        rows = entries[(first <= entries["t"]) & (entries["t"] <= last)]
        return [(t, x, data[:length]) for x, length, data, t in zip(
            rows["id"].tolist(), rows["length"].tolist(), [d.tobytes() for d in rows["data"]], rows["t"].tolist(), strict=True
        )]  # fmt: skip


def _fields(m: FrameMap, n: int) -> list[tuple[int, int, int]]:
    """(byte, kind of number, place among the values) of every value that is wanted."""
    out, at = [], 0
    for code, target in zip(m.codes, m.targets, strict=True):
        if target is not None:
            out.append((at, KINDS[code], target[0] * n + target[1]))
        at += BYTES[code]
    return out
