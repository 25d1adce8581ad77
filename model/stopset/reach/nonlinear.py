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

from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from stopset.artifact import Abstraction, UncertaintySets
from stopset.artifact.polynomial import struct_of
from stopset.core.library import check, ffi, given, lib, view
from stopset.errors import NotCovered
from stopset.reach.flowpipe import Responses
from stopset.sets import Box
from stopset.types import Array

# a step's rate times its length; the fourth-order error of one step is below STEP^5 / 120 of the speed's change
STEP: float = lib.stopset_corner_step
FAR: int = lib.STOPSET_FAR  # steps of the oldest prediction along a nominal motion, in the monitor and the FMU
# a frozen, slotted value has no room for a cache of its own; entries go when the abstraction goes
_DYNAMICS: WeakKeyDictionary[Abstraction, tuple[Any, Any]] = WeakKeyDictionary()
_TERMS: int = lib.STOPSET_TERMS  # of the exponential of one step's matrix, whose norm is below 1


def joint_struct(c: Array, h: float, parts: int) -> tuple[Any, Array]:
    """``StopsetJoint``, and what must live as long."""
    held = given(c)
    return ffi.new("StopsetJoint *", (len(held), view(held), h, parts)), held


def corner(q: float, v: float, w: Array, c: Array, h: float, parts: int) -> Array:
    """Trajectory (N + 1, 2) of one joint over (q, dq): ``q' = v, v' = w - sum c_k v^(k+1)`` under ``w`` (N,), each held
    over ``h`` [s] in ``parts`` parts (classical Runge-Kutta)."""
    out = np.empty((len(w) + 1, 2))
    joint, _held = joint_struct(c, h, parts)
    lib.stopset_corner(joint, q, v, len(w), view(given(w)), view(out))
    return out


def dynamics(abstraction: Abstraction) -> tuple[Any, Array]:
    """``StopsetDynamics`` of an abstraction, kept as long as it lives, and new work space for it."""
    if abstraction not in _DYNAMICS:
        a = abstraction
        if a.viscous.shape[1] > lib.STOPSET_DAMPING:
            raise NotCovered(
                f"a damping polynomial of order {a.viscous.shape[1]}; expected {lib.STOPSET_DAMPING} at most: lower --order"
            )
        Minv, viscous = given(a.Minv), given(a.viscous)
        table, held = (
            (ffi.new("StopsetPolynomials *"), None) if a.kind == 1 or not (a.coriolis or a.acceleration) else struct_of(a.program)
        )
        struct = ffi.new("StopsetDynamics *", (a.n, a.kind, viscous.shape[1], view(Minv), view(viscous), table[0]))
        _DYNAMICS[abstraction] = struct, (Minv, viscous, table, held)
    struct = _DYNAMICS[abstraction][0]
    return struct, np.empty(lib.stopset_dynamics_room(struct))


def parts(abstraction: Abstraction, dt: float, speed: Array) -> int:
    """Into how many parts a step of ``dt`` [s] is cut so that no rate of decay up to ``speed`` (n,) [rad/s] exceeds `STEP`.

    Raises `NotCovered` where damping is so strong at that speed that the step would not end.
    """
    fastest = float(np.max(speed))
    found = int(lib.stopset_parts(dynamics(abstraction)[0], dt, fastest))
    if not np.isfinite(fastest) or found >= lib.STOPSET_MOST_PARTS:
        raise NotCovered(
            f"damping at {fastest:g} rad/s asks for {lib.STOPSET_MOST_PARTS} parts of a step of {dt:g} s or more; expected speeds and damping "
            "of an arm: look for a reading or a coefficient that cannot be meant"
        )
    return found


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
    W, N, n = u.shape
    if x0.shape != (W, 2 * n) or n != abstraction.n:
        raise ValueError(f"starts {x0.shape} and inputs {u.shape} of {abstraction.n} joints")
    out, (struct, work) = np.empty((W, N + 1, 2 * n)), dynamics(abstraction)
    held = given(x0), given(u)
    starts = ffi.new("StopsetStarts *", (W, N, *(view(x) for x in held), dt))
    lib.stopset_nominal(struct, starts, view(work), view(out))
    return out


def along(abstraction: Abstraction, x: Array, u: Array, dt: float) -> Responses:
    """Responses of the deviation from a nominal solution ``x`` (H + 1, 2n) under ``u`` (H, n).

    The step matrix is that of the mean of a step's two ends.  Within a step the response to a torque is exact where it
    keeps its sign and covered by its larger end where it does not.
    """
    n = abstraction.n
    H, m = len(x) - 1, 2 * n
    J_x, J_u, (struct, work) = np.empty((H + 1, n, m)), np.empty((H + 1, n, n)), dynamics(abstraction)
    lib.stopset_linearised(struct, H + 1, view(given(x)), view(np.vstack([u, u[-1:]])), view(work), view(J_x), view(J_u))
    E1, plus, minus = np.empty((H + 1, m, m)), np.empty((H + 1, m, n)), np.empty((H + 1, m, n))
    work = np.empty((3, H, m, n))
    found = ffi.new("StopsetResponses *", (H + 1, m, m, n, view(E1), view(plus), view(minus)))
    check(lib.stopset_along(n, H, view(given(J_x)), view(given(J_u)), dt, found, view(work)))
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
