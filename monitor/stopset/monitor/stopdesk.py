"""Stop bounds beside the loop: another process certifies them for boxes of states, the loop looks the state up.

A bound takes milliseconds, a cycle has not that many. So each answer covers a box around the motion ahead, is kept, and serves
whenever the arm comes by again; only where no box holds what is coming is a new one asked for. Two sizes are asked for: a wide
one, which the arm cannot leave soon, whatever it does; and within it narrow ones, which give tight numbers. A state in none
of them has no bound.
"""

from __future__ import annotations

import contextlib
import multiprocessing as mp
import threading
from collections import deque
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from stopset.artifact import Model
from stopset.monitor.certificates import Certificate, Numbers, Shelf, holds
from stopset.monitor.clock import Clock, SystemClock
from stopset.monitor.config import EXPANDED, Stops
from stopset.monitor.sample import Quantum
from stopset.monitor.stopworker import work
from stopset.sets import Box
from stopset.types import Array

LOOK_BACK = 0.04  # [s] over which the acceleration is taken from the speeds
START = 0.25  # [s] from rest to the largest speed identification has seen
MEMORY = 2.0  # [s] in which the largest acceleration seen is forgotten to a third
SPARE_SPEED = 0.04  # [rad/s] noise of a measured speed and of the acceleration made from it; too little costs answers, not truth
SPARE_ANGLE = 5e-4  # [rad]
SLOWER = 2.0  # an answer is expected to take no longer than so many times what the last ones took
FIRST = 0.02  # [s] an answer takes that was never measured
LONGEST = 0.3  # [s] a slower answer finds the arm outside its box
KEPT_WIDE = 256  # certificates of wide boxes, per category
PATIENCE = 6  # narrow boxes asked for after a wide one had no bound
SHRINKS, GROWS, LEAST = 0.6, 1.1, 0.1  # of `Counter.reach`, after a refusal and after a bound
RESTARTS = 5  # of the other process, then it stays ended
TINY = 1e-9  # [rad, rad/s]
LEFT = "the arm has left the states the last bounds were computed for"
PATH = np.linspace(0.0, 1.0, 5)[:, None]  # instants at which the motion ahead is looked at, as parts of it


@dataclass(frozen=True, slots=True)
class Size:
    """A box that covers the motion ``ahead`` [s] of its answer, at accelerations off the present one by ``swerve`` times the
    largest seen of late; ``starts``: also if the arm, still as it may be, starts with all it has."""

    ahead: float
    swerve: float
    starts: bool


# as found on recorded arms: the wide one holds nearly every motion, narrow ones give numbers that hardly widen
WIDE, NARROW = Size(0.2, 1.0, starts=True), Size(0.04, 0.2, starts=False)


@dataclass(slots=True)
class Heading:
    """Where the arm goes, from its last readings, as far as it is ``seen`` (2n,) [rad, rad/s] to go at all; it may always reach
    the largest of these speeds within `START`."""

    seen: Box
    q: Array = field(init=False)
    dq: Array = field(init=False)
    a: Array = field(init=False)
    _past: deque[tuple[float, Array]] = field(default_factory=lambda: deque(maxlen=64))
    _most: Array = field(init=False)  # (n,) [rad/s^2] largest acceleration seen of late
    _fastest: Array = field(init=False)
    _when: float = 0.0

    def __post_init__(self) -> None:
        n = len(self.seen.lo) // 2
        self.q, self.dq, self.a, self._most = (np.zeros(n) for _ in range(4))
        self._fastest = np.maximum(np.abs(self.seen.lo[n:]), np.abs(self.seen.hi[n:]))

    def see(self, t: float, q: Array, dq: Array) -> None:
        """A reading at ``t`` [s]: ``q`` [rad], ``dq`` [rad/s], (n,) each."""
        self._past.append((t, dq))
        self.q, self.dq = q, dq

    def settle(self) -> None:
        """Take the acceleration from what was seen; before `at` and `box`."""
        past = self._past
        if not past:
            return
        now = past[-1][0]
        while len(past) > 2 and now - past[0][0] > LOOK_BACK:
            past.popleft()
        before, was = past[0]
        dq = self.dq
        self.a = (dq - was) / (now - before) if 0.0 < now - before < 2 * LOOK_BACK else np.zeros_like(dq)
        forgotten = max(0.0, 1.0 - max(now - self._when, 0.0) / MEMORY)
        self._most, self._when = np.maximum(forgotten * self._most, np.abs(self.a)), now

    def at(self, after: float) -> Array:
        """(2n,) where the arm is expected ``after`` [s]."""
        x = np.concatenate([self.q + after * (self.dq + 0.5 * after * self.a), self.dq + after * self.a])
        out: Array = np.clip(x, self.seen.lo, self.seen.hi)
        return out

    def box(self, until: float, size: Size) -> tuple[Array, Array]:
        """(2n,) least and largest of what it may do from now ``until`` [s] from now."""
        t = PATH * until
        most = np.maximum(self._most, self._fastest / START) if size.starts else self._most
        swerved = SPARE_SPEED + size.swerve * t * most
        v = self.dq + t * self.a
        q = self.q + t * (self.dq + 0.5 * t * self.a)
        off = SPARE_ANGLE + 0.5 * t * swerved
        lo, hi = np.hstack([q - off, v - swerved]).min(axis=0), np.hstack([q + off, v + swerved]).max(axis=0)
        inner_lo, inner_hi = np.maximum(lo, self.seen.lo), np.minimum(hi, self.seen.hi)
        apart = inner_lo > inner_hi  # the arm is where it never was: what then is answered says so
        return np.where(apart, lo, inner_lo), np.where(apart, hi, inner_hi)


