"""Readings whose stamps jitter, brought to the even cycles that the model steps in, with what that leaves unknown.

A reading ``off`` seconds behind its cycle either was taken then, and the arm has moved on by as much, or it was taken in time and
stamped late. Nobody can tell, so the state at the cycle is all between: the model's own acceleration bounds how far that is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from stopset.artifact import Model
from stopset.monitor.sample import Sample
from stopset.types import Array

FOLLOWS = 0.02  # part of every stamp's distance by which the cycles follow the sender's clock
REACH = 0.8  # of a cycle a stamp may be off; then it is another cycle's
SETTLE = 25  # stamps from which the cycles' places are found
EVEN = 1e-3  # of a cycle: less is no jitter
FAR = 4.0  # times its scatter: a stamp further from its cycle may be another's
SURE = 6.0  # standard deviations of a place that follows stamps: of an even clock none is further from where it was
STEADY = 0.1  # of a cycle, root mean square: stamps that scatter less are five times as far from being another cycle's


@dataclass(slots=True)
class Cycles:
    """Counts the cycles of stamps that lie about ``period`` [s] apart; ``last``: place of the cycle before [ns], ``seen``: stamps
    that it was found from. Where stamps jitter, the first `SETTLE` only serve to find the cycles' places.

    Of stamps that scatter a lost cycle cannot be told from a stamp far off: what is sent is counted, and a stamp that is not near its cycle
    is left out. Two in a row are a new start. ``left_out``: cycles that were heard since ``last`` and not used, see `leave_out`."""

    period: float
    last: float | None = None
    seen: int = 0
    left_out: int = 0
    scatter: float = 0.0  # of stamps about their places, mean square, in cycles

    def leave_out(self) -> None:
        """A cycle that was sent, and is not used."""
        self.left_out += 1

    def step(self, stamp_ns: int) -> tuple[int, float] | None:
        """How many cycles further a stamp is, 0 if that cannot be told, and how far [s] it lies behind the place of its cycle.

        None for a stamp that is better left out.
        """
        if self.last is None:
            return self._anew(stamp_ns, 1)
        passed = (stamp_ns - self.last) * 1e-9 / self.period
        settling, due = self.seen < SETTLE, 1 + self.left_out
        steady = not settling and self.scatter < STEADY**2
        near = abs(passed - due) <= (REACH if settling else min(REACH, FAR * np.sqrt(self.scatter)))
        whole = due if near and not steady else round(passed)
        if not 1 <= whole <= 1e6:
            return self._anew(stamp_ns, 0)
        if not (near or settling or steady):
            if self.left_out:
                return self._anew(stamp_ns, 0)
            self.leave_out()
            return None
        off = (passed - whole) * self.period
        self.seen, self.left_out = self.seen + 1, 0
        self.scatter += max(1.0 / self.seen, FOLLOWS) * ((passed - whole) ** 2 - self.scatter)
        if abs(off) < EVEN * self.period:
            self.last = float(stamp_ns)
            return whole, 0.0
        self.last += (whole * self.period + (1.0 / self.seen if settling else FOLLOWS) * off) * 1e9
        return (0 if settling else whole), off

    @property
    def place_error(self) -> float:
        """By how much [s] the place of a cycle may be off against those before it: the stamps that it follows scatter."""
        return SURE * math.sqrt(0.5 * FOLLOWS * self.scatter) * self.period

    def _anew(self, stamp_ns: int, whole: int) -> tuple[int, float]:
        self.last, self.seen, self.left_out, self.scatter = float(stamp_ns), 1, 0, 0.0
        return whole, 0.0


@dataclass(frozen=True, slots=True)
class GridMotion:
    """What a linear model knows of the motion between two samples: drag (n, n), gain (n, n), and the torque set."""

    drag: Array
    gain: Array
    middle: Array
    half: Array
    period: float

    @classmethod
    def of(cls, model: Model) -> GridMotion:
        A, n, sets = model.abstraction.A, model.n, model.powered
        return cls(A[n:, n:], model.abstraction.Minv, sets.U.centre, sets.U.radius, sets.dt)

    def onto_grid(self, s: Sample, u: Array, before: Array) -> tuple[Array, Array, Array]:
        """The state (2n,) at the cycle, by how much it may be wrong (2n,), and the same of the input (n,) [N m].

        ``u, before``: inputs of this sample and the one before, between which the torque was meanwhile.
        """
        q, dq, off, change = s.q, s.dq, s.off, np.abs(u - before)
        e = abs(off) + s.place_error
        a = self.drag @ dq + self.gain @ (0.5 * (u + before) + self.middle)
        spread = np.abs(self.gain) @ (self.half + 0.5 * change)
        spread = spread + e * np.abs(self.drag) @ (np.abs(a) + spread)  # and the drag changes on the way
        x = np.concatenate([q - 0.5 * off * dq, dq - 0.5 * off * a])
        away = 0.5 * abs(off) + s.place_error  # at most, from the middle
        angle = away * np.abs(dq) + 0.5 * e * e * (np.abs(a) + spread)
        speed = away * np.abs(a) + e * spread
        return x, np.concatenate([angle, speed]), change * min(1.0, e / self.period)
