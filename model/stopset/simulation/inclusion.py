"""Dry friction as the cell sees it: a joint either slides against full friction, or it sticks and does not move.

One step of a mechanical system with set-valued friction is the velocity-level inclusion

    A w + p = b,    p_i in [-minus_i, plus_i],   p_i = plus_i if w_i > 0,   p_i = -minus_i if w_i < 0,

``A`` symmetric positive definite (inertia, implicit damping and stiffness), ``w`` the velocity at the end of the step,
``p`` the friction impulses.  It is the optimality condition of a strictly convex problem, so it has exactly one
solution; no smoothed ``tanh`` and no creep: sticking joints get ``w_i = 0`` to the bit.

Source: Moreau (1988), Unilateral contact and dry friction in finite freedom dynamics; Tseng (2001) for the convergence
of coordinate descent on such a problem.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
SWEEPS = 400  # coordinate descent gains a digit in a few sweeps on arm inertias; this is never reached there
CHECK_EVERY = 3
# complementarity is accepted within this fraction of the impulses' scale: some 10^3 rounding errors
ROUNDING = 1e-12


@njit(cache=True)
def _solve_moving(A: Array, b: Array, plus: Array, minus: Array, mode: NDArray[np.int64], w: Array, L: Array) -> bool:
    """Solve for the moving joints with all others at rest, into ``w``; True if the answer satisfies the inclusion."""
    n = b.shape[0]
    scale = 0.0
    for i in range(n):
        scale = max(scale, abs(b[i]), plus[i], minus[i])
    tolerance = ROUNDING * scale
    # Cholesky of the moving block, rows of joints at rest left out in place
    for i in range(n):
        if mode[i] == 0:
            w[i] = 0.0
            continue
        r = b[i] - (plus[i] if mode[i] > 0 else -minus[i])
        for j in range(i):
            if mode[j] == 0:
                continue
            s = A[i, j]
            for k in range(j):
                if mode[k] != 0:
                    s -= L[i, k] * L[j, k]
            L[i, j] = s / L[j, j]
            r -= L[i, j] * w[j]
        d = A[i, i]
        for k in range(i):
            if mode[k] != 0:
                d -= L[i, k] * L[i, k]
        L[i, i] = np.sqrt(d)
        w[i] = r / L[i, i]
    for i in range(n - 1, -1, -1):
        if mode[i] == 0:
            continue
        s = w[i]
        for k in range(i + 1, n):
            if mode[k] != 0:
                s -= L[k, i] * w[k]
        w[i] = s / L[i, i]
    for i in range(n):
        if mode[i] != 0:
            if w[i] * mode[i] < 0.0 and plus[i] + minus[i] > 0.0:
                return False
        else:
            r = b[i]
            for j in range(n):
                r -= A[i, j] * w[j]
            if r > plus[i] + tolerance or r < -minus[i] - tolerance:
                return False
    return True


@njit(cache=True)
def solve_inclusion(A: Array, b: Array, plus: Array, minus: Array, mode: NDArray[np.int64], w: Array, L: Array) -> bool:
    """Solve the inclusion of the module; True when solved to rounding.

    ``A`` (n, n), ``b, plus, minus`` (n,) impulses [N m s], ``plus, minus`` >= 0.  ``mode`` (n,) holds the guess who
    moves which way (-1, 0, 1) and afterwards the answer; ``w`` (n,) [rad/s] gets the velocity; ``L`` is scratch.
    """
    if _solve_moving(A, b, plus, minus, mode, w, L):
        return True
    n = b.shape[0]
    x = w.copy()  # the descent's own iterate: a wrong guess of who moves must not throw it back
    for sweep in range(1, SWEEPS + 1):
        for i in range(n):
            r = b[i]
            for j in range(n):
                if j != i:
                    r -= A[i, j] * x[j]
            if r > plus[i]:
                x[i] = (r - plus[i]) / A[i, i]
                mode[i] = 1
            elif r < -minus[i]:
                x[i] = (r + minus[i]) / A[i, i]
                mode[i] = -1
            else:
                x[i] = 0.0
                mode[i] = 0
        if sweep % CHECK_EVERY == 0 and _solve_moving(A, b, plus, minus, mode, w, L):
            return True
    w[:] = x
    return False


@njit(cache=True)
def first_crossing(
    A: Array, b: Array, plus: Array, minus: Array, v: Array, w: Array, L: Array, mode: NDArray[np.int64]
) -> tuple[float, int]:
    """The share of a step after which the first sliding joint comes to zero speed, and which joint; (1.0, -1) for none.

    Same arguments as `solve_inclusion`; ``v`` (n,) is the velocity at the step's start.  Friction of the sliding joints
    keeps its direction here, also beyond zero: where their straight line from ``v`` to the result crosses is the event.
    ``b, plus, minus, w, mode`` are overwritten.
    """
    n = b.shape[0]
    for i in range(n):
        if v[i] > 0.0:
            b[i] -= plus[i]
        elif v[i] < 0.0:
            b[i] += minus[i]
        else:
            continue
        plus[i] = minus[i] = 0.0
        mode[i] = 1 if v[i] > 0.0 else -1
    solve_inclusion(A, b, plus, minus, mode, w, L)
    share, joint = 1.0, -1
    for i in range(n):
        if v[i] != 0.0 and w[i] * v[i] <= 0.0:
            here = v[i] / (v[i] - w[i])
            if here < share:
                share, joint = here, i
    return share, joint
