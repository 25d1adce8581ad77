"""Excitation trajectories: Fourier series whose regressor is as well conditioned as the limits allow.

Minimised is the log of the condition number of the base-parameter regressor (rows weighted by torque limit, columns
scaled to natural sizes), rotor inertias included, over amplitudes and phases; every candidate is first scaled into the
limits, so the search never leaves them.

Source: Swevers et al. (1997), Optimal robot excitation and identification; Presse & Gautier (1993).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stopset.offline.nominal.unidentifiable import parameter_scale
from stopset.offline.plan.motion import MotionLimits, PlannedMotion, fitted, heights
from stopset.progress import Progress, silent
from stopset.robot import Robot
from stopset.robot.rigid import regressors
from stopset.types import Array

HARMONICS = 5
SAMPLES = 80  # per candidate in the search
FADE = 1.5  # [s] from rest into the series and back
CENTRES, PROBES = 80, 24  # poses tried as the middle of a series above a floor, and poses around each


def _series(x: Array, period: float, t: Array, n: int) -> tuple[Array, Array, Array]:
    """Position about zero, speed, acceleration of the series with coefficients ``x`` (2 HARMONICS, n)."""
    c = x.reshape(2, HARMONICS, n)
    k = np.arange(1, HARMONICS + 1)
    w = 2 * np.pi * k / period
    s, co = np.sin(np.outer(t, w)), np.cos(np.outer(t, w))
    a, b = c[0] / w[:, None], c[1] / w[:, None]
    return s @ a - co @ b, (co * w) @ a + (s * w) @ b, -(s * w**2) @ a + (co * w**2) @ b


def centre(robot: Robot, e: MotionLimits, rng: np.random.Generator) -> Array:
    """(n,) pose that the series move about: the middle of the ranges, or with a floor the pose with most room above it."""
    middle: Array = np.asarray(e.q.mean(axis=1))
    half = 0.5 * (e.q[:, 1] - e.q[:, 0])
    if e.floor is None:
        return middle
    tried = np.vstack([middle, rng.uniform(middle - 0.7 * half, middle + 0.7 * half, (CENTRES, robot.n))])
    around = rng.uniform(-0.5, 0.5, (PROBES, robot.n))
    around[0] = 0.0

    def room(q: Array) -> float:
        above = heights(robot, q + around * np.minimum(e.q[:, 1] - q, q - e.q[:, 0])) >= (e.floor or 0.0)
        return float(above.mean()) if above[0] else 0.0

    return np.asarray(tried[int(np.argmax([room(q) for q in tried]))])


def _faded(x: Array, period: float, e: MotionLimits, t: Array, middle: Array) -> tuple[Array, Array, Array]:
    """The series about ``middle``, within position and speed limits, blended to rest at both ends (smooth to the acceleration)."""
    n = len(e.dq)
    q, dq, ddq = _series(x, period, t, n)
    u = np.clip(np.minimum(t, t[-1] - t) / FADE, 0.0, 1.0)
    sign = np.where(t < 0.5 * t[-1], 1.0, -1.0)
    f = u**3 * (10 - 15 * u + 6 * u**2)
    df = sign * 30 * u**2 * (1 - u) ** 2 / FADE
    ddf = (60 * u - 180 * u**2 + 120 * u**3) / FADE**2
    f, df, ddf = f[:, None], df[:, None], ddf[:, None]
    q, dq, ddq = f * q, f * dq + df * q, f * ddq + 2 * df * dq + ddf * q
    half = np.minimum(e.q[:, 1] - middle, middle - e.q[:, 0])
    scale = np.minimum(half / np.maximum(np.abs(q).max(axis=0), 1e-9), e.dq / np.maximum(np.abs(dq).max(axis=0), 1e-9))
    return middle + scale * q, scale * dq, scale * ddq


def _above(robot: Robot, e: MotionLimits, p: PlannedMotion, middle: Array) -> PlannedMotion:
    """The same motion, smaller about its ``middle`` until it stays above the floor (if it can)."""
    for _ in range(30):
        if e.floor is None or float(heights(robot, p.q[:: max(1, len(p.q) // 500)]).min()) >= e.floor:
            break
        p = PlannedMotion(p.t, middle + 0.92 * (p.q - middle), 0.92 * p.dq, 0.92 * p.ddq)
    return p


def rows(robot: Robot, q: Array, dq: Array, ddq: Array, weight: Array) -> Array:
    """(N n, 11 n) regressor of link parameters (natural sizes) and rotor inertias, rows times ``weight`` (n,)."""
    n = robot.n
    rotor = np.zeros((len(q), n, n))
    rotor[:, range(n), range(n)] = ddq
    X = np.concatenate([regressors(robot.chain, q, dq, ddq) * parameter_scale(robot), rotor], axis=2)
    return np.asarray((X * weight[:, None]).reshape(-1, 11 * n))


def directions(robot: Robot, e: MotionLimits, weight: Array, rng: np.random.Generator) -> Array:
    """(11 n, r) orthonormal combinations that torques can tell, a rotor beside its own link's inertia counted once."""
    n, N = robot.n, 300
    q = rng.uniform(e.q[:, 0], e.q[:, 1], (N, n))
    dq, ddq = e.dq * rng.uniform(-1, 1, (N, n)), 5 * e.dq * rng.uniform(-1, 1, (N, n))
    _, s, Vt = np.linalg.svd(rows(robot, q, dq, ddq, weight), full_matrices=False)
    return np.ascontiguousarray(Vt[s > 1e-8 * s[0]].T)


