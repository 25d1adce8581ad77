"""Predictions of nonlinear models that go on step by step: the corners of decoupled joints, and nominal motions of the others.

Both give at every step the same bounds as `stopset.reach.nonlinear.predicted_tube`, which identification and comparison use (trap
P18), wider by what the bus rounds and what is not known of the input.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from stopset.artifact import Model
from stopset.core.library import given, lib, view
from stopset.monitor.sample import Quantum
from stopset.reach.nonlinear import FASTEST, MARGIN, NEAR, STEP, ages_of, dynamics, nominal, parts, predicted_tube
from stopset.sets import Box
from stopset.types import Array, Index

Tubes = tuple[Index, NDArray[np.bool_], Array, Array]  # ages (K,) in steps, passed outside the domain (K,), bounds (K, 2n)
ROUND = 2.0**-42  # as in `predicted_tube`


@dataclass(slots=True)
class Corners:
    """Of a friction curve on decoupled joints: the lower and the upper corner of every prediction, all ages at every step.

    ``steps``: the oldest age. Predictions start at every step, or (sets conform from the start only) at the first.
    """

    model: Model
    quantum: Quantum
    steps: int
    _z: Array = field(init=False)  # (2, steps, 2, n): lower and upper corner, per prediction, of position and speed
    _age: Index = field(init=False)
    _foreign: NDArray[np.bool_] = field(init=False)
    _cut: int = field(init=False)
    _next: int = 0

    def __post_init__(self) -> None:
        m = self.model
        self._z = np.zeros((2, self.steps + 1, 2, m.n))
        self._age, self._foreign = np.full(self.steps + 1, -1), np.zeros(self.steps + 1, bool)
        fastest = np.maximum(np.abs(m.domain.dq.lo), np.abs(m.domain.dq.hi))
        self._cut = parts(m.abstraction, m.powered.dt, fastest + MARGIN)

    def forget(self) -> None:
        self._age[:] = -1
        self._next = 0

    def launch(self, x: Array, *, foreign: bool, good: bool) -> None:
        """A prediction from the state ``x`` (2n,), if it is ``good``."""
        n, sets, q = self.model.n, self.model.powered, self.quantum
        if not good or (sets.windows != "sliding" and self._next):
            return
        row, self._next = self._next % len(self._age), self._next + 1
        here = np.concatenate([q.q, q.dq])
        for side, X in ((0, sets.X0.lo - here), (1, sets.X0.hi + here)):
            self._z[side, row] = (x + X).reshape(2, n)
        self._age[row], self._foreign[row] = 0, foreign

    def advance(self, u: Array, du: Array, *, foreign: bool) -> None:
        """One step under the inputs ``u`` (n,), known to within ``du``; classical Runge-Kutta, as where the sets were found."""
        a, sets = self.model.abstraction, self.model.powered
        alive = self._age >= 0
        for side, w in enumerate((u - du + sets.U.lo, u + du + sets.U.hi)):
            z = given(self._z[side, alive])
            lib.stopset_corners(dynamics(a)[0], len(z), view(w), sets.dt, self._cut, FASTEST, view(z.ravel()))
            self._z[side, alive] = z
        self._age[alive] += 1
        self._age[self._age > self.steps] = -1
        if foreign:
            self._foreign[alive] = True

    def tubes(self) -> Tubes:
        n, sets, q = self.model.n, self.model.powered, self.quantum
        alive = np.flatnonzero(self._age > 0)
        here = np.concatenate([q.q, q.dq])
        lo, hi = (self._z[side, alive].reshape(len(alive), 2 * n) for side in (0, 1))
        # another number of parts than in identification may differ by what one step's integration does
        rough = STEP**5 / 120.0 if self._cut > 1 else 0.0
        slack = (ROUND + rough) * np.maximum(np.abs(lo), np.abs(hi))
        lo, hi = lo + (sets.V.lo - here) - slack, hi + (sets.V.hi + here) + slack
        if sets.conform == "position":
            lo[:, n:], hi[:, n:] = -np.inf, np.inf
        return self._age[alive], self._foreign[alive], lo, hi


@dataclass(slots=True)
class Paths:
    """Of models 2 and 3 and coupled joints: nominal motions from every step, and the linearised hull along some of them.

    Its cost grows with the square of the age, so it is taken at the ages `ages_of`, the old ones in turn.
    """

    model: Model
    quantum: Quantum
    steps: int
    _ages: list[int] = field(init=False)
    _paths: list[list[Array]] = field(
        default_factory=list
    )  # one per step that passed, the oldest first; empty: none starts there
    _inputs: list[tuple[Array, Array, bool]] = field(default_factory=list)  # u, du, outside, of the steps between
    _turn: int = 0

    def __post_init__(self) -> None:
        self._ages = ages_of(self.steps)

    def forget(self) -> None:
        self._paths.clear()
        self._inputs.clear()

    def launch(self, x: Array, *, foreign: bool, good: bool) -> None:
        """A prediction from the state ``x`` (2n,) of the newest step, if it is ``good``."""
        starts = good and (self.model.powered.windows == "sliding" or not self._paths)
        self._paths.append([x] if starts else [])

    def advance(self, u: Array, du: Array, *, foreign: bool) -> None:
        """One step under the inputs ``u`` (n,), known to within ``du``."""
        self._inputs.append((u, du, foreign))
        alive = [p for p in self._paths if p]
        if alive:
            ends = np.array([p[-1] for p in alive])
            after = nominal(self.model.abstraction, ends, np.broadcast_to(u, (len(ends), 1, len(u))), self.model.powered.dt)
            for p, x in zip(alive, after[:, 1], strict=True):
                p.append(x)
        if len(self._inputs) > self.steps:
            del self._paths[0], self._inputs[0]

    def tubes(self) -> Tubes:
        n = self.model.n
        ages = self._ages if self.model.powered.windows == "sliding" else [len(self._inputs)]
        due = [a for a in ages if 0 < a <= len(self._inputs) and self._paths[-a]]
        old = [a for a in due if a > NEAR]
        self._turn += 1
        due = [a for a in due if a <= NEAR] + ([old[self._turn % len(old)]] if old else [])
        lo, hi = np.empty((len(due), 2 * n)), np.empty((len(due), 2 * n))
        for row, age in enumerate(due):
            lo[row], hi[row] = self._bounds(age)
        foreign = np.array([any(out for *_, out in self._inputs[-a:]) for a in due], bool)
        return np.array(due, np.int64), foreign, lo, hi

    def _bounds(self, age: int) -> tuple[Array, Array]:
        """(2n,) where a reading may be now, by the prediction of ``age`` steps ago."""
        path, inputs, sets = np.array(self._paths[-age]), self._inputs[-age:], self.model.powered
        here = Box.symmetric(np.concatenate([self.quantum.q, self.quantum.dq]))
        du = Box.symmetric(np.max([i[1] for i in inputs], axis=0))
        wider = replace(sets, X0=sets.X0 + here, V=sets.V + here, U=sets.U + du)
        u = np.array([i[0] for i in inputs])
        lo, hi = predicted_tube(self.model.abstraction, wider, path[0], u, path)
        return lo[-1], hi[-1]
