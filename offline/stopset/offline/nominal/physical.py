"""Inertias that a real body can have: every link's pseudo-inertia positive definite, by a conic program.

Source: Wensing, Kim & Slotine (2018), Linear matrix inequalities for physically consistent inertial parameter
identification; the constraint of each link is ``[[trace(I)/2 E - I, h], [h', m]] > 0``.
"""

from __future__ import annotations

from typing import Any

import clarabel
import numpy as np
from scipy.sparse import csc_matrix

from stopset.errors import NotConformant
from stopset.offline.nominal.prior import tensor
from stopset.types import Array

MARGIN = 1e-7  # smallest eigenvalue kept, relative to the largest of the CAD's pseudo-inertia
SMALL = 0.01  # [m] no link counts as smaller, were it described as a point
FAR = 1e12  # distance from the free solution, in roots of what is minimised, beyond which a limit cannot decide and only spoils the scale
FEASIBLE, NEAR = 1e-8, 1e-3  # residuals of limits and of slopes that a search which stops early may leave
_UPPER = [(i, k) for k in range(4) for i in range(k + 1)]


def pseudo_inertia(P: Array) -> Array:
    """(4, 4) pseudo-inertia of ten standard parameters: positive definite for every body that can exist."""
    inertia = tensor(P)
    J = np.empty((4, 4))
    J[:3, :3] = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    J[:3, 3] = J[3, :3] = P[1:4]
    J[3, 3] = P[0]
    return J


def consistent(pi: Array, reference: Array) -> bool:
    """Whether every link of ``pi`` (n, 10) is a possible body, with the margin scaled by ``reference`` (n, 10)."""
    return all(np.linalg.eigvalsh(_scaled(p, r))[0] >= 0.5 * MARGIN for p, r in zip(pi, reference, strict=True))


def _scale(reference: Array) -> Array:
    """(4,) diagonal scaling that makes the reference's pseudo-inertia of order one (lengths against masses)."""
    return np.asarray(1 / np.sqrt(np.maximum(np.diag(pseudo_inertia(reference)), SMALL**2 * reference[0])))


def _scaled(P: Array, reference: Array) -> Array:
    s = _scale(reference)
    return np.asarray(s[:, None] * pseudo_inertia(P) * s)


def solve_consistent(H: Array, b: Array, A: Array, lower: Array, upper: Array, reference: Array) -> Array:
    """Minimise ``theta' H theta / 2 - b' theta`` with ``lower <= A theta <= upper`` and every link a possible body.

    ``H`` (p, p) positive definite; ``reference`` (n, 10) CAD, for scaling.  Raises `NotConformant` when the solver fails.
    """
    n, p = len(reference), len(b)
    d = 1 / np.sqrt(np.diag(H))  # unit curvature in every parameter
    L = np.linalg.cholesky(d[:, None] * H * d)
    free, steps = np.linalg.solve(H, b) / d, np.linalg.inv(L).T
    rows, rhs = _limits(A * d, lower, upper)
    near = rhs - rows @ free < FAR * np.linalg.norm(rows @ steps, axis=1)
    (rows, far), (rhs, out_of_reach) = (rows[near], rows[~near]), (rhs[near], rhs[~near])
    cones: list[Any] = [clarabel.NonnegativeConeT(len(rhs))] if len(rhs) else []
    G = np.zeros((len(rhs) + n * len(_UPPER), p))
    G[: len(rhs)] = rows
    for i in range(n):
        s = _scale(reference[i])
        at = len(rhs) + i * len(_UPPER)
        for k, unit in enumerate(np.eye(10)):
            G[at : at + len(_UPPER), 10 * i + k] = -d[10 * i + k] * _stacked(s[:, None] * pseudo_inertia(unit) * s)
        cones.append(clarabel.PSDTriangleConeT(4))
    h = np.concatenate([rhs, *[-_stacked(MARGIN * np.eye(4))] * n])
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    # from the free solution on, in steps that cost alike: what is minimised is then the square of a distance, and zero is its scale
    found = clarabel.DefaultSolver(
        csc_matrix(np.eye(p)), np.zeros(p), csc_matrix(G @ steps), h - G @ free, cones, settings
    ).solve()
    # a search that stops early has bodies all the same; how near they are is what its slopes leave (torque in another unit does it)
    early = str(found.status) == "InsufficientProgress" and found.r_prim < FEASIBLE and found.r_dual < NEAR
    x = free + steps @ np.array(found.x)
    if not (early or str(found.status) in ("Solved", "AlmostSolved")) or bool(np.any(far @ x > out_of_reach)):
        none = "no link parameters are physically possible and meet every limit at once"
        unsure = "the search for physically possible link parameters did not come to an end"
        raise NotConformant(
            f"{none if str(found.status).endswith('PrimalInfeasible') else unsure}; expected the CAD to be near: check the URDF's "
            "masses and inertias, and the torque's unit with `stopset inspect --robot`"
        )
    theta = np.asarray(d * x)
    theta[: 10 * n] = _repaired(theta[: 10 * n].reshape(n, 10), reference).ravel()
    return theta


def _limits(A: Array, lower: Array, upper: Array) -> tuple[Array, Array]:
    """Rows and right-hand sides of ``lower <= A x <= upper`` as ``rows x <= rhs``, each row of largest entry 1."""
    size = np.maximum(np.abs(A).max(axis=1, initial=0.0), 1e-300)
    below, above = np.isfinite(lower), np.isfinite(upper)
    rows = np.vstack([-A[below] / size[below, None], A[above] / size[above, None]])
    return rows, np.concatenate([-lower[below] / size[below], upper[above] / size[above]])


def _stacked(J: Array) -> Array:
    """The upper triangle of a symmetric matrix by columns, off its diagonal times sqrt(2): lengths are those of the matrix."""
    return np.array([J[i, k] * (1.0 if i == k else np.sqrt(2.0)) for i, k in _UPPER])


def _repaired(pi: Array, reference: Array) -> Array:
    """Each link moved towards the CAD by the least part that makes it a possible body (what a solver's tolerance left)."""
    out = pi.copy()
    for i, (p, r) in enumerate(zip(pi, reference, strict=True)):
        lo, hi = 0.0, 1.0
        if consistent(p[None], r[None]):
            continue
        for _ in range(40):
            mid = 0.5 * (lo + hi)
            lo, hi = (lo, mid) if consistent((p + mid * (r - p))[None], r[None]) else (mid, hi)
        out[i] = p + hi * (r - p)
    return out
