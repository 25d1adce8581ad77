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
from numpy.typing import NDArray

from stopset.core.library import check, given, integers, lib, view
from stopset.types import Array


def solve_inclusion(A: Array, b: Array, plus: Array, minus: Array, mode: NDArray[np.int64], w: Array) -> bool:
    """Solve the inclusion of the module; True when solved to rounding.

    ``A`` (n, n), ``b, plus, minus`` (n,) impulses [N m s], ``plus, minus`` >= 0.  ``mode`` (n,) holds the guess who
    moves which way (-1, 0, 1) and afterwards the answer; ``w`` (n,) [rad/s] gets the velocity.
    """
    n = len(b)
    if A.shape != (n, n) or not plus.shape == minus.shape == mode.shape == w.shape == (n,):
        raise ValueError(f"an inclusion of {A.shape}, {b.shape}, {plus.shape}, {minus.shape}, {mode.shape}, {w.shape}")
    solved = lib.stopset_sim_inclusion(n, *(view(given(x)) for x in (A, b, plus, minus)), integers(mode), view(w))
    check(-min(solved, 0))
    return bool(solved)
