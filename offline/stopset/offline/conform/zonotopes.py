"""The torque set U as a zonotope: template generators from the data, their lengths by a linear program.

In a direction ``l`` of the state the tube of a linear model under ``U = c + sum a_i g_i [-1, 1]``, varying in time,
reaches

    l'(int K) c + sum_i a_i int |l' K g_i| + what X0 and V add,

linear in the centre ``c`` and the lengths ``a_i >= 0``.  So the template scaling with the narrowest tube that encloses
the data in all wanted directions is one linear program.  With the axes among the generators a box is one of its points:
a zonotope is never worse, and it is better exactly where joints are disturbed together and a direction across joints
counts, as at the tool.

Source: Liu & Althoff (2018), Sec. IV-C, with template sets in place of intervals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from stopset.artifact import Abstraction
from stopset.errors import NotConformant
from stopset.offline.conform.cooperative import Trial
from stopset.offline.conform.linear import SOLVER_SLACK, STOP_TIME, age_weights
from stopset.reach.flowpipe import discretise
from stopset.sets import Box, Zonotope

Array = NDArray[np.float64]

AVERAGING = 0.2  # [s] torque deviations are averages over a stop's length: momentum balance, no differentiation
FIRST, ROUNDS = 400, 40  # of constraint generation: rows at a time, and how often; the check takes all rows


@dataclass(frozen=True, slots=True)
class Directions:
    """Envelope of the deviations in directions across joints: ``l``: (k, n) applied to positions and to velocities
    alike.

    ``hi``, ``lo``: (H + 1, 2 k), first positions, then velocities, over all window starts.
    """

    l: Array  # noqa: E741 (the mathematics' own name)
    dt: float
    hi: Array
    lo: Array


@dataclass(frozen=True, slots=True)
class ZonotopeFit:
    """``U`` [N m], velocity noise ``V`` (2n,), and the cost (mean tube width over the directions [rad])."""

    U: Zonotope
    V: Box
    cost: float


def torque_deviations(trials: Sequence[Trial], abstraction: Abstraction, dt: float) -> Array:
    """Torque [N m] the model lacks, averaged over `AVERAGING` windows, one row per window (W, n)."""
    n, m = abstraction.n, max(1, round(AVERAGING / dt))
    M = np.linalg.inv(abstraction.Minv)
    rows = []
    for x, u in trials:
        at = np.arange(0, len(x) - m, m)
        gained = (x[at + m, n:] - x[at, n:]) @ M.T
        friction = abstraction.viscous[:, 0] * (x[at + m, :n] - x[at, :n])
        torque = np.array([u[s : s + m].sum(axis=0) * dt for s in at])
        rows.append((gained + friction - torque) / (m * dt))
    return np.vstack(rows)


def template(deviations: Array, abstraction: Abstraction) -> Array:
    """Generators (n, 3n): axes, principal directions of the torque deviations (W, n), and the inertia's columns.

    The last are what an acceleration of one joint alone costs: errors of the mass matrix look like that.
    """
    n = deviations.shape[1]
    scale = deviations.std(axis=0) + 1e-12
    principal = np.linalg.svd((deviations - deviations.mean(axis=0)) / scale, full_matrices=False)[2].T * scale[:, None]
    inertia = np.linalg.inv(abstraction.Minv)
    G = np.hstack([np.eye(n), principal, inertia])
    return np.asarray(G / np.linalg.norm(G, axis=0))


def directions(trials: Sequence[Trial], abstraction: Abstraction, l: Array, dt: float, steps: int, every: int) -> Directions:  # noqa: E741
    """Envelope over window starts ``every`` so many samples (and all trials) in the directions ``l`` (k, n)."""
    Ad, Bd = discretise(abstraction, dt)
    k, n = l.shape
    project = np.zeros((2 * k, 2 * n))
    project[:k, :n], project[k:, n:] = l, l
    hi, lo = np.full((steps + 1, 2 * k), -np.inf), np.full((steps + 1, 2 * k), np.inf)
    hi[0] = lo[0] = 0.0
    for x, u in trials:
        residual = x[1:] - x[:-1] @ Ad.T - u[:-1] @ Bd.T
        at = np.arange(0, len(residual), every)
        e = np.zeros((len(at), 2 * n))
        for h in range(1, min(steps, len(residual)) + 1):
            live = at + h <= len(residual)
            at, e = at[live], e[live] @ Ad.T
            e += residual[at + h - 1]
            seen = e @ project.T
            hi[h], lo[h] = np.maximum(hi[h], seen.max(axis=0)), np.minimum(lo[h], seen.min(axis=0))
    return Directions(l, dt, hi, lo)


def reach(abstraction: Abstraction, l: Array, G: Array, dt: float, steps: int) -> tuple[Array, Array, Array]:  # noqa: E741
    """Per age and direction: ``E1`` rows (H+1, 2k, 2n), ``int K`` rows (H+1, 2k, n), ``int |K g_i|`` (H+1, 2k, m)."""
    Ad, Bd = discretise(abstraction, dt)
    k, n = l.shape
    rows = np.zeros((2 * k, 2 * n))
    rows[:k, :n], rows[k:, n:] = l, l
    E1 = np.empty((steps + 1, 2 * k, 2 * n))
    middle, size = np.zeros((steps + 1, 2 * k, n)), np.zeros((steps + 1, 2 * k, G.shape[1]))
    E1[0] = rows
    B = abstraction.B
    for h in range(steps):
        E1[h + 1] = E1[h] @ Ad
        whole = E1[h] @ Bd
        a, b, total = E1[h] @ B @ G, E1[h + 1] @ B @ G, whole @ G
        # exact where l'K g keeps its sign within the step, covered by its larger end where not
        turning = np.maximum(np.abs(total), dt * np.maximum(np.abs(a), np.abs(b)))
        middle[h + 1] = middle[h] + whole
        size[h + 1] = size[h] + np.where(a * b >= 0.0, np.abs(total), turning)
    return E1, middle, size


def fit_zonotope(seen: Directions, abstraction: Abstraction, G: Array, noise: Box) -> ZonotopeFit:
    """Lengths of the generators ``G`` (n, m), centre, and velocity noise, for the narrowest tube that encloses
    ``seen``.

    ``noise`` (2n,): symmetric; V of the angles, and the least V of the speeds.  Raises `NotConformant`.
    """
    n, m, k = abstraction.n, G.shape[1], len(seen.l)
    H = len(seen.hi) - 1
    E1, middle, size = reach(abstraction, seen.l, G, seen.dt, H)
    across = np.abs(seen.l)
    # the start is a reading too: X0 = -V, symmetric; angles by their noise, speeds by what V is found to be
    spread = np.abs(E1[:, :, :n]) @ noise.hi[:n]
    spread[:, :k] += across @ noise.hi[:n]
    wide = np.abs(E1[:, :, n:])
    wide[:, k:] += across
    importance = age_weights(H, seen.dt)
    weight = np.where(np.arange(2 * k) < k, 1.0, STOP_TIME) / k
    price = 2.0 * np.einsum("h,hki,k->i", importance, size[1:], weight)
    noisy_price = 2.0 * np.einsum("h,hki,k->i", importance, wide[1:], weight)
    cost = np.concatenate([np.zeros(n), price + 1e-9 * price.max(), noisy_price])

    def rows(ages: NDArray[np.int64]) -> tuple[Array, Array]:
        top = np.concatenate([middle[ages], size[ages], wide[ages]], axis=2).reshape(-1, n + m + n)
        bottom = np.concatenate([-middle[ages], size[ages], wide[ages]], axis=2).reshape(-1, n + m + n)
        need = np.concatenate([(seen.hi[ages] - spread[ages]).ravel(), (-seen.lo[ages] - spread[ages]).ravel()])
        return np.vstack([top, bottom]), need

    bounds: list[tuple[float | None, float | None]] = [(None, None)] * n + [(0.0, None)] * m
    bounds += [(v, None) for v in noise.hi[n:].tolist()]
    A, b = rows(np.arange(1, H + 1))
    scale = np.maximum(np.abs(A).max(axis=1), 1e-12)
    unit, need = A / scale[:, None], b / scale + SOLVER_SLACK
    chosen = np.unique(np.linspace(0, len(need) - 1, FIRST).astype(int))
    for _ in range(ROUNDS):
        result = linprog(cost, A_ub=-unit[chosen], b_ub=-need[chosen], bounds=bounds, method="highs-ds")
        if result.status != 0:
            raise NotConformant(f"no zonotope encloses the data ({result.message.splitlines()[0].strip()}); check the signals")
        z = np.asarray(result.x)
        short = need - unit @ z
        new = np.setdiff1d(np.flatnonzero(short > SOLVER_SLACK), chosen)
        if not len(new):
            break
        chosen = np.union1d(chosen, new[np.argsort(-short[new])[:FIRST]])
    centre = np.concatenate([z[:n], np.zeros(m + n)])
    radius = A @ (z - centre)
    factor = max(1.0, float(((b - A @ centre) / np.maximum(radius, 1e-300)).max())) * (1.0 + 1e-12)
    lengths, V = factor * z[n : n + m], factor * z[n + m :]
    used = lengths > 1e-9 * max(float(lengths.max()), 1e-300)
    return ZonotopeFit(
        Zonotope(z[:n].copy(), G[:, used] * lengths[used]),
        Box.symmetric(np.concatenate([noise.hi[:n], V])),
        factor * float(cost @ z),
    )
