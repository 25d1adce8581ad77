"""A world for the daemon that one number makes: an arm, a bus, a clock, a disk, a network and consumers, and what goes wrong.

Everything the daemon sees of time, of others and of the process that it is comes from here, so a seed and a commit reproduce every life to the
last byte of what it says.
"""

from __future__ import annotations

import heapq
import math
import random
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from monitor_arm import DT, NOISE, VISCOUS, U
from monitor_faults import Fault
from stopset.artifact import Model
from stopset.errors import BusError
from stopset.monitor.certificates import Numbers
from stopset.monitor.config import Bus, Config, Publish, Records, Stops
from stopset.monitor.consumer import Consumer, Expected
from stopset.monitor.daemon import Beside, Daemon
from stopset.monitor.evidence.recorder import Recorder
from stopset.monitor.evidence.trace import Trace
from stopset.monitor.journal import SLOT, Journal, blank
from stopset.monitor.latch import Latch, Record
from stopset.monitor.layout import State, unpack
from stopset.monitor.links.batch import Frame
from stopset.monitor.links.canopen_map import Encoder
from stopset.monitor.profile import SIGNALS, Profile, load_profile
from stopset.monitor.source import CanSource, SampleSource
from stopset.reach.flowpipe import discretise

PROFILE: Profile = load_profile("lwa4p/monitor")
VALID, STALE, RECOVER, EVIDENCE = 0.030, 0.080, 0.060, 0.024  # [s]
EPOCH = 1_700_000_000_000_000_000
EMERGENCY = 0x085  # of node 5
BUS_OFF = "the bus is off"
LOOK = 50e-6  # [s] what any look at the world takes


class Killed(BaseException):
    """The process ends here, without a word."""


@dataclass
class Faults:
    """How often what happens, drawn once per life: probabilities per frame, cycle or message."""

    lost: float
    late: float
    doubled: float
    swapped: float
    bad_stamp: float
    foreign: float
    no_bound: float
    slow_send: float
    send_error: float
    disk_error: float
    rubbish: float

    @classmethod
    def draw(cls, rng: random.Random) -> Faults:
        return cls(*(rng.choice([0.0, 0.0, 0.0, 1e-3, 1e-2]) for _ in cls.__dataclass_fields__))


@dataclass
class Published:
    """A message as the daemon sent it, and how the world was then."""

    at: float  # true time [s]
    life: int
    m: dict[str, Any]
    sampled: float  # true time of the SYNC of the newest sample that the daemon has been given whole
    drives_good: bool
    resets: int  # orders to clear the latch that were sent so far
    stood: float  # how long the daemon was kept from running since the message before


