"""Stop bounds beside the loop: another process certifies them for boxes of states, the loop looks the state up.

A bound takes milliseconds, a cycle has not that many. So each answer covers a box around the motion ahead, is kept, and serves
whenever the arm comes by again; only where no box holds what is coming is a new one asked for. Two sizes are asked for: a wide
one, which the arm cannot leave soon, whatever it does; and within it narrow ones, which give tight numbers, or longer ones where
narrow ones would cost more than their share of a core (`stopset.monitor.asking`). A state in none of them has no bound.
"""

from __future__ import annotations

import contextlib
import queue
import threading
from collections import deque
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from stopset.artifact import Model
from stopset.monitor.ahead import Heading
from stopset.monitor.asking import Budget, Counter
from stopset.monitor.certificates import Certificate, CommonBox, Numbers
from stopset.monitor.clock import Clock, SystemClock
from stopset.monitor.config import EXPANDED, Masses, Stops
from stopset.monitor.sample import Quantum
from stopset.monitor.spawned import Spawned
from stopset.sets import Box
from stopset.types import Array

HUNG = 60.0  # [s] without a word while something is asked: an answer takes a second at most, where the machine is busy ten
AGAIN = 1.0  # [s] between two tries to begin it where the machine refuses
RESTARTS = 5  # of the other process, then it stays ended
TINY = 1e-9  # [rad, rad/s]
LEFT = "the arm has left the states the last bounds were computed for"
SPENT = "the arm moves as it never did, and new bounds would cost more than their share of a core (stops.core_share)"


