"""Independent work in as many threads as there are cores, which is worth it where the core or sums over all rows are most of it."""

from __future__ import annotations

import os
from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from threading import Lock
from typing import Generic, TypeVar

A = TypeVar("A")
B = TypeVar("B")


def side_by_side(work: Callable[[A], B], items: Sequence[A]) -> list[B]:
    """``work`` on each of ``items``, in their order."""
    if len(items) < 2:
        return list(map(work, items))
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(work, items))


@dataclass(slots=True)
class Recent(Generic[A]):
    """The ``most`` things that were made last, each by its key, for all threads."""

    most: int
    _made: dict[Hashable, A] = field(default_factory=dict)
    _lock: Lock = field(default_factory=Lock)

    def of(self, key: Hashable, make: Callable[[], A]) -> A:
        """What belongs to a key; made where it is not there any more."""
        with self._lock:
            if key in self._made:
                return self._made[key]
        made = make()  # by two threads at once where both ask: it is the same
        with self._lock:
            self._made[key] = made
            while len(self._made) > self.most:
                del self._made[next(iter(self._made))]
        return made

    def clear(self) -> None:
        """Nothing is kept."""
        with self._lock:
            self._made.clear()
