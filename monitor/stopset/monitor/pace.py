"""How fast samples come, held against the step that the model was identified at: a model of steps of 10 ms says nothing of others.

Numbers of cycles do not show it: a counter counts whatever the cycle is, and stamps that lie 5 % too far apart look like lost ones.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field

import numpy as np

from stopset.monitor.rhythm import HOP, SPECTRA, STAMPS, Rhythm
from stopset.types import Array

LEAST, MOST = 32, 128  # intervals that the pace is found from
LONG, LOOK = 2048, HOP  # and where stamps scatter too much for so few: so many, looked at once in so many samples
ANOTHER = 0.02  # of the period: farther off is no clock's error but another cycle
SURE = 4.0  # standard errors of the middle interval, where stamps scatter
NOT_YET = f"whether samples come at the model's steps is told from {LEAST} intervals; they have not come yet"
ERROR = (
    1.2533 * 1.4826
)  # of the middle of N intervals, in their middle deviation over the root of N, were they normally distributed


@dataclass(slots=True)
class Pace:
    """Takes the stamp of every sample; ``why``: words for a pace that is not ``period`` [s], empty as long as nothing speaks against it."""

    period: float
    why: str = ""
    _was_good: bool = False  # when it was looked at last
    _stamps: array[float] = field(
        default_factory=lambda: array("d", bytes(8 * (LONG + 1)))
    )  # a ring; it takes no memory while it runs
    _taken: int = 0
    _long_why: str = ""
    _looks: int = 0
    _looked: int = 0  # samples, when it was looked at last
    _rhythm: Rhythm = field(init=False)

    def __post_init__(self) -> None:
        self._rhythm = Rhythm(self.period, ANOTHER)

    @property
    def fault(self) -> str:
        """``why``, and before enough samples have come to tell, that."""
        return NOT_YET if self._taken <= LEAST else self.why

    def take(self, t: float) -> None:
        """A sample stamped ``t`` [s]."""
        stamps, last = self._stamps, self._taken % len(self._stamps)
        stamps[last] = t
        self._taken += 1
        intervals = min(self._taken - 1, MOST)
        if intervals < LEAST:
            return
        # a good bus has the right mean, which is found in no time; so may one of another cycle that has just made up for a pause
        mean = (t - stamps[last - intervals]) / intervals
        if not (self._was_good and abs(mean - self.period) <= ANOTHER * self.period):
            self.why = self._looked_at()
            self._was_good = not self.why

    def _looked_at(self) -> str:
        """By the last intervals, which are soon others; by many, whose middle is surer; and by the line in the spectrum of their
        stamps, where both are not sure: any may see another cycle."""
        if self._taken - self._looked > SPECTRA * HOP:  # what was seen then is of another time
            self._rhythm.forget()
        if self._looks % LOOK == 0:
            self._long_why = self._said(self._latest(LONG + 1)) or self._of_line(self._latest(STAMPS))
        self._looks, self._looked = self._looks + 1, self._taken
        return self._said(self._latest(MOST + 1)) or self._long_why

    def _latest(self, most: int) -> Array:
        """The stamps that came last, the newest at the end."""
        ring: Array = np.frombuffer(self._stamps)
        newest, count = self._taken % len(ring), min(most, self._taken)
        return ring[newest - count : newest] if count <= newest else np.concatenate((ring[newest - count :], ring[:newest]))

    def _of_line(self, stamps: Array) -> str:
        if len(stamps) < STAMPS:
            return ""
        self._rhythm.take(stamps)
        seen = self._rhythm.other()
        return self._words(seen) if seen else ""

    def _said(self, stamps: Array) -> str:
        """By the middle interval, which lost samples and those held up do not move."""
        intervals: Array = np.diff(stamps)
        near = _middle(intervals)
        close = intervals[np.abs(intervals - near) <= 0.5 * near]
        intervals = close if len(close) else np.array([near])
        seen = _middle(intervals)
        scatter = _middle(np.abs(intervals - seen))
        if abs(seen - self.period) <= max(ANOTHER * self.period, SURE * ERROR * scatter / len(intervals) ** 0.5):
            return ""
        return self._words(seen)

    def _words(self, seen: float) -> str:
        return (
            f"samples come every {seen * 1e3:.3g} ms, the model was identified at steps of {self.period * 1e3:.3g} ms; set the sender's cycle "
            "to that, or identify from recordings taken at the sender's"
        )


def _middle(x: Array) -> float:
    middle = len(x) // 2
    return float(np.partition(x, middle)[middle])
