"""The arm's CANopen frames as a table: canopen reads the DCF once, the loop only unpacks.

`Encoder` makes frames of samples, for replay; the way back is `stopset.monitor.links.decoder`.
"""

from __future__ import annotations

import configparser
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import canopen
import numpy as np
from canopen.objectdictionary import ObjectDictionaryError, datatypes

from stopset.errors import BusError
from stopset.monitor.nodes import HEARTBEAT, OPERATIONAL
from stopset.monitor.profile import AXIS, SIGNALS, SLOW, Profile
from stopset.types import Array

FORMATS = {
    datatypes.INTEGER8: "b", datatypes.INTEGER16: "h", datatypes.INTEGER32: "i", datatypes.INTEGER64: "q",
    datatypes.UNSIGNED8: "B", datatypes.UNSIGNED16: "H", datatypes.UNSIGNED32: "I", datatypes.UNSIGNED64: "Q",
    datatypes.REAL32: "f", datatypes.REAL64: "d", datatypes.BOOLEAN: "?",
}  # fmt: skip
LONGEST = 8  # bytes of a frame
MAPPINGS = range(0x1A00, 0x1C00)  # objects that say what TPDOs map (CiA 301)
FIRST_OF_AXES = 0x6000  # objects below are the device's


@dataclass(frozen=True, slots=True)
class FrameMap:
    """One PDO: how its bytes unpack, and for each value the (signal row, joint) it goes to, or None for values not needed.

    ``synchronous``: it comes once after every SYNC; else when a value changes, and only slow signals are taken from it.
    """

    cob_id: int
    layout: struct.Struct
    targets: tuple[tuple[int, int] | None, ...]
    codes: str
    synchronous: bool = True


def frame_maps(profile: Profile) -> dict[int, FrameMap]:
    """Frames of ``profile`` that carry a wanted signal, by COB-ID; raises `BusError` if a signal is mapped nowhere or twice."""
    try:
        stat = profile.dcf.stat()
    except OSError as e:
        raise BusError(f"{profile.dcf} cannot be read ({e.strerror}); expected an EDS or DCF beside the profile") from e
    wanted = tuple((name, s.object, s.sub) for name, s in profile.signals.items())
    axes = profile.axes or (0,) * len(profile.nodes)
    joints = tuple((joint, node, axis) for (joint, node), axis in zip(profile.nodes.items(), axes, strict=True))
    return dict(_frame_maps(profile.name, profile.dcf, (stat.st_mtime_ns, stat.st_size), joints, wanted))


@lru_cache(maxsize=8)
def _frame_maps(
    profile: str,
    dcf: Path,
    _version: tuple[int, int],
    joints: tuple[tuple[str, int, int], ...],
    signals: tuple[tuple[str, int, int], ...],
) -> dict[int, FrameMap]:
    found: dict[tuple[int, int], int] = {}
    maps: dict[int, FrameMap] = {}
    network = canopen.Network()  # never connected: nothing is sent
    for node_id in dict.fromkeys(node for _, node, _ in joints):
        wanted = {
            (index + AXIS * axis if index >= FIRST_OF_AXES else index, sub): (SIGNALS.index(name), joint)
            for joint, (_, node, axis) in enumerate(joints) if node == node_id
            for name, index, sub in signals
        }  # fmt: skip
        try:
            node = network.add_node(canopen.RemoteNode(node_id, str(dcf)))
            _settle(node.object_dictionary)
            node.tpdo.read(from_od=True)  # type: ignore[no-untyped-call]
        except (configparser.Error, ObjectDictionaryError, KeyError, ValueError, TypeError, AttributeError) as e:
            raise BusError(f"{dcf} is not a usable EDS or DCF ({type(e).__name__}: {e}); mend or replace it") from e
        # synchronous ones first: what is mapped twice is taken from them
        for pdo in sorted(node.tpdo.values(), key=lambda p: not _synchronous(p)):
            if not pdo.enabled or not pdo.map:
                continue
            frame = _frame_map(pdo, dcf, wanted, found)
            if any(t is not None for t in frame.targets):
                maps[pdo.cob_id] = frame
    for joint, (name, _, _) in enumerate(joints):
        lacking = [s for s, _, _ in signals if (SIGNALS.index(s), joint) not in found]
        if lacking:
            what = "synchronous TPDO" if set(lacking) - set(SLOW) else "TPDO"
            raise BusError(
                f"profile {profile}: {', '.join(lacking)} of {name} is in no {what} of {dcf.name}; expected positions, speeds and "
                "torques after every SYNC: have the master map them, or take a signal that is not there out of the profile"
            )
    return maps


def _settle(dictionary: Any) -> None:
    """A TPDO of which the file does not say how much it maps, as makers' files leave those that nobody uses, maps nothing."""
    for index in MAPPINGS:
        count = dictionary[index].get(0) if index in dictionary else None
        if count is not None and count.value is None and count.default is None:
            count.default = 0


