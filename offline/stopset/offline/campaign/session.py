"""How long the drives have been running: the variable of warming where no temperature is recorded."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Self

from stopset.recording import Recording, SuiteKey
from stopset.recording.repetition import POWERED

REPEATED = 6  # repetitions of one suite from which on the repetition, not the place in the session, is the time of warming


@dataclass(frozen=True, slots=True)
class Session:
    """What `warm` is counted in: ``repeats``, the most trials of one suite, and ``places``, trials of the whole campaign."""

    repeats: int
    places: int

    @classmethod
    def of(cls, trials: Iterable[Recording]) -> Self:
        """That of ``trials``; suites are looked at in the best powered phase there is."""
        counts: dict[str, Counter[SuiteKey]] = {p: Counter() for p in POWERED}
        places = 0
        for r in trials:
            places = max(places, r.place + 1)
            if r.phase in counts:
                counts[r.phase][r.suite_key] += 1
        best = next((c for c in counts.values() if c), Counter())
        return cls(max(best.values(), default=0), places)

    def warm(self, r: Recording) -> float:
        """0 at the first trial to 1: the repetition within a suite where suites are repeated (each starts anew), else the
        place in the session."""
        if self.repeats >= REPEATED:
            return min(r.repetition / (self.repeats - 1), 1.0)
        return min(r.place / max(self.places - 1, 1), 1.0)
