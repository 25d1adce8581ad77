"""Where the arm goes next, from its last readings: boxes of states that bounds are asked for."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from stopset.sets import Box
from stopset.types import Array

LOOK_BACK = 0.04  # [s] over which the acceleration is taken from the speeds
START = 0.25  # [s] from rest to the largest speed identification has seen
MEMORY = 2.0  # [s] in which the largest acceleration seen is forgotten to a third
SPARE_SPEED = 0.04  # [rad/s] noise of a measured speed and of the acceleration made from it; too little costs answers, not truth
SPARE_ANGLE = 5e-4  # [rad]
PATH = np.linspace(0.0, 1.0, 5)[:, None]  # instants at which the motion ahead is looked at, as parts of it


@dataclass(frozen=True, slots=True)
class Size:
    """A box that covers the motion ``ahead`` [s] of its answer, at accelerations off the present one by ``swerve`` times the
    largest seen of late; ``starts``: also if the arm, still as it may be, starts with all it has."""

    ahead: float
    swerve: float
    starts: bool


# as found on recorded arms: the wide one holds nearly every motion, narrow ones give numbers that hardly widen; how far a long one
# reaches is a matter of what it costs
WIDE, LONG, NARROW = Size(0.2, 1.0, starts=True), Size(0.2, 0.1, starts=False), Size(0.04, 0.2, starts=False)


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
        disjoint = inner_lo > inner_hi  # the arm is where it never was: what then is answered says so
        return np.where(disjoint, lo, inner_lo), np.where(disjoint, hi, inner_hi)
