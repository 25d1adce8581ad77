"""How trials are handed on: never all at once, and anew at every call."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import fields

import numpy as np

from stopset.recording import Recording
from stopset.types import Array

Source = Callable[[], Iterable[Recording]]
Pairs = Callable[[], Iterable[tuple[int, Recording, Array]]]  # (independent motion, trial on the grid, its input u)

MOST = 2**27  # bytes of trials that are remembered: ten minutes of six joints at 1 kHz; what is longer is read again each time


class ReadOnce:
    """Trials of ``source``, in memory from the first whole pass on, where they take no more than `MOST` bytes together."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self._whole: tuple[Recording, ...] | None = None

    def __call__(self) -> Iterable[Recording]:
        return self._read() if self._whole is None else self._whole

    def _read(self) -> Iterator[Recording]:
        read, left = list[Recording](), MOST
        for r in self._source():
            left -= size(r)
            if left >= 0:
                read.append(r)
            else:
                read.clear()
            yield r
        if left >= 0:
            self._whole = tuple(read)

    def __reduce__(self) -> tuple[type[ReadOnce], tuple[Source]]:
        return ReadOnce, (self._source,)  # another process reads for itself


def size(r: Recording) -> int:
    """Bytes of a trial's signals."""
    return sum(x.nbytes for f in fields(r) if isinstance(x := getattr(r, f.name), np.ndarray))
