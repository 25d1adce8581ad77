"""The loop's own timing, in memory that does not grow."""

from __future__ import annotations

from array import array

MOST = 4096  # of one window; a health message ends it, at 1 kHz after some 1000


class Durations:
    """Durations [s] since the last `clear`, the latest `MOST` of them."""

    __slots__ = ("_count", "_seconds")

    def __init__(self) -> None:
        self._seconds, self._count = array("d", bytes(8 * MOST)), 0

    def add(self, seconds: float) -> None:
        self._seconds[self._count % MOST] = seconds
        self._count += 1

    def __len__(self) -> int:
        return min(self._count, MOST)

    def middle_and_most(self) -> dict[str, float]:
        """[ms]; not by numpy's median, which imports a module when it is first asked, in the loop."""
        ordered = sorted(self._seconds[: len(self)]) or [0.0]
        return {"median": 1e3 * 0.5 * (ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2]), "max": 1e3 * ordered[-1]}

    def clear(self) -> None:
        self._count = 0
