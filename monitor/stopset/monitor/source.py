"""Where samples come from: a CAN bus read by a profile, or ``joint_states`` on zenoh. Both only listen."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from stopset.errors import BusError
from stopset.monitor.clock import Clock, SystemClock
from stopset.monitor.grid import Cycles
from stopset.monitor.jointstate import MAX_BYTES, JointState
from stopset.monitor.jointstate import decode as decode_joint_state
from stopset.monitor.links.batch import Batch, Listener, filler
from stopset.monitor.links.decoder import Cycle, Decoder
from stopset.monitor.nodes import Nodes
from stopset.monitor.profile import SIGNALS, Profile
from stopset.monitor.sample import Quantum, Sample
from stopset.monitor.senders import Senders
from stopset.types import Array

Q, DQ, TAU, TEMP, _ = range(len(SIGNALS))
STOOD = 0.1  # [s] more between two SYNC than their counter says: no stamp is late by as much, the master has stood still
SLOW_CYCLE = 0.2  # [s] of longer ones none may be whole between two looks, and nothing is wrong
GAP = 1000  # a step in the cycle number that no run of samples makes
BACKLOG = 8  # messages that may wait; of more the oldest are dropped
TURN = 1024  # frames looked at in one turn at most, a few milliseconds' work
LOG = 65536  # frames kept for the record of a violation: 5 s of six drives with two PDOs each at 1 kHz
SWAPPED = 1.0  # [s] a stamp that goes back by less is an old message, by more a clock that was set


class SampleSource(Protocol):
    """``next`` waits up to ``timeout`` [s] for a sample; raises `BusError` when there is no bus any more.

    ``complaints``: what the other side has said or sent wrongly since the last call, in words; ``heard``: the frames of the
    bus stamped between two times, as (time [s], identifier, bytes), for the record of a violation.
    """

    quantum: Quantum
    dropped: int  # samples that were not given out because newer ones were there

    def next(self, timeout: float) -> Sample | None: ...
    def counters(self) -> dict[str, int]: ...
    def complaints(self) -> list[str]: ...
    def heard(self, first: float, last: float) -> list[tuple[float, int, bytes]]: ...
    def close(self) -> None: ...


def sample_of(cycle: Cycle, k: int, bad_nodes: int = 0, fault: str = "") -> Sample:
    """SI values of a cycle as a sample; what the bus does not carry is None."""
    x, lacks = cycle.values, cycle.lacks  # made for this cycle alone
    tau, temp = None if lacks & 1 << TAU else x[TAU], None if lacks & 1 << TEMP else x[TEMP]
    return Sample(k, cycle.t, x[Q], x[DQ], tau, temp, cycle.powered, fault, bad_nodes)


@dataclass(slots=True)
class CycleCount:
    """Numbers the cycles, so that lost ones leave a gap: by the SYNC counter where the master has one, else by the clock."""

    cycle_s: float
    overflow: int
    k: int = 0
    missed: int = 0
    cycles: int = 0
    _before: Cycle | None = None

    def __call__(self, c: Cycle) -> int:
        b, self._before, self.cycles = self._before, c, self.cycles + 1
        if b is None:
            return self.k
        elapsed = (c.t - b.t) / self.cycle_s
        if self.overflow and c.counter is not None and b.counter is not None:
            step = (c.counter - b.counter) % self.overflow
            # over half a round the counter is ambiguous; going back in time is a new start; a master that stood still has not counted
            if not -0.5 < elapsed < 0.5 * self.overflow or step == 0 or (elapsed - step) * self.cycle_s > STOOD:
                step = GAP
        else:
            step = round(elapsed) if 0.5 < elapsed < 1e6 else GAP
        if step != 1:
            self.missed += max(step - 1, 0) if step != GAP else 1
        self.k += step
        return self.k


@dataclass(slots=True)
class CanSource:
    """Samples of a bus. ``cycle_s``: SYNC period as it passes on the wire (a fast replay's is shorter).

    ``oldest_s``: samples older than this are dropped and counted while newer ones wait, and never worked off.
    """

    bus: Listener
    profile: Profile
    cycle_s: float
    oldest_s: float = float("inf")
    clock: Clock = field(default_factory=SystemClock)
    decoder: Decoder = field(init=False)
    quantum: Quantum = field(init=False)
    dropped: int = 0
    _count: CycleCount = field(init=False)
    _batch: Batch = field(default_factory=Batch)
    _fill: Callable[[Batch, float], None] = field(init=False)
    _failed: BusError | None = None  # the bus, behind the frames that are still to be looked at
    _seen: tuple[int, int] = (-1, 0)  # frames and cycles when complaints were asked for last, and what then was lacking
    _lacked: str = ""

    def __post_init__(self) -> None:
        self.decoder = Decoder(self.profile, self.cycle_s, LOG, joined=True)
        self._count = CycleCount(self.cycle_s, self.profile.sync_overflow)
        p = self.profile
        self.quantum = Quantum(p.quantum("q"), p.quantum("dq"), p.quantum("tau"))
        self._fill = filler(self.bus)

    def next(self, timeout: float) -> Sample | None:
        """Waits for a sample if none is there; ends in time whatever else passes on the bus."""
        batch, decoder, end, wait, found = self._batch, self.decoder, self.clock.monotonic() + timeout, timeout, None
        last = decoder.frames + TURN
        while True:
            if batch.taken[0] == batch.count:
                try:
                    self._refill(wait)
                except BusError as e:
                    if found is None:
                        raise
                    self._failed = e  # behind the sample that is in hand
                    break
                if not batch.count and (found is not None or self.clock.monotonic() >= end):
                    break
            now = self.clock.time_ns() * 1e-9
            cycle = decoder.take(batch, now)
            if cycle is not None:
                self.dropped += found is not None
                found = self._sample(cycle, now)
                if now - found.t <= self.oldest_s:
                    break
            wait = 0.0 if found is not None else max(0.0, end - self.clock.monotonic())
            if decoder.frames >= last:
                break
        return found

    def _refill(self, wait: float) -> None:
        """The next frames; those that came before a bus failed, an emergency perhaps, are looked at before that is said."""
        if self._failed is not None:
            raise self._failed
        self._batch.clear()
        try:
            self._fill(self._batch, wait)
        except BusError as e:
            if not self._batch.count:
                raise
            self._failed = e

    def _sample(self, cycle: Cycle, now: float) -> Sample:
        bits, words = (0, "") if self.decoder.nodes_good else self.decoder.nodes.bad(now)
        return sample_of(cycle, self._count(cycle), bits, words)

    def counters(self) -> dict[str, int]:
        d = self.decoder
        return {
            "frames": d.frames,
            # each of the first is a sample (given out or dropped) or one of the next three
            "cycles": d.begun,
            "incomplete_cycles": d.incomplete,
            "doubtful_cycles": d.doubtful,
            "cycles_underway": d.underway,
            "other_frames": d.unknown,
            "missed_cycles": self._count.missed,
            "dropped": self.dropped,
            "lost_frames": getattr(self.bus, "lost", 0),
        }

    def complaints(self) -> list[str]:
        nodes = self.decoder.nodes
        said, nodes.emergencies = nodes.emergencies, []
        names = {node: joint for joint, node in self.profile.nodes.items()}
        words = [
            f"{names.get(node, f'node {node}')}: EMCY 0x{int.from_bytes(d[:2], 'little'):04X}, {d.hex(' ')}" for node, d in said
        ]
        before, self._lacked = self._lacked, self._lacking()
        self._seen = self.decoder.frames, self._count.cycles
        return [*words, self._lacked] if self._lacked not in ("", before) else words

    def _lacking(self) -> str:
        """What never came since `complaints` were asked for last, if there was no cycle; empty if there was one."""
        frames, cycles = self._seen
        if frames < 0 or self._count.cycles > cycles or self.cycle_s > SLOW_CYCLE:
            return ""
        came, p = self.decoder.came_since(frames), self.profile
        if p.sync_id not in came:
            return f"no SYNC (0x{p.sync_id:03X}) on the bus; look at the master, cable, power and bit rate"
        absent = [m for m in self.decoder.maps.values() if m.synchronous and m.cob_id not in came]
        of = [f"0x{m.cob_id:03X} of {', '.join(sorted({p.joints[t[1]] for t in m.targets if t is not None}))}" for m in absent]
        if not of:
            return "all PDOs come, but not once each after every SYNC: no cycle is whole; look for a second sender, and at the bus load"
        return f"no cycle is whole, for these PDOs do not come: {'; '.join(of)}; look at these drives, and whether their mapping is the profile's"

    def heard(self, first: float, last: float) -> list[tuple[float, int, bytes]]:
        return self.decoder.heard(first, last)

    def close(self) -> None:
        self.bus.close()


def drives_of(source: SampleSource) -> Nodes | None:
    """What its drives say of themselves, if the source hears that once and must remember it."""
    return source.decoder.nodes if isinstance(source, CanSource) else None


def resumed(source: SampleSource, before: SampleSource) -> SampleSource:
    """``source``, on the bus of ``before`` that was lost: what its drives said there is not forgotten."""
    if isinstance(source, CanSource) and isinstance(before, CanSource):
        source.decoder.nodes.remember(before.decoder.nodes)
    return source


@dataclass(slots=True)
class NoSource:
    """A bus that is not there yet; ``until`` [s, monotonic] it is waited for."""

    profile: Profile
    until: float
    dropped: int = 0
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

    def heard(self, first: float, last: float) -> list[tuple[float, int, bytes]]:
        return []

    def close(self) -> None:
        """Nothing is open."""


@dataclass(slots=True)
class JointStateSource:
    """Samples of ``joint_states``; give its `take` to a subscription. Stamps may jitter about their cycles, see `Cycles`.

    ``backlog``: messages that may wait for their turn; when more do, the oldest are dropped and counted.
    """

    joints: tuple[str, ...]
    cycle_s: float
    backlog: int = BACKLOG
    quantum: Quantum = field(init=False)
    received: int = 0
    refused: int = 0
    missed: int = 0
    dropped: int = 0
    complaint: str = ""
    _senders: Senders = field(default_factory=Senders)
    _waiting: deque[bytes] = field(init=False)
    _there: threading.Semaphore = field(default_factory=lambda: threading.Semaphore(0))
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _k: int = 0
    _stamp: int | None = None
    _cycles: Cycles = field(init=False)

    def __post_init__(self) -> None:
        self.quantum, self._cycles = Quantum.none(len(self.joints)), Cycles(self.cycle_s)
        self._waiting = deque(maxlen=self.backlog)

    def take(self, _key: str, data: bytes) -> None:
        """Called from zenoh's thread: nothing but the queue."""
        self.received += 1
        if len(data) > MAX_BYTES:
            self.refused += 1
            self.complaint = f"joint_states message of {len(data)} bytes; expected at most {MAX_BYTES}: look at the sender"
            return
        with self._lock:
            full = len(self._waiting) == self.backlog
            self._waiting.append(data)
        self.dropped += full
        if not full:
            self._there.release()

    def next(self, timeout: float) -> Sample | None:
        if not self._there.acquire(timeout=timeout):
            return None
        with self._lock:
            data = self._waiting.popleft()
        try:
            return self._sample(decode_joint_state(data), data)
        except BusError as e:  # the stamp of the next good one shows the gap
            self.refused += 1
            self.complaint = str(e)
            return None

    def _sample(self, s: JointState, data: bytes) -> Sample:
        q, dq, tau = self._rows(s)
        later = self.cycle_s if self._stamp is None else (s.stamp_ns - self._stamp) * 1e-9
        late = -SWAPPED < later <= 0.0
        self._senders.take(data, late=late)
        if late:
            if later:
                self._cycles.leave_out()
            raise BusError(
                self._senders.fault or "joint_states came twice or out of order; the later one counts: look at the sender"
            )
        found = self._cycles.step(s.stamp_ns)
        if found is None:
            raise BusError("a joint_states stamp lies far from its cycle, or one was lost: left out; look at the sender's clock")
        whole, off = found
        whole = whole or GAP
        self.missed += max(whole - 1, 0) if whole != GAP else 1
        self._k += whole
        self._stamp = s.stamp_ns

        # without torque there is no verdict, but there are stop bounds
        fault = self._senders.fault
        return Sample(self._k, s.stamp_ns * 1e-9, q, dq, tau, fault=fault, off=off, place_error=self._cycles.place_error)

    def _rows(self, s: JointState) -> tuple[Array, Array, Array | None]:
        """Positions, speeds and torques (n,) of this arm's joints; raises `BusError` where there are none."""
        place = {name: i for i, name in enumerate(s.name)}
        if lacking := [j for j in self.joints if j not in place]:
            raise BusError(f"joint_states lacks {', '.join(lacking)}; it names {', '.join(s.name)}")
        index, rows = [place[j] for j in self.joints], []
        for what, values in (("position", s.position), ("velocity", s.velocity), ("effort", s.effort)):
            row = np.array([values[i] for i in index]) if values else np.full(len(index), np.nan)
            absent = [j for j, x in zip(self.joints, row.tolist(), strict=True) if x != x]
            if absent and (what != "effort" or len(absent) < len(index)):
                raise BusError(
                    f"joint_states carries no {what} of {', '.join(absent)}; expected position and velocity of every joint, and effort of "
                    "all or none: look at the sender's state interfaces"
                )
            rows.append(None if absent else row)
        q, dq, tau = rows
        assert q is not None
        assert dq is not None
        return q, dq, tau

    def counters(self) -> dict[str, int]:
        return {
            "messages": self.received, "refused_messages": self.refused, "missed_cycles": self.missed, "dropped": self.dropped,
        }  # fmt: skip

    def complaints(self) -> list[str]:
        said, self.complaint = self.complaint, ""
        return [said] if said else []

    def heard(self, first: float, last: float) -> list[tuple[float, int, bytes]]:
        return []

    def close(self) -> None:
        """Nothing to close: the session belongs to the daemon."""
