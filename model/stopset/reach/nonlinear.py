"""Prediction sets of nonlinear abstractions: the two corner simulations of model 1, the linearised hull of models 2 and
3.

Per joint, model 1 is ``q' = dq, dq' = Minv (u - tau_nu(dq))``: more of anything (start angle, start speed, torque)
never gives less of anything later, whatever the friction curve (the off-diagonal derivatives are 1 and 0).  So the
exact interval hull of all solutions is the pair of solutions from the lower and the upper corner (trap P22); no Taylor
form, no search.

Models 2 and 3 and coupled joints do not have that.  There the set *is defined* as the box hull of the deviations'
linear time-varying equation along the nominal solution, computed the same way in identification and at run time (trap
P18); it drops second-order terms in the deviation, and what that costs is measured by sampling
(`stopset.offline.conform.nonlinear`).

Source: Liu & Althoff (2018), Sec. IV-C; Smith (1995), Monotone Dynamical Systems, ch. 3.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stopset.artifact import Abstraction, UncertaintySets
from stopset.reach.flowpipe import Responses
from stopset.sets import Box

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# a step's rate times its length; the fourth-order error of one step is below STEP^5 / 120 of the speed's change
STEP = 0.1
_TERMS = 12  # of the exponential of one step's matrix, whose norm is below 1


@njit(cache=True, inline="always")
def _accelerate(v: float, w: float, c: Array) -> float:
    """``w - sum_k c_k v^(k+1)``."""
    drag = 0.0
    for k in range(c.shape[0] - 1, -1, -1):
        drag = (drag + c[k]) * v
    return w - drag


@njit(cache=True, inline="always")
def corner_step(q: float, v: float, w: float, c: Array, h: float, parts: int) -> tuple[float, float]:
    """One step of ``q' = v, v' = w - sum c_k v^(k+1)`` with ``w`` held: classical Runge-Kutta in ``parts`` parts."""
    d = h / parts
    for _ in range(parts):
        k1 = _accelerate(v, w, c)
        k2 = _accelerate(v + 0.5 * d * k1, w, c)
        k3 = _accelerate(v + 0.5 * d * k2, w, c)
        k4 = _accelerate(v + d * k3, w, c)
        q += d * v + d * d / 6.0 * (k1 + k2 + k3)
        v += d / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return q, v


@njit(cache=True)
def corner(q: float, v: float, w: Array, c: Array, h: float, parts: int) -> Array:
    """Trajectory (N + 1, 2) of one joint over (q, dq) under the accelerating inputs ``w`` (N,)."""
    out = np.empty((w.shape[0] + 1, 2))
    out[0, 0], out[0, 1] = q, v
    for k in range(w.shape[0]):
        q, v = corner_step(q, v, w[k], c, h, parts)
        out[k + 1, 0], out[k + 1, 1] = q, v
    return out


def parts(abstraction: Abstraction, dt: float, speed: Array) -> int:
    """Into how many parts a step of ``dt`` [s] is cut so that no rate of decay up to ``speed`` (n,) [rad/s] exceeds `STEP`."""
    orders = np.arange(abstraction.viscous.shape[1])
    slope = np.abs(abstraction.viscous) @ ((orders + 1.0) * np.max(speed) ** orders)
    return int(np.ceil(max(1.0, dt * float(np.max(np.diag(abstraction.Minv) * slope)) / STEP)))


def two_simulations(abstraction: Abstraction, x0: Array, u: Array, dt: float, X0: Box, U: Box) -> tuple[Array, Array]:
    """Exact hull (N + 1, 2n) of a decoupled model 1 from ``x0 + X0`` under ``u + U``; ``u``: (N, n) held over each
    step.

    Exact for every input that varies in time within ``U``; the integration itself is accurate to `STEP`.
    """
    n = abstraction.n
    cut = parts(abstraction, dt, np.abs(x0[n:]) + 2.0)
    lo, hi = np.empty((len(u) + 1, 2 * n)), np.empty((len(u) + 1, 2 * n))
    for j in range(n):
        gain = float(abstraction.Minv[j, j])
        c = gain * abstraction.viscous[j]
        for side, X, W in ((lo, X0.lo, U.lo), (hi, X0.hi, U.hi)):
            w = np.ascontiguousarray(gain * (u[:, j] + W[j]))
            side[:, [j, n + j]] = corner(x0[j] + X[j], x0[n + j] + X[n + j], w, c, dt, cut)
    return lo, hi


def nominal(abstraction: Abstraction, x0: Array, u: Array, dt: float) -> Array:
    """Nominal solutions (W, N + 1, 2n) from ``x0`` (W, 2n) under ``u`` (W, N, n) held over each step (Runge-Kutta)."""
    n = abstraction.n
    out = np.empty((x0.shape[0], u.shape[1] + 1, 2 * n))
    out[:, 0] = x0
    q, v = x0[:, :n].copy(), x0[:, n:].copy()
    for k in range(u.shape[1]):
        w = u[:, k]
        k1 = abstraction.ddq(q, v, w)
        k2 = abstraction.ddq(q + 0.5 * dt * v, v + 0.5 * dt * k1, w)
        k3 = abstraction.ddq(q + 0.5 * dt * v + 0.25 * dt * dt * k1, v + 0.5 * dt * k2, w)
        k4 = abstraction.ddq(q + dt * v + 0.5 * dt * dt * k2, v + dt * k3, w)
        q = q + dt * v + dt * dt / 6.0 * (k1 + k2 + k3)
        v = v + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        out[:, k + 1, :n], out[:, k + 1, n:] = q, v
    return out


def along(abstraction: Abstraction, x: Array, u: Array, dt: float) -> Responses:
    """Responses of the deviation from a nominal solution ``x`` (H + 1, 2n) under ``u`` (H, n).

    The step matrix is that of the mean of a step's two ends.  Within a step the response to a torque is exact where it
    keeps its sign and covered by its larger end where it does not.
    """
    n = abstraction.n
    held = np.vstack([u, u[-1:]])
    J_x, J_u = abstraction.linearised(x[:, :n], x[:, n:], held)
    return Responses(dt, *_along(J_x, J_u, dt))


@njit(cache=True)
def _product(a: Array, b: Array, out: Array) -> None:
    """``out = a b`` by plain loops, which compile fast and beat a library call at this size."""
    for i in range(a.shape[0]):
        for j in range(b.shape[1]):
            total = 0.0
            for k in range(a.shape[1]):
                total += a[i, k] * b[k, j]
            out[i, j] = total


@njit(cache=True)
def _along(J_x: Array, J_u: Array, dt: float) -> tuple[Array, Array, Array]:
    H, n = J_x.shape[0] - 1, J_x.shape[1]
    m = 2 * n
    E1, plus, minus = np.empty((H + 1, m, m)), np.zeros((H + 1, m, n)), np.zeros((H + 1, m, n))
    E1[0] = np.eye(m)
    start, end, whole = np.zeros((H, m, n)), np.zeros((H, m, n)), np.zeros((H, m, n))
    A, B = np.zeros((m, m)), np.zeros((m, n))
    moved, column = np.empty((m, m)), np.empty((m, n))
    for i in range(n):
        A[i, n + i] = 1.0
    for k in range(H):
        A[n:] = 0.5 * (J_x[k] + J_x[k + 1])
        B[n:] = 0.5 * (J_u[k] + J_u[k + 1])
        step, integral, term = np.eye(m), np.eye(m) * dt, np.eye(m)
        for i in range(1, _TERMS):
            _product(term, A, moved)
            term[:] = moved * (dt / i)
            step += term
            integral += term * (dt / (i + 1))
        _product(step, E1[k], E1[k + 1])
        for s in range(k):
            for x in (start[s], end[s], whole[s]):
                _product(step, x, column)
                x[:] = column
        _product(step, B, start[k])
        end[k] = B
        _product(integral, B, whole[k])
        for s in range(k + 1):
            for i in range(m):
                for j in range(n):
                    a, b, total = start[s, i, j], end[s, i, j], whole[s, i, j]
                    size = abs(total) if a * b >= 0.0 else max(abs(total), dt * max(abs(a), abs(b)))
                    plus[k + 1, i, j] += 0.5 * (size + total)
                    minus[k + 1, i, j] -= 0.5 * (size - total)
    return E1, plus, minus


def predicted_tube(abstraction: Abstraction, sets: UncertaintySets, x0: Array, u: Array) -> tuple[Array, Array]:
    """Where a reading may lie at ages ``0, dt, .. N dt`` after the reading ``x0`` (2n,): bounds (N + 1, 2n) over (q,
    dq).

    ``u``: (N, n) inputs held over each step.  The one function identification, monitor and comparison share (trap P18).
    """
    n = abstraction.n
    if abstraction.decoupled:
        lo, hi = two_simulations(abstraction, x0, u, sets.dt, sets.X0, sets.U)
    else:
        x = nominal(abstraction, x0[None], u[None], sets.dt)[0]
        lo, hi = along(abstraction, x, u, sets.dt).hull(sets.X0.lo, sets.X0.hi, sets.U.lo, sets.U.hi)
        lo, hi = x + lo, x + hi
    lo, hi = lo + sets.V.lo, hi + sets.V.hi
    # some thousand additions in double precision, rounded outward
    slack = 2.0**-42 * np.maximum(np.abs(lo), np.abs(hi))
    lo, hi = lo - slack, hi + slack
    if sets.conform == "position":
        lo[:, n:], hi[:, n:] = -np.inf, np.inf
    return lo, hi