def information(robot: Robot, q: Array, dq: Array, ddq: Array, weight: Array, V: Array) -> Array:
    """(r, r) information about the combinations ``V``, per sample."""
    X = rows(robot, q, dq, ddq, weight) @ V
    return np.asarray(X.T @ X / len(q))


def condition(G: Array) -> float:
    """Condition number of the regressor behind an information matrix, columns scaled to unit length."""
    d = 1 / np.sqrt(np.maximum(np.diag(G), 1e-30))
    values = np.linalg.eigvalsh(d[:, None] * G * d)
    return float(np.sqrt(values[-1] / max(values[0], 1e-30)))


@dataclass(frozen=True, slots=True)
class Series:
    """What is asked: ``count`` series of one ``period`` [s] at ``rate`` [1/s], each the best of so many ``evaluations``."""

    count: int
    period: float
    rate: float
    evaluations: int


def excitations(
    robot: Robot,
    e: MotionLimits,
    asked: Series,
    rng: np.random.Generator,
    progress: Progress = silent,
) -> tuple[list[PlannedMotion], float, float]:
    """The trajectories asked for, together as well conditioned as the search finds.

    Returns them with the condition number of all together, and that of the same number of random ones.
    Each next trajectory is optimised for what those before it tell together with it; ``progress`` is given how far the search is.
    """
    n, count, period, evaluations = robot.n, asked.count, asked.period, asked.evaluations
    weight = 1 / np.where(np.isfinite(e.tau), e.tau, 1.0)
    V = directions(robot, e, weight, rng)
    middle = centre(robot, e, rng)
    t = np.linspace(0.0, period, SAMPLES)
    total = np.zeros((V.shape[1], V.shape[1]))
    blind = total.copy()
    paths: list[PlannedMotion] = []

    def cost(x: Array, known: Array) -> tuple[float, Array]:
        q, dq, ddq = _faded(x, period, e, t, middle)
        G = information(robot, q, dq, ddq, weight, V)
        low = 0.0 if e.floor is None else max(e.floor - float(heights(robot, q[::4]).min()), 0.0)
        return np.log(condition(known + G)) + 50 * low, G

    for k in range(count):
        progress(f"excitation {k + 1} of {count}", k / count)
        best, best_cost, first = np.zeros(0), np.inf, None
        tries = max(20, evaluations // 8)
        for _ in range(tries):
            x = rng.normal(size=(2 * HARMONICS, n)).ravel()
            c, G = cost(x, total)
            first = G if first is None else first
            if c < best_cost:
                best, best_cost = x, c
        step = 0.5
        for i in range(evaluations - tries):  # (1+1) evolution with the one-fifth rule: no gradients, no local traps at start
            x = best + step * rng.normal(size=best.shape) * (rng.random(best.shape) < 0.3)
            c, _ = cost(x, total)
            if c < best_cost:
                best, best_cost, step = x, c, min(step * 1.4, 1.0)
            else:
                step = max(step * 0.92, 1e-3)
            if i % 50 == 0:
                progress(f"excitation {k + 1} of {count}", (k + (tries + i) / evaluations) / count)
        total = total + cost(best, total)[1]
        blind = blind + (first if first is not None else 0.0)
        fine = np.arange(0.0, period + 0.5 / asked.rate, 1 / asked.rate)
        paths.append(fitted(robot, e, _above(robot, e, PlannedMotion(fine, *_faded(best, period, e, fine, middle)), middle)))
    return paths, condition(total), condition(blind)
