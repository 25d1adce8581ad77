"""Divide a campaign into ranges of trials, work on them side by side, and merge in campaign order: a map-reduce.

Maxima, minima and per-trial sums merged in order give the same bits whatever the number of parts.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import pairwise
from threading import Lock
from typing import Any, Protocol, Self, TypeVar

from stopset.errors import StopsetError
from stopset.offline.campaign.trials import Source
from stopset.progress import Progress, silent
from stopset.recording import Recording

Range = tuple[int, int]  # trials by place in the campaign: first, one past the last
PER_WORKER = 3  # parts per worker of a cluster, so that a lost one costs little
CONNECT = 10  # [s] to reach a scheduler
FEWEST = 64  # trials per part; below, dividing costs more than it saves


class Mergeable(Protocol):
    """What a part leaves: it can take in what a later part left."""

    def merge(self, other: Self, /) -> Self: ...


A = TypeVar("A", bound=Mergeable)
B = TypeVar("B", bound=Mergeable)


class TrialCounter:
    """Reports every tenth of the trials as they are done, by however many threads."""

    def __init__(self, trials: int, progress: Progress) -> None:
        self._trials, self.progress, self._done = max(trials, 1), progress, 0
        self._lock = Lock()

    def step(self) -> None:
        """One trial more is done."""
        with self._lock:
            before, self._done = self._done, self._done + 1
            if 10 * self._done // self._trials > 10 * before // self._trials:
                self.progress(f"{self._done} of {self._trials} trials", min(1.0, self._done / self._trials))


def passing(source: Source, trials: int, passes: int, doing: str, progress: Progress) -> Source:
    """``source`` of so many trials, which is read about so many times: after each trial it is told how far that is."""
    done = 0

    def counted() -> Iterator[Recording]:
        nonlocal done
        for r in source():
            yield r
            done += 1
            progress(doing, min(1.0, done / (trials * passes)))

    return counted


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
    return [(a, b) for a, b in pairwise(edges) if b > a]


def in_parts(
    work: Callable[[Range], tuple[A, B]], trials: int, scheduler: str | None = None, progress: Progress = silent
) -> tuple[A, B]:
    """``work`` on every part, merged in order: in threads (the heavy kernels release the interpreter), or on a Dask cluster.

    ``scheduler``: address of a running Dask scheduler whose workers can read the same files; a part whose worker dies is
    given to another one; ``progress`` is given the cluster's parts as they come in.

    Raises `StopsetError` if there is no such scheduler or no worker left.
    """
    if scheduler is not None:
        results = _on_cluster(work, trials, scheduler, progress)
    else:
        parts = max(1, min(os.cpu_count() or 1, trials // FEWEST, 4))
        with ThreadPoolExecutor(parts) as pool:
            results = list(pool.map(work, ranges(trials, parts)))
    a, b = results[0]
    for more_a, more_b in results[1:]:
        a, b = a.merge(more_a), b.merge(more_b)
    return a, b


@contextmanager
def connected(scheduler: str) -> Iterator[Any]:
    """A client of a running Dask cluster. Raises `StopsetError` where none answers, or none works."""
    from distributed import Client

    try:
        client = Client(scheduler, timeout=CONNECT, set_as_default=False)
    except (OSError, ValueError) as e:
        raise StopsetError(
            f"no Dask scheduler answers at {scheduler} ({type(e).__name__}); start one and name its address"
        ) from e
    with client:
        if not client.scheduler_info(n_workers=-1)["workers"]:
            raise StopsetError(
                f"the Dask scheduler at {scheduler} has no worker; start at least one that can read the recordings"
            )
        yield client


def _on_cluster(work: Callable[[Range], tuple[A, B]], trials: int, scheduler: str, progress: Progress) -> list[tuple[A, B]]:
    from distributed import as_completed

    with connected(scheduler) as client:
        workers = len(client.scheduler_info(n_workers=-1)["workers"])
        jobs = client.map(work, ranges(trials, max(workers, min(workers * PER_WORKER, trials // FEWEST))), pure=False)
        for done, _ in enumerate(as_completed(jobs, loop=client.loop), 1):
            progress(f"{done} of {len(jobs)} parts of the campaign from {workers} workers", done / len(jobs))
        return list(client.gather(jobs))