@dataclass(slots=True)
class Counter:
    """What one category has asked for and got."""

    narrow: Shelf
    wide: Shelf
    answer: Certificate | None = None  # the one in use
    refused: Certificate | None = None  # the newest that has no number
    waiting: Size | None = None  # asked for
    only_narrow: int = 0  # so many answers, as a wide box could not be proved
    reach: float = 1.0  # part of a wide box's time ahead that is asked for: less where more could not be proved
    took: float = FIRST

    @classmethod
    def of(cls, n: int) -> Counter:
        return cls(Shelf(n), Shelf(n, KEPT_WIDE))

    def best(self, x: Array, slack: Array) -> Certificate | None:
        """The tightest certificate kept for a reading."""
        return self.narrow.best(x, slack) or self.wide.best(x, slack)

    def holds(self, x: Array, slack: Array) -> Certificate | None:
        """The certificate in use as long as it holds, else the tightest kept."""
        if self.answer is None or not self.answer.covers(x, slack):
            self.answer = self.best(x, slack)
        return self.answer

    def take(self, answer: Certificate) -> None:
        """An answer has come."""
        size, self.waiting = self.waiting, None
        self.took = min(max(answer.took, 0.7 * self.took), LONGEST)
        if answer.numbers.proven:
            (self.wide if size is WIDE else self.narrow).put(answer)
            self.reach = min(1.0, self.reach * (GROWS if size is WIDE else 1.0))
            return
        self.refused = answer
        if size is WIDE:
            self.only_narrow, self.reach = PATIENCE, max(SHRINKS * self.reach, LEAST)

    def lacks(self, motion: Heading, slack: Array, period: float) -> tuple[float, Size] | None:
        """What to ask for next, if anything: how far ahead [s] and which size, with ``period`` [s] until it is asked again.

        A wide box where none holds the state now or will when an answer could be there; a narrow one likewise.
        """
        lead = SLOWER * self.took + period
        here, later = motion.at(0.0), motion.at(2.0 * lead)
        self.answer = self.best(here, slack)  # a tighter one may have come
        if not self.only_narrow and (self.wide.best(here, slack) is None or self.wide.best(later, slack) is None):
            return lead + self.reach * (lead + WIDE.ahead), WIDE
        if self.narrow.best(motion.at(lead), slack) is None:
            self.only_narrow = max(0, self.only_narrow - 1)
            return lead + NARROW.ahead, NARROW
        return None


