"""Stop bounds beside the loop: another process certifies them for a box around the state, the loop checks it is inside.

A bound takes milliseconds, a cycle has not that many. So each answer covers every state of a box wide enough for the motion
until the next answer; a state that has left the box has no bound until a new one comes.
"""

from __future__ import annotations

import contextlib
import multiprocessing as mp
import os
import time
from collections import deque
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from stopset.artifact import load_model
from stopset.errors import ModelFileError, StopsetError
from stopset.monitor.clock import Clock, SystemClock
from stopset.monitor.config import Stops
from stopset.monitor.watch import Quantum

if TYPE_CHECKING:  # its compiled code is for the other process
    from stopset.reach.stops import StopBounds

Array = NDArray[np.float64]
EXPANDED = {"0": ("0",), "1": ("1", "1 guaranteed"), "2": ("2",)}
LOOK_BACK = 0.04  # [s] over which the acceleration is taken from the speeds
SPARE_SPEED = 0.04  # [rad/s] noise of a measured speed and of the acceleration made from it; too little costs answers, not truth
SPARE_ANGLE = 5e-4  # [rad]
LONGEST = 0.1  # [s] motion covered ahead beyond one period; a slower answer finds the arm outside its box


@dataclass(frozen=True, slots=True)
class Numbers:
    """One category's bound: per joint (n,) time [s], forward and back [rad], and the flange's travel [m]; inf = not provable."""

    time: Array
    forward: Array
    back: Array
    tcp: float
    provable: NDArray[np.bool_]
    why: str = ""
    margin: float = float("-inf")  # least holding margin [N m]

    @classmethod
    def none(cls, n: int, why: str, margin: float = float("-inf")) -> Numbers:
        inf = np.full(n, np.inf)
        return cls(inf, inf, inf, float("inf"), np.zeros(n, bool), why, margin)

    @classmethod
    def fallback(cls, n: int, time: float, angle: float, tcp: float, why: str) -> Numbers:
        a = np.full(n, angle)
        return cls(np.full(n, time), a, a, tcp, np.zeros(n, bool), why)


@dataclass(frozen=True, slots=True)
class Answer:
    """Bounds that hold for every state with ``|q - q_mid| <= q_radius`` and ``|dq - dq_mid| <= dq_radius``."""

    q_mid: Array
    dq_mid: Array
    q_radius: Array
    dq_radius: Array
    numbers: dict[str, Numbers]
    took: float

    def covers(self, q: Array, dq: Array, quantum: Quantum) -> bool:
        """Whether a reading lies inside with everything that bus rounding may have hidden; the noise ``V`` is in the bound."""
        near = np.abs(q - self.q_mid) + quantum.q <= self.q_radius
        return bool(near.all() and np.all(np.abs(dq - self.dq_mid) + quantum.dq <= self.dq_radius))


def _numbers(bound: Any, n: int) -> Numbers:
    margin = -np.inf if bound.holding_margin is None else float(np.min(bound.holding_margin))
    if not bound.certified or bound.time is None or bound.forward is None or bound.back is None:
        return Numbers.none(n, bound.why, margin)
    tcp = np.inf if bound.tcp is None else float(bound.tcp)
    return Numbers(bound.time, bound.forward, bound.back, tcp, np.ones(n, bool), bound.why, margin)


def _work(
    model_path: str, sha256: str, payload: float, stops: Stops, categories: tuple[str, ...], pipe: Connection
) -> None:  # fmt: skip
    """The other process: takes the newest state, answers for a box around it; of the very model (``sha256``) that is watched."""
    from stopset.reach.stops import StopBounds
    from stopset.reach.stops.ramp import Ramp

    parent = os.getppid()
    model = load_model(model_path)
    n = model.n
    ramp = None
    if stops.ramp_time_s or stops.ramp_deceleration:
        ramp = Ramp.stated(
            n, time=stops.ramp_time_s or None, deceleration=stops.ramp_deceleration or None, control=stops.ramp_control_s,
            off_after=stops.ramp_off_after_s or None, monitored=stops.ramp_monitored,
        )  # fmt: skip
    prepared, refusal = None, ""
    try:
        if sha256 and model.sha256 != sha256:
            raise ModelFileError(
                f"{model_path} is another model now (SHA-256 {model.sha256[:16]}...) than the one that is watched ({sha256[:16]}...); "
                "have the monitor read it anew (SIGHUP), or restore it"
            )
        prepared = StopBounds.of(model, (payload, payload) if payload else None, ramp=ramp, fast=True)
    except StopsetError as e:  # a payload that the model does not cover, say: the consumers must hear it from every message
        refusal = str(e)
    if prepared is not None and prepared.setting is not None:  # load the compiled code before anybody waits for it
        for category in categories:
            prepared.bound(np.clip(np.zeros(n), *model.robot.q_limit.T), np.full(n, 0.1), cast(Any, category))
    pipe.send(None)
    while True:
        while not pipe.poll(0.5):
            if os.getppid() != parent:
                return  # the daemon is gone
        request = pipe.recv()
        while pipe.poll(0):
            request = pipe.recv()
        if request is None:
            return
        q, dq, q_radius, dq_radius = request
        if prepared is None:
            pipe.send(Answer(q, dq, q_radius, dq_radius, {c: Numbers.none(n, refusal) for c in categories}, 0.0))
        else:
            pipe.send(answer_for(prepared, categories, q, dq, q_radius, dq_radius))