@dataclass
class World:
    """One life of a cell, of ``seconds``; `live` runs it. What was said is in ``published`` and byte by byte in ``said``, what a consumer
    believed in ``believed``. ``model``: as it was saved to or loaded from ``model_path``, for its hash is in every message.
    """

    seed: int
    model_path: Path
    model: Model
    seconds: float = 0.7
    fault: Fault | None = None  # of the arm itself, and then nothing else goes wrong
    published: list[Published] = field(default_factory=list)
    said: list[tuple[str, float, bytes]] = field(default_factory=list)  # key, when
    believed: list[tuple[float, State, float]] = field(default_factory=list)  # time, state, when the data were sampled
    errors: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.rng = rng = random.Random(self.seed)
        self.faults = Faults.draw(rng)
        self.recorder = Recorder(Trace(6), Records(violations=False), Path(), DT, clock=self, pause=lambda: None)
        self.now, self.jumped, self.life, self.resets, self.torn = 0.0, 0, 0, 0, False
        self.altered_at = rng.choice([math.inf, rng.uniform(0.3, 0.8) * self.seconds])
        self.disk, self.flushed, self.counts = bytearray(blank(Record())), bytes(blank(Record())), b""
        self.frames: list[tuple[float, int, Frame, float]] = []
        self.sampled: dict[int, float] = {}
        self.given = -math.inf
        self.off_until = -math.inf
        self.node_bad = self.stopped = False
        self.known = -1  # messages since a daemon has heard the emergency, -1: it has not
        self.stood = 0.0
        self.handlers: list[Callable[[str, bytes], None]] = []
        self.slow: dict[str, list[bytes | str]] = {}
        self.plan = sorted((rng.uniform(0.1, 1.0) * self.seconds, rng.choice(EVENTS)) for _ in range(rng.choice([0, 1, 2, 4])))
        if self.fault is not None:
            self.faults, self.plan, self.altered_at = Faults(*[0.0] * 11), [], math.inf
        self._arm()
        self.consumer = Consumer(Expected(7, None, None, None), 50_000_000)
        # [s] that a message takes to the consumer; drawn apart, so that a seed's life stays the one it was
        self.way = random.Random(f"way {self.seed}").choice([0.0, 0.0, 0.01, 0.02])
        self.boots = random.Random(f"boot {self.seed}")  # and so are these
        self.underway: deque[tuple[float, bytes, float]] = deque()  # when it is there, what, with data of when

    # ---- the arm and its bus

    def _arm(self) -> None:
        """All frames of the life, with what happens to each on its way."""
        rng, draw = self.rng, np.random.default_rng(self.seed)
        Ad, Bd = discretise(self.model.abstraction, DT)
        n, steps = len(VISCOUS), int(self.seconds / DT)
        phase, rate = draw.uniform(0, 2 * np.pi, n), draw.uniform(0.5, 1.5, n)
        encoder, x = Encoder(PROFILE), np.zeros(2 * n)
        for k in range(steps):
            t = k * DT
            u = VISCOUS * 0.5 * np.sin(2 * np.pi * rate * t + phase)
            values = np.full((len(SIGNALS), n), np.nan)
            seen = x + draw.uniform(-NOISE, NOISE, 2 * n)
            factor = np.where(np.arange(n) == 2, 2.0 if t >= self.altered_at else 1.0, 1.0)
            values[0], values[1], values[2], values[3], values[4] = seen[:n], seen[n:], u * factor, 30.0, 0x27
            more = np.zeros(n)
            if self.fault is not None:
                more, values = self.fault.torque(k, u, x[n:]), self.fault.reading(k, values)
            self._send_cycle(k, t, list(encoder.frames(values)), rng)
            x = Ad @ x + Bd @ (u + more + np.where(draw.integers(0, 2, n) == 1, U.hi, U.lo))
        heapq.heapify(self.frames)

    def _send_cycle(self, k: int, t: float, frames: list[tuple[int, bytes]], rng: random.Random) -> None:
        f, at = self.faults, t
        for i, (cob_id, data) in enumerate(frames):
            at = t + 20e-6 * i
            if rng.random() < f.lost:
                continue
            if rng.random() < f.late:
                # later than a cycle, but not so late as to take the very place of another lost frame: PDOs carry no number
                at += rng.choice([1e-3, 5e-3])
            if rng.random() < f.swapped:
                at += 30e-6
            self._put(at, cob_id, data, t if cob_id == 0x080 else at, k)
            if rng.random() < f.doubled:
                self._put(at + 10e-6, cob_id, data, at, k)
        for _ in range(rng.randrange(200) if rng.random() < f.foreign else 0):
            self._put(at, rng.choice([0x2A5, 0x7FF, 0x123]), rng.randbytes(rng.randrange(9)), at, k)

    def _put(self, at: float, cob_id: int, data: bytes, stamp: float, k: int) -> None:
        if self.rng.random() < self.faults.bad_stamp:
            stamp = self.rng.choice([math.nan, math.inf, stamp - 1.0])
        self.frames.append((at, len(self.frames), Frame(cob_id, data, stamp), k * DT))

    def recv(self, timeout: float) -> Frame | None:
        """The bus's: the next frame, if it comes in time."""
        self.pass_time(LOOK / 10)
        if self.now < self.off_until:
            raise BusError(BUS_OFF)
        if self.frames and self.frames[0][0] > self.now:
            self.pass_time(min(timeout, self.frames[0][0] - self.now))
        elif not self.frames:
            self.pass_time(timeout)
        if not self.frames or self.frames[0][0] > self.now:
            return None
        _, _, frame, sampled = heapq.heappop(self.frames)
        if frame.cob_id == 0x080:
            self.given = sampled
        elif frame.cob_id == EMERGENCY:
            self.known = 0
        if self.stopped and frame.cob_id > 0x700:
            frame = frame._replace(data=b"\x04")
        # the adapter stamps with this machine's clock, as it was set then
        return Frame(frame.cob_id, frame.data, frame.t + (EPOCH + self.jumped) * 1e-9) if math.isfinite(frame.t) else frame

    def close(self) -> None:
        """The bus's."""

    # ---- time

    def pass_time(self, seconds: float) -> None:
        """Others live while the daemon waits; what is planned happens on the way."""
        end = self.now + seconds
        while self.plan and self.plan[0][0] <= end:
            at, event = self.plan.pop(0)
            self.now = max(self.now, at)
            end = max(end, self.now) + self._happen(event)
        self.now = end
        if self.now > self.seconds + 0.1:
            raise Killed

    def monotonic(self) -> float:
        self.pass_time(1e-6)
        return 100.0 + self.now

    def time_ns(self) -> int:
        return EPOCH + self.jumped + round(self.now * 1e9)

    def sleep(self, seconds: float) -> None:
        self.pass_time(seconds)

    def _happen(self, event: str) -> float:
        """What goes wrong now; returns how long the daemon stands still for it."""
        rng = self.rng
        if event == "kill":
            raise Killed
        if event == "stop":
            for_s = rng.choice([0.02, 0.2])
            self.stood += for_s
            return for_s
        if event == "jump":
            by = rng.choice([-3600.0, -0.5, 0.05, 3600.0])
            self.jumped += int((0.9 * self.way if self.way and by == 0.05 else by) * 1e9)
        elif event == "bus off":
            self.off_until = self.now + rng.choice([0.01, 0.3])
        elif event == "reset":
            self.resets += 1
            self.order("reset", b'{"name": "A. Person", "reason": "seen"}')
        elif event == "emergency":
            self._frame_now(EMERGENCY, b"\x50\x23\x01\0\0\0\0\0")
        elif event == "drives stop":
            self.stopped = True
            self._frame_now(0x000, b"\x02\x00")
        return 0.0

    def _frame_now(self, cob_id: int, data: bytes) -> None:
        self.node_bad = True
        heapq.heappush(self.frames, (self.now, -1, Frame(cob_id, data, self.now), 0.0))

    # ---- network and disk

    def order(self, name: str, data: bytes) -> None:
        for handler in self.handlers:
            handler(f"x/{name}", data)

    def fast(self, name: str) -> Callable[[bytes], None]:
        def send(data: bytes) -> None:
            rng, f = self.rng, self.faults
            self.pass_time(LOOK)
            self.said.append((name, self.now, data))
            self.recorder.turn()  # which a thread does otherwise
            m = unpack(data)
            self.published.append(Published(self.now, self.life, m, self.given, not self.node_bad, self.resets, self.stood))
            self.stood = 0.0
            self.known += self.known >= 0
            if rng.random() < f.rubbish:
                self.order(rng.choice(["reset", "challenge"]), rng.choice([b"", b"\xff" * 100, b'{"name": "\xff"}', b"[" * 5000]))
            if rng.random() < f.slow_send:
                self.stood += 0.05
                self.pass_time(0.05)
            if rng.random() < f.send_error:
                raise RuntimeError("the session is gone")
            if rng.random() >= f.lost:
                self.underway.append((self.now + self.way, data, self.given))
            self._consume()

        return send

    def _consume(self) -> None:
        mine = 5_000_000_000 + round(self.now * 1e9)
        nonce = self.consumer.challenge(mine, self.rng.getrandbits(64))
        if nonce is not None:
            self.order("challenge", nonce)
        while self.underway and self.underway[0][0] <= self.now:
            _, data, sampled = self.underway.popleft()
            if self.consumer.take(data, mine) == 0:
                self._newest = sampled
        for wait in (0, self.rng.choice([10, 40, 60]) * 1_000_000):
            self.believed.append((self.now + wait * 1e-9, self.consumer.state(mine + wait), getattr(self, "_newest", -math.inf)))

    def put(self, name: str, data: bytes | str, *, must_arrive: bool = False) -> None:
        self.slow.setdefault(name, []).append(data)
        self.said.append((name, self.now, data if isinstance(data, bytes) else data.encode()))
        if self.rng.random() < self.faults.send_error:
            raise RuntimeError("the session is gone")

    def subscribe(self, name: str, handler: Callable[[str, bytes], None]) -> None:
        if not self.handlers:
            self.handlers.append(handler)

    def serve(self, name: str, answer: Callable[[], bytes]) -> None:
        """Nobody asks."""

    def alive(self, name: str) -> None:
        """Nobody looks."""

    settled = True
    astray = interrupted = notice = ""

    def read(self) -> bytes:
        return bytes(self.disk)

    def read_counts(self) -> bytes:
        return self.counts

    def write_counts(self, data: bytes) -> None:
        self.counts = data

    def write(self, offset: int, data: bytes) -> None:
        if self.rng.random() < self.faults.disk_error:
            raise OSError(28, "No space left on device")
        self.disk[offset : offset + len(data)] = data

    def flush(self) -> None:
        self.flushed = bytes(self.disk)

    def _power_lost(self) -> None:
        """One slot is left half written."""
        at = SLOT * self.rng.randrange(2) + self.rng.randrange(200)
        self.disk[at : at + 300] = bytes(300)
        self.torn, self.counts = True, b""

    # ---- lives

    def live(self) -> World:
        """The daemon, started again whenever it ends, until time is over."""
        config = Config(
            str(self.model_path), Bus("hub:1"), data_id=7, stops=Stops(("0",)), sha256="ab" * 32,
            publish=Publish(valid_for_ms=round(VALID * 1e3), stale_ms=round(STALE * 1e3), evidence_min_s=EVIDENCE, recover_s=RECOVER),
        )  # fmt: skip
        while self.now < self.seconds:
            self.life += 1
            self.handlers.clear()
            # an emergency is told once: who comes later knows it from who heard it, and had time and a disk to write it down
            lost = self.torn or self.faults.disk_error > 0.0 or self.known < 2
            self.node_bad = self.stopped or (self.node_bad and not lost)
            try:
                daemon = Daemon(
                    config, self.model, self._open(), self, DT,
                    Beside(Latch(Journal(self)), clock=self, process=Process(self), desk=Desk(self), recorder=self.recorder),  # type: ignore[arg-type]
                )  # fmt: skip
                daemon.run(self._reopen)
            except Killed:
                if self.rng.random() < 0.2:
                    self._power_lost()
            except Exception as e:  # noqa: BLE001 - the life's first finding: nothing may come out of the daemon
                self.errors.append(f"{type(e).__name__}: {e}")
            self.now += 0.01
        return self

    def _open(self) -> CanSource:
        return CanSource(self, PROFILE, DT, VALID, clock=self)

    def _reopen(self) -> SampleSource:
        if self.now < self.off_until:
            raise BusError(BUS_OFF)
        return self._open()