@dataclass(slots=True)
class StopDesk:
    """Asks for bounds, keeps the answers, says what holds for the state now."""

    model_path: str
    seen: Box  # (2n,) [rad, rad/s] angles and speeds of identification, see `seen_by`
    stops: Stops
    payload: float
    quantum: Quantum
    why: str = "the first stop bound is being computed"
    restarts: int = 0
    clock: Clock = field(default_factory=SystemClock)
    sha256: str = ""  # of the model that is watched; its file may hold another one by now
    counters: dict[str, Counter] = field(init=False)
    _motion: Heading = field(init=False)
    _slack: Array = field(init=False)
    _told: dict[str, Numbers] = field(default_factory=dict)
    _common: tuple[Array, Array] | None = None  # (2n,) the box in which all answers in use hold, unless one may have changed
    _x: Array = field(init=False)
    _none: Numbers | None = None
    _pipe: Connection | None = None
    _process: Any = None
    _inbox: deque[Certificate | str | None] = field(default_factory=deque)
    _ready: bool = False
    _looked: float = float("-inf")
    _turn: int = 0

    def __post_init__(self) -> None:
        self.counters = {c: Counter.of(self.n) for c in self.categories}
        self._x = np.empty(2 * self.n)
        self._slack = np.concatenate([self.quantum.q, self.quantum.dq])
        # a reading on the border lies inside with all that rounding may hide
        room = 2.0 * self._slack + TINY
        self._motion = Heading(Box(self.seen.lo - room, self.seen.hi + room))
        self._start()

    @property
    def n(self) -> int:
        return len(self.seen.lo) // 2

    @property
    def categories(self) -> tuple[str, ...]:
        """What is asked for, STOP 1 with and without a working ramp."""
        return tuple(e for c in self.stops.categories for e in EXPANDED[c])

    @property
    def slowest(self) -> float | None:
        """[s] the category that takes longest lately takes; None before the first answer."""
        return max((c.took for c in self.counters.values()), default=0.0) if self._ready else None

    def _start(self) -> None:
        context = mp.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        args = (self.model_path, self.sha256, self.payload, self.stops, self.categories, theirs)
        self._process = context.Process(target=work, args=args, daemon=True, name="stop-bounds")
        self._process.start()
        theirs.close()
        self._ready = False
        for c in self.counters.values():
            c.waiting = None
        self._inbox = deque()
        # what comes is taken in beside the loop, which then looks at a list and asks no system
        threading.Thread(target=_receive, args=(self._pipe, self._inbox), daemon=True, name="stop-answers").start()

    def offer(self, t: float, q: Array, dq: Array) -> None:
        """The newest state at ``t`` [s]; asks for new bounds where those that are kept do not hold what is coming."""
        self._motion.see(t, q, dq)
        self._collect()
        now, period = self.clock.monotonic(), 1.0 / self.stops.rate_hz
        if not self._ready or now - self._looked < period / len(self.counters):
            return
        # one category at a time, so that no cycle has to look for all of them
        self._looked, self._turn = now, (self._turn + 1) % len(self.counters)
        category, c = list(self.counters.items())[self._turn]
        if c.waiting is not None or self._pipe is None:
            return
        self._motion.settle()
        self._common = None
        wanted = c.lacks(self._motion, self._slack, period)
        if wanted is not None:
            try:
                self._pipe.send((category, *self._motion.box(*wanted)))
                c.waiting = wanted[1]
            except (OSError, ValueError):
                self._lost()

    def _collect(self) -> None:
        while self._inbox:
            answer = self._inbox.popleft()
            if answer is None:
                self._ready = True
            elif isinstance(answer, str):
                self._lost()
            else:
                self.counters[answer.category].take(answer)

    def _lost(self) -> None:
        self.why = "the process that bounds stops has ended; it is started again"
        self.restarts += 1
        if self.restarts < RESTARTS:
            self._start()
        else:
            self._pipe, self._ready, self.why = None, False, "the process that bounds stops keeps ending; no stop provable"

    def now(self, q: Array, dq: Array) -> tuple[dict[str, Numbers], bool]:
        """Bounds by category that hold for this state, and whether all of them were answered for it."""
        x, fresh, n = self._x, True, self.n
        x[:n], x[n:] = q, dq
        if self._common is not None and holds(*self._common, x, self._slack):
            return self._told, True
        told: dict[str, Numbers] = {}
        for category, c in self.counters.items():
            answer = c.holds(x, self._slack)
            if answer is None and c.refused is not None and c.refused.covers(x, self._slack):
                answer = c.refused
            if answer is not None:
                told[category] = answer.numbers
                continue
            fresh = False
            asked = c.narrow.answers or c.wide.answers or c.refused
            told[category] = self._nothing(LEFT if asked else self.why)
        # the same object as long as nothing changes: who makes a message of it need not do so again
        if len(told) != len(self._told) or any(told[c] is not self._told[c] for c in told):
            self._told = told
        used = [c.answer for c in self.counters.values() if c.answer is not None]
        self._common = None
        if len(used) == len(told):
            self._common = np.max([a.lo for a in used], axis=0), np.min([a.hi for a in used], axis=0)
        return self._told, fresh

    def _nothing(self, why: str) -> Numbers:
        if self._none is None or self._none.why != why:
            self._none = Numbers.none(self.n, why)
        return self._none

    def close(self) -> None:
        """End the other process."""
        if self._pipe is not None:
            with contextlib.suppress(OSError, ValueError):
                self._pipe.send(None)
        if self._process is not None:
            self._process.join(timeout=0.2)
            if self._process.is_alive():
                self._process.kill()


def seen_by(model: Model) -> Box:
    """(2n,) the angles and speeds that the model's bounds hold for, as far as the robot can go there."""
    domain, limit = model.domain, model.robot.q_limit
    lo, hi = np.maximum(domain.q.lo, limit[:, 0]), np.minimum(domain.q.hi, limit[:, 1])
    return Box(np.concatenate([lo, domain.dq.lo]), np.concatenate([np.maximum(lo, hi), domain.dq.hi]))


def _receive(pipe: Connection, inbox: deque[Certificate | str | None]) -> None:
    try:
        while True:
            inbox.append(pipe.recv())
    except (EOFError, OSError):
        inbox.append("ended")
