"""Divide a campaign into ranges of trials, work on them side by side, and merge in campaign order: a map-reduce.

Maxima, minima and per-trial sums merged in order give the same bits whatever the number of parts.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Protocol, Self, TypeVar

from stopset.offline.survey import Source
from stopset.recording import Recording

Range = tuple[int, int]  # trials by place in the campaign: first, one past the last
FEWEST = 64  # trials per part; below, dividing costs more than it saves


class Mergeable(Protocol):
    """What a part leaves: it can take in what a later part left."""

    def merge(self, other: Self, /) -> Self: ...


A = TypeVar("A", bound=Mergeable)
B = TypeVar("B", bound=Mergeable)


def within(source: Source, trials: Range) -> Source:
    """The trials of ``source`` in a range of places."""

    def some() -> Iterator[Recording]:
        for r in source():
            if r.place >= trials[1]:
                return
            if r.place >= trials[0]:
                yield r

    return some


def ranges(trials: int, parts: int) -> list[Range]:
    """``parts`` consecutive ranges that cover ``trials``."""
    edges = [round(k * trials / parts) for k in range(parts + 1)]
    return [(a, b) for a, b in zip(edges[:-1], edges[1:], strict=True) if b > a]


def in_parts(work: Callable[[Range], tuple[A, B]], trials: int) -> tuple[A, B]:
    """``work`` on every part in threads (the heavy kernels release the interpreter), merged in order."""
    parts = max(1, min(os.cpu_count() or 1, trials // FEWEST, 4))
    with ThreadPoolExecutor(parts) as pool:
        results = list(pool.map(work, ranges(trials, parts)))
    a, b = results[0]
    for more_a, more_b in results[1:]:
        a, b = a.merge(more_a), b.merge(more_b)
    return a, b