EVENTS = ["kill", "stop", "jump", "bus off", "reset", "emergency", "drives stop"]


class Process:
    """What the daemon knows of the process that it is."""

    def __init__(self, world: World) -> None:
        self.world = world

    def boot(self) -> int:
        return self.world.boots.getrandbits(64)

    def said(self) -> dict[str, Any]:
        return {"processor": {}, "memory_mb": 0.0, "pid": self.world.life}


class Desk:
    """Stop bounds as the other process gives them: there, or not."""

    slowest = None
    restarts = 0
    spending: ClassVar[dict[str, float]] = {}

    def __init__(self, world: World) -> None:
        self.world, self.down_until, a = world, -math.inf, np.full(6, 0.1)
        # the same as long as nothing changes, as the desk gives them
        self.there = {"0": Numbers(a, a, a, 0.02, np.full(6, True))}
        self.gone = {"0": Numbers.none(6, "the process that bounds stops has ended")}

    def offer(self, t: float, q: Any, dq: Any) -> None:
        if self.world.rng.random() < self.world.faults.no_bound:
            self.down_until = self.world.now + self.world.rng.choice([0.0, 0.1])

    def now(self, q: Any, dq: Any) -> tuple[dict[str, Numbers], bool]:
        if self.world.now < self.down_until:
            return self.gone, False
        return self.there, True

    def close(self) -> None:
        """Nothing runs."""
