"""When a frame was on the wire, by this machine's clock, from what its adapter stamps it with."""

from __future__ import annotations

import math
from dataclasses import dataclass

NEAR = 60.0  # [s] a first stamp farther than this from now is of another clock
LEAK = 1e-3  # what two clocks may part by per second


@dataclass(slots=True)
class Stamps:
    """Times of frames [s since the epoch]. Which clock stamps them is decided at the first one: later, a stamp far from now is
    old data and not another clock.

    Another clock's stamps are shifted by the least delay seen, so that no frame looks younger than it is but for the drift.
    A stamp that is not a number makes the frame as old as can be.
    """

    foreign: bool | None = None
    _shift: float = math.inf
    _before: float = 0.0

    def __call__(self, t: float, now: float) -> float:
        if not math.isfinite(t):
            return 0.0
        if self.foreign is None:
            self.foreign, self._before = abs(t - now) > NEAR, now
        if not self.foreign:
            return t
        self._shift = min(self._shift + LEAK * max(0.0, now - self._before), now - t)
        self._before = now
        return t + self._shift