def _synchronous(pdo: Any) -> bool:
    return pdo.trans_type is not None and 0 <= pdo.trans_type <= 240


def _frame_map(
    pdo: Any, dcf: Path, wanted: dict[tuple[int, int], tuple[int, int]], found: dict[tuple[int, int], int]
) -> FrameMap:
    codes, targets, synchronous = "<", [], _synchronous(pdo)
    for v in pdo.map:
        code = FORMATS.get(v.od.data_type)
        if code is None or struct.calcsize("<" + code) * 8 != v.length:
            raise BusError(f"{dcf}: object 0x{v.index:04X} is mapped with {v.length} bits; expected whole standard numbers")
        codes += code
        target = wanted.get((v.index, v.subindex))
        if target is not None and (target in found or not (synchronous or SIGNALS[target[0]] in SLOW)):
            target = None  # mapped twice: the first PDO counts; or of no known instant
        targets.append(target)
        if target is not None:
            found[target] = pdo.cob_id
    layout = struct.Struct(codes)
    if layout.size > LONGEST:
        raise BusError(
            f"{dcf}: the PDO on 0x{pdo.cob_id:03X} maps {layout.size} bytes; expected at most {LONGEST}: mend its mapping"
        )
    return FrameMap(pdo.cob_id, layout, tuple(targets), codes[1:], synchronous)


class Number(NamedTuple):
    """A number of a frame: its ``bits`` and between which ends it lies, 0 for one that is not whole; and its (signal row, joint)."""

    bits: int
    lo: int
    hi: int
    target: tuple[int, int] | None

    @classmethod
    def of(cls, code: str, target: tuple[int, int] | None) -> Number:
        """By its letter in `FORMATS`."""
        if code in "fd":
            return cls(0, 0, 0, target)
        bits = 8 * struct.calcsize("<" + code)
        return cls(bits, *((-(1 << bits - 1), (1 << bits - 1) - 1) if code.islower() else (0, (1 << bits) - 1)), target)


@dataclass(slots=True)
class Encoder:
    """One sample to the frames a bus with this profile would show: SYNC first, then every PDO, and heartbeats when due."""

    profile: Profile
    maps: dict[int, FrameMap] = field(init=False)
    _scale: Array = field(init=False)  # (signals, n)
    _numbers: dict[int, list[Number]] = field(init=False)  # of each frame, as they stand in it
    _count: int = 0
    _beats: int = 0  # heartbeat periods that have gone by
    _sent: dict[int, bytes] = field(default_factory=dict)  # what was sent last; event-driven frames go when it changes

    def __post_init__(self) -> None:
        self.maps = frame_maps(self.profile)
        self._scale = np.ones((len(SIGNALS), len(self.profile.nodes)))
        for name, s in self.profile.signals.items():
            self._scale[SIGNALS.index(name)] = s.scale
        self._numbers = {m.cob_id: [Number.of(c, t) for c, t in zip(m.codes, m.targets, strict=True)] for m in self.maps.values()}

    def skip(self, cycles: int) -> None:
        """Let the SYNC counter run on as if ``cycles`` had gone by unseen."""
        self._count += cycles

    def frames(self, values: Array) -> Iterator[tuple[int, bytes]]:
        """(COB-ID, data) of one cycle for SI ``values`` (signals, n); raises `BusError` where a number does not fit."""
        counts = (values / self._scale).tolist()
        overflow = self.profile.sync_overflow
        yield self.profile.sync_id, bytes([self._count % overflow + 1]) if overflow else b""
        self._count += 1
        for m in self.maps.values():
            out: list[float] = []
            for number in self._numbers[m.cob_id]:
                bits, lo, hi, target = number
                x = 0.0 if target is None else counts[target[0]][target[1]]
                if bits and not lo <= x <= hi:
                    raise self._too_large(x, number)
                out.append(round(x) if bits else x)
            data = m.layout.pack(*out)
            if m.synchronous or self._sent.get(m.cob_id) != data:
                self._sent[m.cob_id] = data
                yield m.cob_id, data
        period = self.profile.heartbeat_s
        beats = int(self._count * self.profile.cycle_s / period + 1e-9) if period else 0
        if beats > self._beats:
            self._beats = beats
            yield from ((HEARTBEAT + node, bytes([OPERATIONAL])) for node in dict.fromkeys(self.profile.nodes.values()))

    def _too_large(self, x: float, number: Number) -> BusError:
        bits, lo, hi, target = number
        what = f"{SIGNALS[target[0]]} of {self.profile.joints[target[1]]}" if target else "a value"
        return BusError(
            f"{what} is {x:.6g} counts, which {bits} bits of {self.profile.name} cannot carry ({lo} to {hi}); "
            "change the profile's scale"
        )
