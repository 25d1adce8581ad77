"""The largest part of its present speed at which the arm, where it is, can stop within wanted limits; all slower parts too.

Found by proofs, in a process of its own: the speeds from rest to the present are cut into stretches, and each is bounded as one
box. The answer is where the first stretch keeps its limits no more. It is advice to whoever sets the speed, seconds old.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any

import numpy as np

from stopset.monitor.certificates import Numbers
from stopset.monitor.config import Masses, StopLimits, Stops
from stopset.monitor.sample import Quantum, Sample
from stopset.monitor.spawned import Spawned, Work
from stopset.types import Array

if TYPE_CHECKING:
    from stopset.monitor.config import Config

STRETCHES = 10
Bound = Callable[[Array, Array], Numbers]  # of a box of states, its least and largest (2n,)


def keeps(numbers: Numbers, limits: StopLimits) -> bool:
    """Whether a proven stop stays within the limits."""
    if not numbers.provable.all():
        return False
    angle = max(float(numbers.forward.max()), float(numbers.back.max()))
    return bool(numbers.time.max() <= limits.time_s and angle <= limits.angle_rad and numbers.tcp <= limits.tcp_m)


def largest_override(bound: Bound, q: Array, dq: Array, slack: Array, limits: StopLimits) -> float:
    """Between 0 and 1: ``bound`` proves every speed from rest to this part of ``dq`` (n,) [rad/s] at ``q`` (n,) [rad], ``slack`` (2n,) either way."""
    for k in range(STRETCHES):
        a, b = k / STRETCHES * dq, (k + 1) / STRETCHES * dq
        lo, hi = np.concatenate([q, np.minimum(a, b)]), np.concatenate([q, np.maximum(a, b)])
        if not keeps(bound(lo - slack, hi + slack), limits):
            return k / STRETCHES
    return 1.0


def _advise(
    model_path: str, sha256: str, payload: Masses | None, stops: Stops, limits: StopLimits, pipe: Connection
) -> None:  # fmt: skip
    """The other process: takes a state, gives its override."""
    from stopset.monitor.stopworker import answer_for, asked, prepare

    prepared, refusal = prepare(model_path, payload, stops, sha256)
    for t, q, dq, slack in asked(pipe):

        def bound(lo: Array, hi: Array) -> Numbers:
            return (
                Numbers.none(len(lo) // 2, refusal) if prepared is None else answer_for(prepared, limits.category, lo, hi).numbers
            )

        with contextlib.suppress(OSError):
            pipe.send((t, largest_override(bound, q, dq, slack, limits)))


def _advice() -> Work:
    return _advise


@dataclass(slots=True)
class Advisor:
    """Asks every ``limits.override_every_s``; ``said``: stamp of the state [s] and the part of its speed, None before the first."""

    config: Config
    sha256: str  # of the model that is watched
    said: tuple[float, float] | None = None
    _pipe: Connection = field(init=False)
    _process: Any = field(init=False)
    _waiting: bool = False
    _next: float = float("-inf")

    def __post_init__(self) -> None:
        c, spawned = self.config, Spawned.begin(_advice, "override")
        self._process, self._pipe = spawned.process, spawned.pipe
        with contextlib.suppress(OSError):  # it has ended: no advice
            spawned.assign(c.model, self.sha256, c.payload_kg, c.stops, c.limits)

    def offer(self, now: float, s: Sample, quantum: Quantum) -> None:
        """The newest reading, at ``now`` [s, monotonic], and what the bus hides of it; takes an answer if there is one. Never waits, never raises."""
        try:
            if self._pipe.poll(0):
                self.said, self._waiting = self._pipe.recv(), False
            if not self._waiting and now >= self._next:
                self._next, self._waiting = now + self.config.limits.override_every_s, True
                self._pipe.send((s.t, s.q, s.dq, np.concatenate([quantum.q, quantum.dq])))
        except (OSError, EOFError):
            self.said = None  # the process is gone: no advice

    def close(self) -> None:
        """End the process."""
        with contextlib.suppress(OSError):
            self._pipe.send(None)
        self._process.join(timeout=1.0)
        if self._process.is_alive():
            self._process.kill()
