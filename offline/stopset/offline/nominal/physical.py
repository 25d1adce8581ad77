"""Inertias that a real body can have: every link's pseudo-inertia positive definite, by a conic program.

Source: Wensing, Kim & Slotine (2018), Linear matrix inequalities for physically consistent inertial parameter
identification; the constraint of each link is ``[[trace(I)/2 E - I, h], [h', m]] > 0``.
"""

from __future__ import annotations

import warnings
from contextlib import suppress
from typing import Any

import numpy as np

from stopset.errors import NotConformant
from stopset.offline.nominal.prior import tensor
from stopset.types import Array

MARGIN = 1e-7  # smallest eigenvalue kept, relative to the largest of the CAD's pseudo-inertia


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
    return np.asarray(1 / np.sqrt(np.maximum(np.diag(pseudo_inertia(reference)), 1e-9 * reference[0])))


def _scaled(P: Array, reference: Array) -> Array:
    s = _scale(reference)
    return np.asarray(s[:, None] * pseudo_inertia(P) * s)


def solve_consistent(H: Array, b: Array, A: Array, lower: Array, upper: Array, reference: Array) -> Array:
    """Minimise ``theta' H theta / 2 - b' theta`` with ``lower <= A theta <= upper`` and every link a possible body.

    ``H`` (p, p) positive definite; ``reference`` (n, 10) CAD, for scaling.  Raises `NotConformant` when the solver fails.
    """
    import cvxpy  # a second of import, needed only when the free solution is no body

    cp: Any = cvxpy

    n, p = len(reference), len(b)
    d = 1 / np.sqrt(np.diag(H))  # unit curvature in every parameter
    L = np.linalg.cholesky(d[:, None] * H * d)
    x = cp.Variable(p)
    constraints = []
    for i in range(n):
        s = _scale(reference[i])
        basis = [s[:, None] * pseudo_inertia(e) * s for e in np.eye(10)]
        J = sum(x[10 * i + k] * d[10 * i + k] * basis[k] for k in range(10))
        constraints.append(J - MARGIN * np.eye(4) >> 0)
    As = A * d
    for row, (lo, hi) in enumerate(zip(lower, upper, strict=True)):
        size = float(np.abs(As[row]).max()) or 1.0
        if np.isfinite(lo):
            constraints.append(As[row] @ x / size >= lo / size)
        if np.isfinite(hi):
            constraints.append(As[row] @ x / size <= hi / size)
    y = np.linalg.solve(L, d * b)
    problem = cp.Problem(cp.Minimize(cp.sum_squares(L.T @ x - y)), constraints)
    with warnings.catch_warnings(), suppress(cp.error.SolverError):
        warnings.simplefilter("ignore")  # "may be inaccurate" is dealt with below
        problem.solve(solver=cp.CLARABEL)
    if x.value is None or problem.status not in ("optimal", "optimal_inaccurate"):
        none = "no link parameters are physically possible and meet every limit at once"
        unsure = "the search for physically possible link parameters did not come to an end"
        raise NotConformant(
            f"{none if str(problem.status).startswith('infeasible') else unsure}; expected the CAD to be near: check the URDF's "
            "masses and inertias, and the torque's unit with `stopset inspect --robot`"
        )
    theta = np.asarray(d * x.value)
    theta[: 10 * n] = _repaired(theta[: 10 * n].reshape(n, 10), reference).ravel()
    return theta


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
