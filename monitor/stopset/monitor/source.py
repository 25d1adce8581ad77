"""Where samples come from: a CAN bus read by a profile, or ``joint_states`` on zenoh. Both only listen."""

from __future__ import annotations

import math
import queue
import time
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from stopset.errors import BusError
from stopset.monitor.jointstate import JointState
from stopset.monitor.jointstate import decode as decode_joint_state
from stopset.monitor.links.bus import Listener
from stopset.monitor.links.canopen_map import Cycle, Decoder
from stopset.monitor.profile import SIGNALS, Profile
from stopset.monitor.watch import Quantum, Sample

Q, DQ, TAU, TEMP, STATUS = range(len(SIGNALS))
GAP = 1000  # a step in the cycle number that no run of samples makes


class Source(Protocol):
    """``next`` waits up to ``timeout`` [s] for a sample; raises `BusError` when there is no bus any more.

    ``complaints``: what the other side has said or sent wrongly since the last call, in words.
    """

    quantum: Quantum

    def next(self, timeout: float) -> Sample | None: ...
    def counters(self) -> dict[str, int]: ...
    def complaints(self) -> list[str]: ...
    def close(self) -> None: ...


def sample_of(cycle: Cycle, k: int) -> Sample:
    """SI values of a cycle as a sample; what the bus does not carry is None."""
    v = cycle.values
    tau = v[TAU].copy() if not np.isnan(v[TAU]).any() else None
    temp = v[TEMP].copy() if not np.isnan(v[TEMP]).any() else None
    status = v[STATUS]
    # CiA 402 statusword: operation enabled
    powered = bool(np.all((np.nan_to_num(status, nan=0x27).astype(int) & 0x6F) == 0x27))
    return Sample(k, cycle.t, v[Q].copy(), v[DQ].copy(), tau, temp, powered)


@dataclass(slots=True)
class CycleCount:
    """Numbers the cycles, so that lost ones leave a gap: by the SYNC counter where the master has one, else by the clock."""

    cycle_s: float
    overflow: int
    k: int = 0
    missed: int = 0
    _before: Cycle | None = None

    def __call__(self, c: Cycle) -> int:
        b, self._before = self._before, c
        if b is None:
            return self.k
        elapsed = (c.t - b.t) / self.cycle_s
        if self.overflow and c.counter is not None and b.counter is not None:
            step = (c.counter - b.counter) % self.overflow
            # over half a round the counter is ambiguous; going back in time is a new start
            if not -0.5 < elapsed < 0.5 * self.overflow or step == 0:
                step = GAP
        else:
            step = round(elapsed) if 0.5 < elapsed < 1e6 else GAP
        self.missed += max(step - 1, 0) if step != GAP else 1
        self.k += step
        return self.k


@dataclass(slots=True)
class CanSource:
    """Samples of a bus. ``cycle_s``: SYNC period as it passes on the wire (a fast replay's is shorter)."""

    bus: Listener
    profile: Profile
    cycle_s: float
    decoder: Decoder = field(init=False)
    quantum: Quantum = field(init=False)
    frames: int = 0
    _count: CycleCount = field(init=False)

    def __post_init__(self) -> None:
        self.decoder = Decoder(self.profile)
        self._count = CycleCount(self.cycle_s, self.profile.sync_overflow)
        p = self.profile
        self.quantum = Quantum(p.quantum("q"), p.quantum("dq"), p.quantum("tau"))

    def next(self, timeout: float) -> Sample | None:
        end = time.monotonic() + timeout
        while True:
            frame = self.bus.recv(max(0.0, end - time.monotonic()))
            if frame is None:
                if time.monotonic() >= end:
                    return None
                continue
            self.frames += 1
            cycle = self.decoder.frame(frame.cob_id, frame.data, frame.t)
            if cycle is not None:
                return sample_of(cycle, self._count(cycle))

    def counters(self) -> dict[str, int]:
        d = self.decoder
        return {
            "frames": self.frames,
            "incomplete_cycles": d.incomplete,
            "other_frames": d.unknown,
            "missed_cycles": self._count.missed,
        }

    def complaints(self) -> list[str]:
        said, self.decoder.emergencies = self.decoder.emergencies, []
        names = {node: joint for joint, node in self.profile.nodes.items()}
        return [
            f"{names.get(node, f'node {node}')}: EMCY 0x{int.from_bytes(d[:2], 'little'):04X}, {d.hex(' ')}" for node, d in said
        ]

    def close(self) -> None:
        self.bus.close()


@dataclass(slots=True)
class NoSource:
    """A bus that is not there yet; ``until`` [s, monotonic] it is waited for."""

    profile: Profile
    until: float
    quantum: Quantum = field(init=False)

    def __post_init__(self) -> None:
        p = self.profile
        self.quantum = Quantum(p.quantum("q"), p.quantum("dq"), p.quantum("tau"))

    def next(self, timeout: float) -> Sample | None:
        raise BusError("the bus is not there yet; waiting for it")

    def counters(self) -> dict[str, int]:
        return {}

    def complaints(self) -> list[str]:
        return []

    def close(self) -> None:
        """Nothing is open."""


@dataclass(slots=True)
class JointStateSource:
    """Samples of ``joint_states``; give its `take` to a subscription. The stamp is the sampling instant."""

    joints: tuple[str, ...]
    cycle_s: float
    quantum: Quantum = field(init=False)
    received: int = 0
    refused: int = 0
    missed: int = 0
    complaint: str = ""
    _queue: queue.SimpleQueue[bytes] = field(default_factory=queue.SimpleQueue)
    _k: int = 0
    _stamp: int | None = None

    def __post_init__(self) -> None:
        self.quantum = Quantum.none(len(self.joints))

    def take(self, _key: str, data: bytes) -> None:
        """Called from zenoh's thread: nothing but the queue."""
        self._queue.put(data)

    def next(self, timeout: float) -> Sample | None:
        try:
            data = self._queue.get(timeout=timeout)
        except queue.Empty:
            return None
        self.received += 1
        try:
            return self._sample(decode_joint_state(data))
        except BusError as e:  # the stamp of the next good one shows the gap
            self.refused += 1
            self.complaint = str(e)
            return None

    def _sample(self, s: JointState) -> Sample:
        place = {name: i for i, name in enumerate(s.name)}
        if lacking := [j for j in self.joints if j not in place]:
            raise BusError(f"joint_states lacks {', '.join(lacking)}; it names {', '.join(s.name)}")
        if not s.position or not s.velocity:
            raise BusError("joint_states carries no position or velocity; the check needs both")
        index = [place[j] for j in self.joints]
        step = 1 if self._stamp is None else (s.stamp_ns - self._stamp) * 1e-9 / self.cycle_s
        whole = round(step) if math.isfinite(step) else 0
        # a stamp off the grid by more than a tenth of a cycle is not the grid the model was identified on
        if whole < 1 or abs(step - whole) > 0.1:
            whole = GAP
        self.missed += max(whole - 1, 0) if whole != GAP else 1
        self._k += whole
        self._stamp = s.stamp_ns

        def row(x: tuple[float, ...]) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
            return np.array([x[i] for i in index])

        return Sample(self._k, s.stamp_ns * 1e-9, row(s.position), row(s.velocity), row(s.effort) if s.effort else None)

    def counters(self) -> dict[str, int]:
        return {"messages": self.received, "refused_messages": self.refused, "missed_cycles": self.missed}

    def complaints(self) -> list[str]:
        said, self.complaint = self.complaint, ""
        return [said] if said else []

    def close(self) -> None:
        """Nothing to close: the session belongs to the daemon."""