def answer_for(
    prepared: StopBounds, categories: tuple[str, ...], q: Array, dq: Array, q_radius: Array, dq_radius: Array
) -> Answer:
    """Bounds for every measured state no farther from ``q``, ``dq`` than these (n,) radii."""
    begin = time.monotonic()
    n, numbers = len(q), {}
    for category in categories:
        try:
            numbers[category] = _numbers(prepared.bound(q, dq, cast(Any, category), q_radius, dq_radius), n)
        except StopsetError as e:
            numbers[category] = Numbers.none(n, str(e))
    return Answer(q, dq, q_radius, dq_radius, numbers, time.monotonic() - begin)


@dataclass(slots=True)
class StopDesk:
    """Asks for bounds, keeps the last answer, says what holds for the state now."""

    model_path: str
    n: int
    stops: Stops
    payload: float
    quantum: Quantum
    answer: Answer | None = None
    why: str = "the first stop bound is being computed"
    restarts: int = 0
    clock: Clock = field(default_factory=SystemClock)
    sha256: str = ""  # of the model that is watched; the file may be another one by now
    _pipe: Connection | None = None
    _process: Any = None
    _asked: float = float("-inf")
    _waiting: bool = False
    _past: deque[tuple[float, Array]] = field(default_factory=lambda: deque(maxlen=64))

    def __post_init__(self) -> None:
        self._start()

    @property
    def categories(self) -> tuple[str, ...]:
        """What is asked for, STOP 1 with and without a working ramp."""
        return tuple(e for c in self.stops.categories for e in EXPANDED[c])

    def _start(self) -> None:
        context = mp.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        args = (self.model_path, self.sha256, self.payload, self.stops, self.categories, theirs)
        self._process = context.Process(target=_work, args=args, daemon=True, name="stop-bounds")
        self._process.start()
        theirs.close()
        self._waiting = True  # for its word that it is ready

    def offer(self, t: float, q: Array, dq: Array) -> None:
        """The newest state at ``t`` [s]; asks for a new bound when the last one is there and it is time."""
        self._past.append((t, dq))
        while len(self._past) > 2 and t - self._past[0][0] > LOOK_BACK:
            self._past.popleft()
        self._collect()
        now = self.clock.monotonic()
        if self._waiting or now - self._asked < 1.0 / self.stops.rate_hz or self._pipe is None:
            return
        took = min(self.answer.took if self.answer else 0.01, LONGEST)
        ahead = 1.2 / self.stops.rate_hz + 2.0 * took
        before, was = self._past[0]
        a = (dq - was) / (t - before) if 0.0 < t - before < 2 * LOOK_BACK else np.zeros(self.n)
        # the middle of the box is where the arm is half way to the next answer
        dq_mid = dq + 0.5 * ahead * a
        dq_radius = 0.65 * ahead * np.abs(a) + SPARE_SPEED
        q_mid = q + 0.5 * ahead * dq_mid
        q_radius = 0.55 * ahead * np.abs(dq_mid) + 0.5 * ahead * dq_radius + SPARE_ANGLE
        try:
            self._pipe.send((q_mid, dq_mid, q_radius, dq_radius))
            self._asked, self._waiting = now, True
        except (OSError, ValueError):
            self._lost()

    def _collect(self) -> None:
        try:
            while self._pipe is not None and self._pipe.poll(0):
                self.answer = self._pipe.recv() or self.answer
                self._waiting = False
        except (EOFError, OSError):
            self._lost()

    def _lost(self) -> None:
        self.answer, self.why = None, "the process that bounds stops has ended; it is started again"
        self.restarts += 1
        if self.restarts < 5:
            self._start()
        else:
            self._pipe, self.why = None, "the process that bounds stops keeps ending; no stop provable"

    def now(self, q: Array, dq: Array) -> tuple[dict[str, Numbers], bool]:
        """Bounds by category that hold for this state, and whether they are fresh."""
        names = self.categories
        if self.answer is None:
            return {c: Numbers.none(self.n, self.why) for c in names}, False
        if not self.answer.covers(q, dq, self.quantum):
            why = "the arm has left the states the last bound was computed for"
            return {c: Numbers.none(self.n, why) for c in names}, False
        return self.answer.numbers, True

    def close(self) -> None:
        """End the other process."""
        if self._pipe is not None:
            with contextlib.suppress(OSError, ValueError):
                self._pipe.send(None)
        if self._process is not None:
            self._process.join(timeout=0.2)
            if self._process.is_alive():
                self._process.kill()
