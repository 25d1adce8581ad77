"""Least squares under linear limits: friction that never pushes, parameters inside their admissible ranges."""

from __future__ import annotations

import numpy as np

from stopset.errors import NotConformant
from stopset.types import Array

TOLERANCE = 1e-9  # of the scaled rows: what may be left over after the exact active-set step


def solve_qp(H: Array, b: Array, A: Array, lower: Array, upper: Array) -> tuple[Array, Array]:
    """Minimise ``theta' H theta / 2 - b' theta`` with ``lower <= A theta <= upper``; returns (theta, active rows).

    The first-order solver finds the active rows, a linear solve then meets them to rounding: its own tolerance would
    leave friction that pushes a little.  Source: Stellato et al. (2020), OSQP.
    """
    d: Array = np.asarray(1 / np.sqrt(np.diag(H)), np.float64)
    Hs, bs = d[:, None] * H * d, d * b
    x: Array = np.asarray(np.linalg.solve(Hs, bs), np.float64)
    As = A * d
    size = np.abs(As).max(axis=1, initial=0.0)
    rows = size > 0
    As, lo, hi = As[rows] / size[rows, None], lower[rows] / size[rows], upper[rows] / size[rows]
    active = np.zeros(len(A), bool)
    if not _violated(As, lo, hi, x).any():
        return d * x, active
    # the solver works at a solution of size one; a limit a million times beyond it is none, and spoils its scaling
    f = float(np.abs(x).max()) or 1.0
    l1, h1 = np.where(lo < -1e6 * f, -np.inf, lo / f), np.where(hi > 1e6 * f, np.inf, hi / f)
    ends = {k: (float(lo[k] if side > 0 else hi[k]), side) for k, side in _active(Hs, bs / f, As, l1, h1).items()}
    # where rows are badly scaled the solver's last digits may end on a side that is open
    at = {k: x for k, x in ends.items() if np.isfinite(x[0])}
    for _ in range(3 * len(lo) + 10):
        x, multiplier = _equality(Hs, bs, As, at)
        bad = _violated(As, lo, hi, x)
        wrong = [k for k, (m, (_, side)) in enumerate(zip(multiplier, at.items(), strict=True)) if m * side[1] < -TOLERANCE]
        if bad.any():
            k = int(np.argmax(np.maximum(lo - As @ x, As @ x - hi)))
            low = lo[k] - As[k] @ x > 0
            at[k] = (float(lo[k] if low else hi[k]), 1.0 if low else -1.0)
        elif wrong:
            at.pop(list(at)[wrong[0]])
        else:
            active[np.flatnonzero(rows)[list(at)]] = True
            return d * x, active
    # rows that nearly depend on one another lead the exchange of active rows in circles: from inside there are none
    inside = _from_inside(Hs, bs / f, As, l1, h1)
    if inside is not None and not _violated(As, lo, hi, f * inside).any():
        near = np.minimum(np.abs(As @ inside - l1), np.abs(h1 - As @ inside)) < 1e-6
        active[np.flatnonzero(rows)[near]] = True
        return d * (f * inside), active
    raise NotConformant(
        "the limits on friction and inertia contradict each other in these data; expected a solution: leave effects out"
    )


def _violated(A: Array, lo: Array, hi: Array, x: Array) -> Array:
    v = A @ x
    left = TOLERANCE * max(1.0, float(np.abs(x).max(initial=0.0)))
    return np.asarray((v < lo - left) | (v > hi + left))


def _active(H: Array, b: Array, A: Array, lo: Array, hi: Array) -> dict[int, float]:
    """Rows that the solver ends on, with their side (+1 lower, -1 upper); none when it does not converge."""
    import osqp
    from scipy import sparse

    if np.any(lo > hi) or not all(np.isfinite(x).all() for x in (H, b, A)):
        return {}  # nothing that a solver takes: it would say so on the terminal
    problem = osqp.OSQP()
    problem.setup(
        sparse.csc_matrix(np.triu(H)), -b, sparse.csc_matrix(A), lo, hi,
        verbose=False, eps_abs=1e-8, eps_rel=1e-8, max_iter=20_000, polishing=True,
    )  # fmt: skip
    result = problem.solve(raise_error=False)
    y = np.asarray(result.y, np.float64)
    if result.info.status_val not in (1, 2) or not np.isfinite(y).all():
        return {}  # the caller adds violated rows one by one
    scale = float(np.abs(y).max(initial=0.0))
    return {int(k): (1.0 if y[k] < 0 else -1.0) for k in np.flatnonzero(np.abs(y) > 1e-6 * scale)}


def _from_inside(H: Array, b: Array, A: Array, lo: Array, hi: Array) -> Array | None:
    """The minimiser by an interior-point method, None where it does not converge.  Source: Goulart & Chen (2024), Clarabel."""
    import clarabel
    from scipy import sparse

    low, high = np.isfinite(lo), np.isfinite(hi)
    G, h = np.vstack([A[high], -A[low]]), np.concatenate([hi[high], -lo[low]])
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_feas = settings.tol_gap_abs = settings.tol_gap_rel = 1e-11
    cones = [clarabel.NonnegativeConeT(len(h))]
    found = clarabel.DefaultSolver(sparse.csc_matrix(np.triu(H)), -b, sparse.csc_matrix(G), h, cones, settings).solve()
    return np.asarray(found.x, np.float64) if str(found.status) in ("Solved", "AlmostSolved") else None


def _equality(H: Array, b: Array, A: Array, at: dict[int, tuple[float, float]]) -> tuple[Array, Array]:
    """Minimiser with the rows ``at`` met exactly, and the multipliers (positive: the limit pushes up)."""
    k = list(at)
    if not k:
        return np.asarray(np.linalg.solve(H, b), np.float64), np.zeros(0)
    E, e = A[k], np.array([at[i][0] for i in k])
    W: Array = np.asarray(np.linalg.solve(H, np.column_stack([E.T, b])), np.float64)
    S, r = E @ W[:, :-1], e - E @ W[:, -1]
    multiplier = np.linalg.lstsq(S, r, rcond=1e-12)[0]
    return np.asarray(W[:, -1] + W[:, :-1] @ multiplier, np.float64), np.asarray(multiplier, np.float64)
