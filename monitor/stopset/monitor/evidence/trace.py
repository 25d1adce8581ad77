"""The last seconds, cycle by cycle, in arrays that are written round and round: nothing is made in the loop, nothing refers to it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from stopset.monitor.sample import Sample
from stopset.monitor.verdict import Verdict
from stopset.types import Array

ROOM = 4096  # cycles kept at most, which is 16 s at 250 Hz


@dataclass(frozen=True, slots=True)
class Window:
    """Consecutive rows of a `Trace`, oldest first: cycle numbers ``k`` (N,), stamps ``t`` (N,) [s], readings (N, n) in SI, the
    model's input ``u`` and how far it is unknown ``du`` (N, n) [N m], ``room`` (N, 2n) as in `Verdict`, and codes (N,) of the
    verdict and the published state. What was not there is NaN."""

    k: NDArray[np.int64]
    t: Array
    q: Array
    dq: Array
    tau: Array
    temp: Array
    u: Array
    du: Array
    room: Array
    conformance: NDArray[np.uint8]
    state: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.k)

    def part(self, lo: int, hi: int) -> Window:
        """Rows ``lo`` to ``hi``, the last not included."""
        return Window(*(getattr(self, name)[lo:hi] for name in self.__slots__))

    def run(self, at: int) -> tuple[int, int]:
        """The rows around row ``at`` without a lost cycle, a missing input or an unpowered drive between them."""
        whole = (np.diff(self.k) == 1) & np.isfinite(self.u[:-1]).all(axis=1)
        breaks = np.flatnonzero(~whole)
        lo = int(breaks[breaks < at].max(initial=-1)) + 1
        hi = int(breaks[breaks >= at].min(initial=len(self.k) - 1)) + 1
        return lo, hi


@dataclass(slots=True)
class Trace:
    """Ring of the last `Window` rows of ``n`` joints. ``head``: rows taken since the start; the writer is the loop, alone."""

    n: int
    capacity: int = ROOM
    head: int = 0
    _rows: Window = field(init=False)

    def __post_init__(self) -> None:
        def table(width: int) -> Array:
            return np.full((self.capacity, width), np.nan)

        n, size = self.n, self.capacity
        q, dq, tau, temp, u, du = (table(n) for _ in range(6))
        codes = np.zeros(size, np.uint8), np.zeros(size, np.uint8)
        self._rows = Window(np.zeros(size, np.int64), np.full(size, np.nan), q, dq, tau, temp, u, du, table(2 * n), *codes)

    def take(self, s: Sample, v: Verdict, code: int, inputs: tuple[Array, Array] | None) -> None:
        """A sample, what was said of it and its ``inputs`` u, du; `state` adds what was published."""
        i, rows = self.head % self.capacity, self._rows
        rows.k[i], rows.t[i], rows.conformance[i] = s.k, s.t, code
        rows.q[i], rows.dq[i] = s.q, s.dq
        rows.tau[i] = np.nan if s.tau is None else s.tau
        rows.temp[i] = np.nan if s.temp is None else s.temp
        rows.u[i], rows.du[i] = (np.nan, np.nan) if inputs is None else inputs
        rows.room[i] = np.nan if v.room is None else v.room
        rows.state[i] = 0
        self.head += 1

    def state(self, code: int) -> None:
        """What was published for the sample taken last."""
        self._rows.state[(self.head - 1) % self.capacity] = code

    def window(self, first: int, last: int) -> Window:
        """Rows number ``first`` to ``last`` (not included) as far as they are still there, copied."""
        head = self.head
        first, last = max(first, head - self.capacity + 1, 0), min(last, head)
        at = np.arange(first, max(first, last)) % self.capacity
        return Window(*(getattr(self._rows, name)[at] for name in self._rows.__slots__))
