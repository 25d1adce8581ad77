"""Predictions of a linear model in arrays that the core steps: how far each reading is from what was predicted, and the tube around it.

Source: Liu & Althoff (2018), eq. (17)-(21), with the tube of `stopset.reach.flowpipe` (same as the identification).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stopset.artifact import Model
from stopset.artifact.taped import Pinned
from stopset.core.library import ffi, lib
from stopset.monitor.sample import Quantum
from stopset.monitor.verdict import Deviation
from stopset.reach.flowpipe import deviation_tube, discretise
from stopset.types import Array

MAX_PREDICTIONS = 1500  # rows of the comparison; longer horizons start fewer predictions
BRIDGE = 5  # cycles from one sample to the next that predictions are led across; after more they start anew


@dataclass(slots=True)
class LinearTubes:
    """All predictions of ``model``, readings rounded by ``quantum``; ``plain``: then what rounding adds depends on the age alone.

    ``struct``: the core's `StopsetPredictions`; ``start`` (2n,): what rounding adds to a prediction at its start.
    """

    model: Model
    quantum: Quantum
    plain: bool
    ages: Array = field(init=False)
    seconds: list[float] = field(init=False)  # the same: from an array every one would be made anew
    stride: int = field(init=False)  # samples from the start of one prediction to the next
    start: Array = field(init=False)
    room: Array = field(init=False)
    struct: Any = field(init=False)
    _Ad: Array = field(init=False)
    _Bd: Array = field(init=False)
    _lo: Array = field(init=False)  # (ages, 2n)
    _hi: Array = field(init=False)
    _e: Array = field(init=False)  # (m, 2n) measured minus predicted, one row per prediction, newest overwrites oldest
    _w: Array = field(init=False)  # (m, 2n) what bus rounding can have added to that along the way
    _age: NDArray[np.int64] = field(init=False)  # (m,) in steps, -1 where no prediction is
    _foreign: NDArray[np.bool_] = field(init=False)  # the prediction passed samples outside the domain
    _row: NDArray[np.int64] = field(init=False)
    _pinned: Pinned = field(init=False)  # what the struct points at

    def __post_init__(self) -> None:
        m, sets, n = self.model, self.model.powered, self.model.n
        self._Ad, self._Bd = discretise(m.abstraction, sets.dt)
        tube = deviation_tube(m.abstraction, sets)
        self.ages, self.seconds = tube.ages, tube.ages.tolist()
        # H products of 2n + n terms each round by 2^-53 relative to states within a few turns
        rounding = len(tube.ages) * 3 * n * 2.0**-53 * 32.0
        here = np.concatenate([self.quantum.q, self.quantum.dq])
        self._lo, self._hi = tube.lo - here - rounding, tube.hi + here + rounding
        steps = len(tube.ages) - 1
        if self.plain:
            added = here
            for k in range(steps + 1):
                self._lo[k] -= added
                self._hi[k] += added
                added = np.abs(self._Ad) @ added + np.abs(self._Bd) @ self.quantum.tau
        self.start = np.zeros(2 * n) if self.plain else here
        self.stride = max(1, -(-steps // MAX_PREDICTIONS))
        rows = steps // self.stride + 1
        self._e, self._w = np.zeros((rows, 2 * n)), np.zeros((rows, 2 * n))
        self._age, self._foreign = np.full(rows, -1), np.zeros(rows, bool)
        self.room, self._row = np.empty(2 * n), np.empty((2, 2 * n), np.int64)
        pinned = self._pinned = Pinned([])
        middle, reach, nearest = np.empty_like(self._lo), np.empty_like(self._lo), np.full(2 * n, -1)
        self.struct = ffi.new("StopsetPredictions *", (
            2 * n, rows, len(self.ages), *map(pinned.shared, (
                self._e, self._w, self._age, self._foreign, np.ascontiguousarray(self._Ad), np.ascontiguousarray(self._Bd),
                self._lo, self._hi, middle, reach, self.room, nearest, self._row,
            )),
        ))  # fmt: skip
        lib.stopset_centre(self.struct)

    def forget(self) -> None:
        """No prediction holds any more."""
        self._age[:] = -1

    def widen(self, change: Array) -> None:
        """The tube is for readings that may be wrong by ``change`` (2n,) more than before."""
        self._lo -= change
        self._hi += change
        self.start += change
        lib.stopset_centre(self.struct)

    def bridge(self, steps: int) -> bool:
        """Take every prediction over ``steps`` cycles whose readings were lost; False if that is not possible.

        Whatever torque acted then, it took the arm from the reading before to the reading after, both true to within ``X0``
        and the reading's noise. So what a prediction has gathered before goes on, as if the disturbance had been in the middle
        of ``U`` meanwhile, and it is wider by what both readings may be wrong by: nothing that was seen before is forgotten.
        """
        sets = self.model.powered
        if not 1 < steps <= BRIDGE or sets.conform != "all" or sets.windows != "sliding":
            return False
        power, shift = np.eye(len(self._Ad)), np.zeros(len(self._Ad))
        middle = sets.U.centre if sets.zonotope is None else sets.zonotope.centre
        for _ in range(steps):
            shift = self._Ad @ shift + self._Bd @ middle
            power = self._Ad @ power
        ends = (sets.X0.lo, sets.X0.hi, sets.V.lo, sets.V.hi)
        wrong = np.max(np.abs(ends), axis=0) + np.concatenate([self.quantum.q, self.quantum.dq])
        alive = self._age >= 0
        self._age[alive] += steps
        self._age[self._age >= len(self.ages)] = -1
        self._e[alive] = self._e[alive] @ power.T + shift
        self._w[alive] = (self._w[alive] + wrong) @ np.abs(power).T + wrong
        return True

    def between(self, x: Array) -> tuple[Array, Array] | None:
        """Between which values (2n,) all predictions in force put the reading ``x`` (2n,) taken last; None where there are none.

        Where they contradict each other the lower end is above the upper one.
        """
        rows = np.flatnonzero(self._age > 0)
        if not len(rows):
            return None
        age = self._age[rows]
        nominal = x - self._e[rows]
        lo, hi = nominal + self._lo[age] - self._w[rows], nominal + self._hi[age] + self._w[rows]
        return lo.max(axis=0), hi.min(axis=0)

    def deviations(self, x: Array) -> tuple[Deviation, ...]:
        """What of the reading ``x`` (2n,) is outside, each against the prediction that it contradicts worst."""
        # from a list: of a tuple that a generator fills Python keeps its pieces for another time
        return tuple([self._deviation(x, int(i), int(side)) for side, i in np.argwhere(self._row >= 0)])

    def _deviation(self, x: Array, i: int, side: int) -> Deviation:
        """State ``i``, above (0) or below (1)."""
        n, row = self.model.n, int(self._row[side, i])
        age = int(self._age[row])
        lo, hi = self._lo[age, i] - self._w[row, i], self._hi[age, i] + self._w[row, i]
        excess = float(self._e[row, i] - hi if side == 0 else lo - self._e[row, i])
        return Deviation(
            joint=self.model.joints[i % n],
            state="q" if i < n else "dq",
            side="above" if side == 0 else "below",
            age=float(self.ages[age]),
            excess=excess,
            fraction=excess / max(float(hi - lo), 1e-300),
            measured=float(x[i]),
            bound=float(x[i]) - excess if side == 0 else float(x[i]) + excess,
            in_domain=not bool(self._foreign[row]),
        )
