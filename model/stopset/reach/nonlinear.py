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

from stopset.artifact import Abstraction, UncertaintySets
from stopset.core.library import check, given, lib, view
from stopset.reach.flowpipe import Responses
from stopset.sets import Box
from stopset.types import Array

# a step's rate times its length; the fourth-order error of one step is below STEP^5 / 120 of the speed's change
STEP = 0.1
_TERMS: int = lib.STOPSET_TERMS  # of the exponential of one step's matrix, whose norm is below 1


def corner(q: float, v: float, w: Array, c: Array, h: float, parts: int) -> Array:
    """Trajectory (N + 1, 2) of one joint over (q, dq): ``q' = v, v' = w - sum c_k v^(k+1)`` under ``w`` (N,), each held
    over ``h`` [s] in ``parts`` parts (classical Runge-Kutta)."""
    out = np.empty((len(w) + 1, 2))
    lib.stopset_corner(q, v, len(w), view(given(w)), len(c), view(given(c)), h, parts, view(out))
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
            w = gain * (u[:, j] + W[j])
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
    H, m = len(x) - 1, 2 * n
    E1, plus, minus = np.empty((H + 1, m, m)), np.empty((H + 1, m, n)), np.empty((H + 1, m, n))
    work = np.empty((3, H, m, n))
    check(
        lib.stopset_along(n, H, view(given(J_x)), view(given(J_u)), dt, view(E1), view(plus), view(minus), view(work))
    )  # fmt: skip
    return Responses(dt, E1, plus, minus)


def predicted_tube(
    abstraction: Abstraction, sets: UncertaintySets, x0: Array, u: Array, path: Array | None = None
) -> tuple[Array, Array]:
    """Where a reading may lie at ages ``0, dt, .. N dt`` after the reading ``x0`` (2n,): bounds (N + 1, 2n) over (q,
    dq).

    ``u``: (N, n) inputs held over each step; ``path``: the `nominal` solution (N + 1, 2n), if it is known.  The one function
    identification, monitor and comparison share (trap P18).
    """
    n = abstraction.n
    if abstraction.decoupled:
        lo, hi = two_simulations(abstraction, x0, u, sets.dt, sets.X0, sets.U)
    else:
        x = nominal(abstraction, x0[None], u[None], sets.dt)[0] if path is None else path
        lo, hi = along(abstraction, x, u, sets.dt).hull(sets.X0.lo, sets.X0.hi, sets.U.lo, sets.U.hi)
        lo, hi = x + lo, x + hi
    lo, hi = lo + sets.V.lo, hi + sets.V.hi
    # some thousand additions in double precision, rounded outward
    slack = 2.0**-42 * np.maximum(np.abs(lo), np.abs(hi))
    lo, hi = lo - slack, hi + slack
    if sets.conform == "position":
        lo[:, n:], hi[:, n:] = -np.inf, np.inf
    return lo, hi
