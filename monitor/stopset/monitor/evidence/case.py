"""Readings around a contradiction, and the model that contradicts them: what every kind of cause is asked with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from stopset.monitor.evidence.cause import UNCLASSED, Cause, Kind
from stopset.monitor.evidence.dynamics import Dynamics, Readings
from stopset.monitor.evidence.trace import Window

AHEAD, AFTER = 0.2, 0.6  # [s] of readings around the first contradiction, without a gap, that tell delays and pushes apart
BACK = 10  # rows before the first contradiction in which its cause is looked for


@dataclass(frozen=True, slots=True)
class Case:
    """Rows without a gap, the row ``at`` that was contradicted first, and the ``joint`` and ``signal`` it showed in."""

    w: Window
    at: int
    joint: int
    signal: str
    model: Dynamics
    readings: Readings
    pause: Callable[[], None]

    def holds(self, changed: Readings) -> bool:
        self.pause()
        return self.model.contradiction(changed) <= 0.0

    @property
    def unit(self) -> str:
        return "rad" if self.signal == "q" else "rad/s"

    def cause(self, kind: Kind, says: str, joint: int | None, row: int, **more: object) -> Cause:
        name = "" if joint is None else self.model.joints[joint]
        return Cause(kind, says, name, t=float(self.w.t[row]), **more)  # type: ignore[arg-type]

    def untold(self, row: int, what: str) -> Cause:
        """Over so short a time one kind looks like another."""
        ahead, after = self.at * self.model.dt, (len(self.w) - self.at) * self.model.dt
        says = f"readings without a gap: {ahead:.2f} s before and {after:.2f} s after it; {AHEAD:g} and {AFTER:g} s are needed {what}"
        return replace(UNCLASSED, t=float(self.w.t[row]), says=says)
