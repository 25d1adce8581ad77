"""A window of readings held against the model once more, at leisure: whatever is changed in them, does the rest still agree?"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stopset.errors import NotCovered
from stopset.reach.flowpipe import deviation_tube, discretise
from stopset.types import Array

if TYPE_CHECKING:
    from stopset.artifact import Model
    from stopset.monitor.evidence.trace import Window
    from stopset.monitor.sample import Quantum

STARTS = 150  # predictions that one look begins at most
LONGEST = 25  # steps over which a torque is averaged at most


@dataclass(frozen=True, slots=True)
class Readings:
    """Rows without a gap: states ``x`` (N, 2n), inputs ``u`` (N, n), and ``good`` (N,): which of the states count."""

    x: Array
    u: Array
    good: NDArray[np.bool_]

    @classmethod
    def of(cls, w: Window) -> Readings:
        return cls(np.hstack([w.q, w.dq]), w.u, np.ones(len(w), bool))

    def without(self, rows: slice) -> Readings:
        """As if these rows had never been read; the torque that acted is taken from before and after."""
        good, u = self.good.copy(), self.u.copy()
        good[rows] = False
        lo, hi = rows.start - 1, min(rows.stop, len(u) - 1)
        for i in range(rows.start, min(rows.stop, len(u))):
            u[i] = u[lo] + (u[hi] - u[lo]) * (i - lo) / (hi - lo)
        return replace(self, good=good, u=u)

    def plus(self, x: Array | float = 0.0, u: Array | float = 0.0) -> Readings:
        """With ``x`` (N, 2n) and ``u`` (N, n) added."""
        return replace(self, x=self.x + x, u=self.u + u)


@dataclass(frozen=True, slots=True)
class Dynamics:
    """A linear model for looking back: the step ``Ad, Bd``, the tube ``lo, hi`` (H + 1, 2n) that readings are held against, and
    the torque set's ends ``U_lo, U_hi`` (n,). Raises `NotCovered` for nonlinear models."""

    joints: tuple[str, ...]
    dt: float
    Ad: Array
    Bd: Array
    lo: Array
    hi: Array
    U_lo: Array
    U_hi: Array
    steps: int = field(init=False)  # over which a push is averaged, see `pushes`
    noise: Array = field(init=False)  # (n,) [N m] what readings alone can make of such an average
    _inverse: Array = field(init=False)

    @classmethod
    def of(cls, model: Model, quantum: Quantum, du: Array) -> Dynamics:
        """``du`` (n,): the largest doubt of the input along the window [N m]."""
        sets = model.powered
        Ad, Bd = discretise(model.abstraction, sets.dt)
        tube = deviation_tube(model.abstraction, sets)
        here = np.concatenate([quantum.q, quantum.dq])
        lo, hi, w = tube.lo.copy(), tube.hi.copy(), here
        for k in range(len(lo)):
            lo[k] -= w + here
            hi[k] += w + here
            w = np.abs(Ad) @ w + np.abs(Bd) @ du
        U = sets.U.lo, sets.U.hi
        if sets.zonotope is not None:
            half = np.abs(sets.zonotope.generators).sum(axis=1)
            U = sets.zonotope.centre - half, sets.zonotope.centre + half
        return cls(model.joints, sets.dt, Ad, Bd, lo, hi, *U)

    def __post_init__(self) -> None:
        n, S, P = self.n, np.zeros_like(self.Bd), np.eye(2 * self.n)
        if not np.isfinite(self.lo).all():
            raise NotCovered("the sets promise nothing of the speeds; a violation is classed by how they change")
        half_U = 0.5 * (self.U_hi - self.U_lo)
        for m in range(1, min(LONGEST, len(self.lo) - 1) + 1):
            S, P = S + P @ self.Bd, P @ self.Ad
            half = 0.5 * (self.hi[m] - self.lo[m])[n:] - np.abs(S[n:]) @ half_U
            inverse = np.linalg.inv(S[n:])
            noise = np.abs(inverse) @ np.maximum(half, 0.0)
            if np.all(noise <= 0.5 * half_U):
                break
        for name, value in (("steps", m), ("noise", noise), ("_inverse", inverse)):
            object.__setattr__(self, name, value)

    @property
    def n(self) -> int:
        return len(self.joints)

    @property
    def middle(self) -> Array:
        """(n,) torque that the model expects besides its input [N m]."""
        return 0.5 * (self.U_lo + self.U_hi)

    def innovations(self, r: Readings) -> Array:
        """(N - 1, 2n) what the readings do from one to the next that the input does not explain."""
        return np.asarray(r.x[1:] - r.x[:-1] @ self.Ad.T - r.u[:-1] @ self.Bd.T)

    def contradiction(self, r: Readings) -> float:
        """How far the worst reading is outside the prediction of an earlier one, over the tube's width; 0 if none is."""
        N = len(r.x)
        starts = np.flatnonzero(r.good)
        starts = starts[:: -(-len(starts) // STARTS)]
        push, predicted, worst = r.u @ self.Bd.T, r.x[starts], 0.0
        width = self.hi - self.lo
        for age in range(1, min(len(self.lo), N)):
            live = int(np.searchsorted(starts, N - age))
            at = starts[:live] + age
            predicted = predicted[:live] @ self.Ad.T + push[at - 1]
            at_good = r.good[at]
            e = r.x[at[at_good]] - predicted[at_good]
            if len(e):
                out = np.maximum(e - self.hi[age], self.lo[age] - e) / width[age]
                worst = max(worst, float(out.max()))
        return worst

    def pushes(self, r: Readings) -> Array:
        """(N - steps, n) torque [N m] beyond the input that explains the speeds `steps` later, one row per start."""
        predicted, push = r.x[: -self.steps], r.u @ self.Bd.T
        N = len(predicted)
        for k in range(self.steps):
            predicted = predicted @ self.Ad.T + push[k : k + N]
        return np.asarray((r.x[self.steps :] - predicted)[:, self.n :] @ self._inverse.T)

    def averaged(self, column: Array) -> Array:
        """A column (N, ...) over the same steps as `pushes`."""
        total = np.cumsum(np.concatenate([np.zeros_like(column[:1]), column[:-1]]), axis=0)
        return np.asarray((total[self.steps :] - total[: -self.steps]) / self.steps)

    def beyond(self, pushes: Array) -> Array:
        """(N, n) by how much the pushes leave the torque set and what readings can make of it [N m]; 0 inside."""
        over = pushes - self.U_hi - self.noise
        under = self.U_lo - self.noise - pushes
        return np.asarray(np.maximum(np.maximum(over, under), 0.0))