@dataclass(slots=True)
class StopDesk:
    """Asks for bounds, keeps the answers, says what holds for the state now."""

    model_path: str
    seen: Box  # (2n,) [rad, rad/s] angles and speeds of identification, see `seen_by`
    stops: Stops
    payload: Masses | None
    quantum: Quantum
    why: str = "the first stop bound is being computed"
    restarts: int = 0
    clock: Clock = field(default_factory=SystemClock)
    sha256: str = ""  # of the model that is watched; its file may hold another one by now
    begun: Spawned | None = None  # the other process, if it was begun before
    counters: dict[str, Counter] = field(init=False)
    budget: Budget = field(init=False)
    _motion: Heading = field(init=False)
    _slack: Array = field(init=False)
    _numbers: dict[str, Numbers] = field(default_factory=dict)
    _common: CommonBox = field(init=False)
    _none: Numbers | None = None
    _pipe: Connection | None = None
    _process: Any = None
    _inbox: deque[Certificate | str | None] = field(default_factory=deque)
    _ready: bool = False
    _looked: float = float("-inf")
    _heard: float = 0.0  # [s] when it said something last, or was asked first
    _turn: int = 0
    _again: float = float("inf")  # [s] when it is to be begun once more
    _coming: queue.SimpleQueue[Spawned | Exception] = field(
        default_factory=queue.SimpleQueue
    )  # begun beside the loop, or why not

    def __post_init__(self) -> None:
        self.budget = Budget(self.stops.core_share)
        self.counters = {c: Counter.of(self.n, self.budget, len(self.categories)) for c in self.categories}
        self._slack = np.concatenate([self.quantum.q, self.quantum.dq])
        self._common = CommonBox(self._slack)
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
        return max((max(c.took, c.took_wide) for c in self.counters.values()), default=0.0) if self._ready else None

    @property
    def spending(self) -> dict[str, Any]:
        """What the other process has cost, in words of `health`: processor time [s] so far, boxes kept, whether its share is used up, what a
        box costs of late [ms] and how many times as much as it once did: the dearer they are, the farther they reach and the less they say."""
        return {
            "cpu_s": self.budget.total, "share": self.stops.core_share, "share_used_up": self.budget.spent,
            "kept": {c: x.certificates for c, x in self.counters.items()},
            "box_ms": {c: 1e3 * x.cost for c, x in self.counters.items()}, "dearer": {c: x.dearer for c, x in self.counters.items()},
        }  # fmt: skip

    def _start(self) -> None:
        spawned, self.begun = self.begun or Spawned.bounding_stops(), None
        self._process, self._pipe = spawned.process, spawned.pipe
        with contextlib.suppress(OSError):  # it has ended, which its thread is told
            spawned.assign(self.model_path, self.sha256, self.payload, self.stops, self.categories)
        self._ready, self._heard = False, self.clock.monotonic()
        for c in self.counters.values():
            c.waiting = None
        self._inbox = deque()
        # what comes is taken in beside the loop, which then looks at a list and asks no system
        threading.Thread(target=_receive, args=(self._pipe, self._inbox), daemon=True, name="stop-answers").start()

    def offer(self, t: float, q: Array, dq: Array) -> None:
        """The newest state at ``t`` [s]; asks for new bounds where those that are kept do not hold what is coming."""
        self._motion.see(t, q, dq)
        if not self._coming.empty():
            self._come(self._coming.get_nowait())
        if self._inbox:
            self._collect()
        now, period = self.clock.monotonic(), 1.0 / self.stops.rate_hz
        if now >= self._again:
            self._again = float("inf")
            self._begin_again()
        if now - self._heard > HUNG and self._pipe is not None and not (self._ready and self._idle):
            self._heard = now
            self._process.kill()  # which is told by its thread, as any end
        if not self._ready or now - self._looked < period / len(self.counters):
            return
        # one category at a time, so that no cycle has to look for all of them
        self._looked, self._turn = now, (self._turn + 1) % len(self.counters)
        category, c = list(self.counters.items())[self._turn]
        if c.waiting is not None or self._pipe is None:
            return
        self._motion.settle()
        self.budget.at(now)
        self._common.forget()
        wanted = c.lacks(self._motion, self._slack, period)
        if wanted is not None:
            if self._idle:
                self._heard = now
            try:
                self._pipe.send((category, *self._motion.box(*wanted)))
                c.waiting = wanted[1]
            except (OSError, ValueError):
                self._lost()

    @property
    def _idle(self) -> bool:
        return all(c.waiting is None for c in self.counters.values())

    def _collect(self) -> None:
        while self._inbox:
            answer, self._heard = self._inbox.popleft(), self.clock.monotonic()
            if answer is None:
                self._ready = True
            elif isinstance(answer, str):
                self._lost()
            else:
                self.counters[answer.category].take(answer)

    def _lost(self) -> None:
        self.why = "the process that bounds stops has ended; it is started again"
        self.restarts += 1
        if self.restarts >= RESTARTS:
            self._pipe, self._ready, self.why = None, False, "the process that bounds stops keeps ending; no stop provable"
        else:
            self._begin_again()

    def _begin_again(self) -> None:
        """Beside the loop: to begin a process takes some tens of milliseconds."""
        self._pipe, self._ready, self._inbox = None, False, deque()
        try:
            threading.Thread(target=_begin, args=(self._coming,), daemon=True, name="stop-begin").start()
        except RuntimeError as e:
            self._come(e)

    def _come(self, begun: Spawned | Exception) -> None:
        """The process, or why there is none."""
        why = "" if isinstance(begun, Spawned) else f"{type(begun).__name__}: {begun}"
        if isinstance(begun, Spawned):
            self.begun = begun
            try:
                self._start()
            except (OSError, RuntimeError) as e:
                why = str(e)
        if why:  # the machine gives no process, pipe or thread now; perhaps later
            self._pipe, self._ready, self._again = None, False, self.clock.monotonic() + AGAIN
            self.why = f"the process that bounds stops cannot be begun ({why}); no stop provable until it can"

    def now(self, q: Array, dq: Array) -> tuple[dict[str, Numbers], bool]:
        """Bounds by category that hold for this state, and whether all of them were answered for it."""
        if self._common.holds(q, dq):
            return self._numbers, True
        x, fresh = self._common.x, True
        numbers: dict[str, Numbers] = {}
        for category, c in self.counters.items():
            answer = c.holds(x, self._slack)
            if answer is None and c.refused is not None and c.refused.covers(x, self._slack):
                answer = c.refused
            if answer is not None:
                numbers[category] = answer.numbers
                continue
            fresh = False
            asked = c.wide.answers or c.refused or c.long.answers or c.narrow.answers
            numbers[category] = self._nothing((SPENT if self.budget.spent else LEFT) if asked else self.why)
        # the same object as long as nothing changes: who makes a message of it need not do so again
        if len(numbers) != len(self._numbers) or any(numbers[c] is not self._numbers[c] for c in numbers):
            self._numbers = numbers
        used = [c.answer for c in self.counters.values() if c.answer is not None]
        self._common.forget()
        if len(used) == len(numbers):
            self._common.of(used)
        return self._numbers, fresh

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


def _begin(coming: queue.SimpleQueue[Spawned | Exception]) -> None:
    try:
        coming.put(Spawned.bounding_stops())
    except Exception as e:  # noqa: BLE001 - it is said where the process is waited for
        coming.put(e)


def _receive(pipe: Connection, inbox: deque[Certificate | str | None]) -> None:
    try:
        while True:
            inbox.append(pipe.recv())
    except Exception:  # noqa: BLE001 - whatever it was (no memory for an answer, say): a thread that ends without a word is waited for
        inbox.append("ended")
