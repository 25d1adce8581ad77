"""Predictions of nonlinear models that go on sample by sample: the corners of decoupled joints, nominal motions of the others.

Which there are, and which of them a sample is held against, is the core's (``predictions_along.c``), as in an FMU.  Their bounds
are those of `stopset.reach.nonlinear.predicted_tube`, which identification and comparison use (trap P18), wider by what the bus
rounds and what is not known of the input.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stopset.artifact import Model
from stopset.core.library import ffi, flags, given, integers, lib, view
from stopset.monitor.sample import Quantum
from stopset.reach.nonlinear import dynamics
from stopset.types import Array, Index, Mask


@dataclass(slots=True)
class AgainstPredictions:
    """A sample against the predictions that were due.

    ``room``, ``lo``, ``hi`` (2n,): least distance to a bound over half the width, and what all predictions leave.  Above and below:
    ``age`` (2, 2n) [steps] of the prediction that is passed worst, 0 where none is; its bounds ``ends`` (2, 2n, 2); ``foreign`` (2, 2n)
    where it passed samples outside the domain.  ``oldest`` (1,): the greatest age.
    """

    room: Array
    lo: Array
    hi: Array
    worst: Array
    ends: Array
    age: Index
    foreign: Mask
    oldest: Index

    @classmethod
    def room_for(cls, states: int) -> AgainstPredictions:
        m, sides = states, (2, states)
        return cls(
            np.ones(m), np.empty(m), np.empty(m), np.zeros(sides), np.zeros((*sides, 2)), np.zeros(sides, np.int64),
            np.zeros(sides, bool), np.zeros(1, np.int64),
        )  # fmt: skip

    def struct(self) -> Any:
        numbers = [view(x.reshape(-1)) for x in (self.room, self.lo, self.hi, self.worst, self.ends)]
        return ffi.new(
            "StopsetHeld *", (*numbers, integers(self.age.reshape(-1)), flags(self.foreign.reshape(-1)), integers(self.oldest))
        )


@dataclass(slots=True)
class Predictions:
    """Of a model with a grid of ``every`` samples a step; ``steps``: the oldest age."""

    model: Model
    quantum: Quantum
    steps: int
    every: int
    held: AgainstPredictions = field(init=False)
    _along: Any = field(init=False)
    _held: Any = field(init=False)
    _retained: tuple[Any, ...] = field(init=False)  # what the core's view points at

    def __post_init__(self) -> None:
        m, sets, rows = self.model, self.model.powered, self.steps + 1
        n, corners = m.n, m.abstraction.decoupled
        struct, _ = dynamics(m.abstraction)
        fixed = [given(b) for X in (sets.X0, sets.U, sets.V) for b in (X.lo, X.hi)]
        box = ffi.new("StopsetSets *", (*map(view, fixed), int(sets.conform == "position")))
        rounding = np.concatenate([self.quantum.q, self.quantum.dq])
        x, u = np.zeros((2 if corners else 1) * rows * 2 * n), np.zeros(0 if corners else rows * 2 * n)
        starts, outside, total = np.zeros(rows, bool), np.zeros(rows, bool), np.zeros(2 * n)
        count, work = (
            np.zeros(lib.STOPSET_ALONG_COUNTS, np.int64),
            np.zeros(0 if corners else lib.stopset_along_room(struct, self.steps)),
        )
        fastest = float(np.maximum(np.abs(m.domain.dq.lo), np.abs(m.domain.dq.hi)).max())
        self._along = ffi.new("StopsetAlong *", (
            struct, box, view(rounding), sets.dt, fastest, self.steps, int(corners), int(sets.windows == "sliding"), view(x), view(u),
            flags(starts), flags(outside), view(total), integers(count), view(work),
        ))  # fmt: skip
        self.held = AgainstPredictions.room_for(2 * n)
        self._held = self.held.struct()
        self._retained = (struct, box, fixed, rounding, x, u, starts, outside, total, count, work)

    def forget(self) -> None:
        """The next sample belongs to no earlier one."""
        lib.stopset_along_forget(self._along)

    def sample(self, x: Array, u: Array, du: Array, *, outside: bool) -> int:
        """A state ``x`` (2n,) with its input ``u``, known to within ``du`` (n,): how many predictions it was held against, see `held`;
        -1 between two steps of the grid."""
        return int(
            lib.stopset_along_sample(
                self._along, self.every, view(given(x)), view(given(u)), view(given(du)), outside, self._held
            )
        )

    def bounds(self, age: int) -> tuple[Array, Array]:
        """(2n,) where a reading may be now, by the prediction that began ``age`` steps ago."""
        lo, hi = np.empty(2 * self.model.n), np.empty(2 * self.model.n)
        lib.stopset_along_bounds(self._along, age, view(lo), view(hi))
        return lo, hi
