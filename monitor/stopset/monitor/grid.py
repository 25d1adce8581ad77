"""Readings whose stamps jitter, brought to the even cycles that the model steps in, with what that leaves unknown.

A reading ``off`` seconds behind its cycle either was taken then, and the arm has moved on by as much, or it was taken in time and
stamped late. Nobody can tell, so the state at the cycle is all between: the model's own acceleration bounds how far that is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stopset.artifact import Model
from stopset.types import Array

FOLLOWS = 0.02  # part of every stamp's distance by which the cycles follow the sender's clock
REACH = 0.8  # of a cycle a stamp may be off; then it is another cycle's
SETTLE = 25  # stamps from which the cycles' places are found
EVEN = 1e-3  # of a cycle: less is no jitter


@dataclass(slots=True)
class Cycles:
    """Counts the cycles of stamps that lie about ``period`` [s] apart; ``last``: place of the cycle before [ns], ``seen``: stamps
    that it was found from. Where stamps jitter, the first `SETTLE` only serve to find the cycles' places."""

    period: float
    last: float | None = None
    seen: int = 0

    def step(self, stamp_ns: int) -> tuple[int, float]:
        """How many cycles further a stamp is, 0 if that cannot be told, and how far [s] it lies behind the place of its cycle."""
        if self.last is None:
            self.last, self.seen = float(stamp_ns), 1
            return 1, 0.0
        passed = (stamp_ns - self.last) * 1e-9 / self.period
        whole = 1 if abs(passed - 1.0) <= REACH else round(passed)
        if not 1 <= whole <= 1e6:
            self.last, self.seen = float(stamp_ns), 1
            return 0, 0.0
        off = (passed - whole) * self.period
        self.seen += 1
        if abs(off) < EVEN * self.period:
            self.last = float(stamp_ns)
            return whole, 0.0
        settling = self.seen <= SETTLE
        self.last += (whole * self.period + (1.0 / self.seen if settling else FOLLOWS) * off) * 1e9
        return (0 if settling else whole), off


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

    def onto_grid(self, q: Array, dq: Array, u: Array, before: Array, off: float) -> tuple[Array, Array, Array]:
        """The state (2n,) at the cycle, by how much it may be wrong (2n,), and the same of the input (n,) [N m].

        ``u, before``: inputs of this sample and the one before, between which the torque was meanwhile.
        """
        e, change = abs(off), np.abs(u - before)
        a = self.drag @ dq + self.gain @ (0.5 * (u + before) + self.middle)
        spread = np.abs(self.gain) @ (self.half + 0.5 * change)
        spread = spread + e * np.abs(self.drag) @ (np.abs(a) + spread)  # and the drag changes on the way
        x = np.concatenate([q - 0.5 * off * dq, dq - 0.5 * off * a])
        angle = (0.5 + FOLLOWS) * e * np.abs(dq) + 0.5 * e * e * (np.abs(a) + spread)
        speed = (0.5 + FOLLOWS) * e * np.abs(a) + e * spread
        return x, np.concatenate([angle, speed]), change * min(1.0, e / self.period)
