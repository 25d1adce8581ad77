"""The reachable set of the linear model as a box hull, and the deviation tube that measurements are held against.

Identification and monitor use these same arrays (trap P18).  Inputs may vary in time within ``U`` (trap P4), and signs
of the response decide which corner counts (trap P1)::

    sup x(t) = E1+ X0.hi + E1- X0.lo + (int K+) U.hi + (int K-) U.lo,    K(t) = e^{At} B,  E1 = e^{At}

Source: Liu & Althoff (2018), eq. (17)-(20), with the corrections named above.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stopset.artifact import Abstraction, UncertaintySets
from stopset.errors import NotCovered

Array = NDArray[np.float64]


def expm(X: Array) -> Array:
    """Matrix exponential: scaling by a power of two, Taylor to full precision, squaring (small matrices, norm decides)."""
    squarings = max(0, int(np.ceil(np.log2(max(float(np.abs(X).sum(axis=1).max()), 1e-300)))) + 2)
    Y = X / 2.0**squarings  # norm <= 1/4: the 20th term is below 1/4^20/20! < 1e-30
    term, out = np.eye(X.shape[0]), np.eye(X.shape[0])
    for k in range(1, 20):
        term = term @ Y / k
        out = out + term
    for _ in range(squarings):
        out = out @ out
    return out


def _linear(abstraction: Abstraction) -> tuple[Array, Array]:
    if not abstraction.linear:
        raise NotCovered(
            f"this is model {abstraction.kind} of order {abstraction.order}; the constant tube that is watched live and exported "
            "belongs to a linear model: identify with --model 1 --order 1"
        )
    return abstraction.A, abstraction.B


def discretise(abstraction: Abstraction, dt: float) -> tuple[Array, Array]:
    """``Ad`` (2n, 2n), ``Bd`` (2n, n): exact step of ``dt`` [s] with the input held (zero-order hold)."""
    A, B = _linear(abstraction)
    m, n = B.shape
    block = expm(np.block([[A, B], [np.zeros((n, m + n))]]) * dt)
    return block[:m, :m].copy(), block[:m, m:].copy()


@dataclass(frozen=True, slots=True)
class Responses:
    """Responses on the grid ``k dt``, k = 0..H: ``E1`` (H+1, 2n, 2n), ``plus`` and ``minus`` (H+1, 2n, n).

    ``plus`` is an upper bound of the integral of ``max(K, 0)``, ``minus`` a lower bound of that of ``min(K, 0)``; where
    K keeps its sign within a step (always, for a decoupled model) both are exact.
    """

    dt: float
    E1: Array
    plus: Array
    minus: Array

    def hull(self, X0_lo: Array, X0_hi: Array, U_lo: Array, U_hi: Array) -> tuple[Array, Array]:
        """Lower and upper bounds (H+1, 2n) of ``E1 X0 + convolution of K with U``."""
        Ep, En = np.maximum(self.E1, 0.0), np.minimum(self.E1, 0.0)
        hi = Ep @ X0_hi + En @ X0_lo + self.plus @ U_hi + self.minus @ U_lo
        lo = Ep @ X0_lo + En @ X0_hi + self.plus @ U_lo + self.minus @ U_hi
        return lo, hi


def responses(abstraction: Abstraction, dt: float, steps: int) -> Responses:
    """`Responses` of a linear abstraction for ages ``0, dt, ..., steps dt``."""
    A, B = _linear(abstraction)
    Ad, Bd = discretise(abstraction, dt)
    m, n = B.shape
    E1 = np.empty((steps + 1, m, m))
    plus, minus = np.zeros((steps + 1, m, n)), np.zeros((steps + 1, m, n))
    E1[0] = np.eye(m)
    growth = np.abs(A) @ expm(np.abs(A) * dt)  # |K'| on a step <= growth |K(start)|
    for k in range(steps):
        E1[k + 1] = E1[k] @ Ad
        Ka, Kb = E1[k] @ B, E1[k + 1] @ B
        whole = E1[k] @ Bd  # exact integral of K over the step
        slope = growth @ np.abs(Ka) * dt
        # with both ends on one side, K would need this much slope to reach zero and come back within the step
        keeps_sign = ((Ka * Kb >= 0.0) & (np.abs(Ka) + np.abs(Kb) >= slope)) | _signed(abstraction)
        magnitude = np.where(keeps_sign, np.abs(whole), dt * (np.minimum(np.abs(Ka), np.abs(Kb)) + slope))
        plus[k + 1] = plus[k] + 0.5 * (magnitude + whole)
        minus[k + 1] = minus[k] - 0.5 * (magnitude - whole)
    return Responses(dt, E1, plus, minus)


def _signed(abstraction: Abstraction) -> bool:
    """A decoupled joint with non-negative damping has ``K >= 0`` throughout: ``(1 - e^{-at})/v`` and ``e^{-at}/J``."""
    return abstraction.decoupled and bool(np.all(abstraction.viscous[:, 0] >= 0) and np.all(np.diag(abstraction.Minv) > 0))


@dataclass(frozen=True, slots=True)
class Tube:
    """What a measured state may differ from the nominal prediction at each age: ``lo``, ``hi`` (H+1, 2n) over (q, dq)."""

    ages: Array  # (H+1,) [s]
    lo: Array
    hi: Array


def deviation_tube(abstraction: Abstraction, sets: UncertaintySets) -> Tube:
    """Tube of measured deviations for all ages up to the sets' horizon: the start's and the reading's noise included.

    For ``conform == 'position'`` the velocity rows are unbounded (infinite), because nothing was promised about them.
    """
    steps = round(sets.horizon / sets.dt)
    R = responses(abstraction, sets.dt, steps)
    lo, hi = R.hull(sets.X0.lo, sets.X0.hi, sets.U.lo, sets.U.hi)
    lo, hi = lo + sets.V.lo, hi + sets.V.hi
    n = abstraction.n
    if sets.conform == "position":
        lo[:, n:], hi[:, n:] = -np.inf, np.inf
    # sums of 2n + 2n + 1 products in double precision, rounded outward
    slack = 2.0**-50 * n * np.maximum(np.abs(lo), np.abs(hi))
    slack[~np.isfinite(slack)] = 0.0
    return Tube(np.asarray(sets.dt * np.arange(steps + 1)), lo - slack, hi + slack)


def predict(abstraction: Abstraction, dt: float, x0: Array, u: Array) -> Array:
    """Nominal prediction ``x*`` (N, 2n) from ``x0`` (2n,) under inputs ``u`` (N, n) held over each step."""
    if not abstraction.linear:
        from stopset.reach.nonlinear import nominal  # which rests on this module

        path: Array = nominal(abstraction, x0[None], u[None, :-1], dt)[0]
        return path
    Ad, Bd = discretise(abstraction, dt)
    out = np.empty((u.shape[0], x0.shape[0]))
    out[0] = x0
    drive = u @ Bd.T
    for k in range(u.shape[0] - 1):
        out[k + 1] = Ad @ out[k] + drive[k]
    return out
