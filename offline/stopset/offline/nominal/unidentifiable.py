"""What the data leave open: parameters no motion of these recordings told, kept where they were before.

Two kinds are told apart: what no joint torque can ever show (the mass of a link turning about a vertical axis), which
is harmless because no prediction needs it, and what other motions would show, which is a gap.
"""

from __future__ import annotations

import numpy as np

from stopset.offline.nominal.fit import Fit
from stopset.offline.nominal.normal_equations import DELAYS, NormalEquations
from stopset.offline.nominal.prior import Prior
from stopset.robot import Robot
from stopset.robot.rigid import regressors
from stopset.types import Array

PARAMETERS = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
OPEN = 0.9  # a parameter whose variance fell by less than a tenth was not told
NOTABLE = 0.05  # of the joint's torque, root mean square: friction terms uncertain by more are called undetermined
UNSEEN = 1e-6  # root mean square of a friction column that never was excited
RANK = 1e-8  # relative singular value: below it a combination of parameters has no effect on any torque


def base_directions(robot: Robot, samples: int = 300) -> Array:
    """(10 n, r) orthonormal combinations of link parameters, scaled, that joint torques can show at all.

    Scaled: multiply a parameter error by `parameter_scale` first.  Source: Gautier & Khalil (1990).
    """
    rng = np.random.default_rng(0)
    n = robot.n
    q, dq, ddq = rng.uniform(-np.pi, np.pi, (samples, n)), rng.normal(size=(samples, n)), rng.normal(size=(samples, n))
    Y = regressors(robot.chain, q, 2 * dq, 5 * ddq).reshape(-1, 10 * n) * parameter_scale(robot)
    _, s, Vt = np.linalg.svd(Y, full_matrices=False)
    return np.ascontiguousarray(Vt[s > RANK * s[0]].T)


def parameter_scale(robot: Robot) -> Array:
    """(10 n,) natural size of each link parameter: mass of the arm, times a length, times its square."""
    mass = float(robot.pi[:, 0].max())
    length = max(float(np.abs(robot.chain.p).max()), 0.1)
    return np.tile(np.r_[mass, [mass * length] * 3, [mass * length**2] * 6], robot.n)


def base_count(robot: Robot) -> int:
    """Number of base parameters: combinations of link parameters that joint torques can show."""
    return int(base_directions(robot).shape[1])


def determined(robot: Robot, precision: Array, covariance: Array, ratio: float = OPEN) -> tuple[int, int]:
    """How many base parameters the data told (variance fell below ``ratio`` of the prior's), of how many there are."""
    n = robot.n
    V = base_directions(robot) / parameter_scale(robot)[:, None]  # functionals of pi
    before = V.T @ np.linalg.inv(precision[: 10 * n, : 10 * n]) @ V
    after = V.T @ covariance[: 10 * n, : 10 * n] @ V
    L = np.linalg.cholesky(before + 1e-12 * np.trace(before) * np.eye(len(before)))
    W = np.linalg.solve(L, np.linalg.solve(L, after).T)
    left = np.linalg.eigvalsh(0.5 * (W + W.T))
    return int(np.sum(left < ratio)), len(left)


def left_at_prior(robot: Robot, precision: Array, covariance: Array) -> dict[str, list[str]]:
    """By joint, the link parameters that torques could show but these data did not: their variance is still the prior's."""
    n = robot.n
    V = base_directions(robot)
    seen = np.sqrt(np.sum(V**2, axis=1))  # 0: no torque depends on it alone
    before = np.diag(np.linalg.inv(precision[: 10 * n, : 10 * n]))
    left = np.diag(covariance)[: 10 * n] / before
    out: dict[str, list[str]] = {}
    for k in np.flatnonzero((seen > 0.3) & (left > OPEN)):
        out.setdefault(robot.joints[k // 10], []).append(PARAMETERS[k % 10])
    return out


def undetermined(robot: Robot, data: NormalEquations, prior: Prior, result: Fit) -> tuple[str, ...]:
    """Sentences on what stayed open and where it was kept."""
    out: list[str] = []
    n = robot.n
    stays = ["the data sheet's" if known else "zero, as no data sheet (robot.json) states one" for known in prior.rotor_known]
    for j, joint in enumerate(robot.joints):
        if data.rows_moving[:, j].sum() == 0:
            out.append(f"{joint}: no sample in motion; friction kept at zero, its rotor inertia at {stays[j]}")
    known, count = determined(robot, result.precision, result.covariance)
    if known < count:
        left = left_at_prior(robot, result.precision, result.covariance)
        of = "; ".join(f"{joint}: {', '.join(p)}" for joint, p in left.items())
        out.append(
            f"{count - known} of {count} base parameters of the links stayed at the CAD, these motions do not show them"
            + (f" ({of})" if of else "")
        )
    std = np.sqrt(np.diag(result.covariance))
    for j in range(n):
        if data.rows_moving[:, j].sum() == 0:
            continue
        if std[10 * n + j] ** 2 * result.precision[10 * n + j, 10 * n + j] > OPEN:
            out.append(f"{robot.joints[j]}: rotor inertia kept at {stays[j]}: too little acceleration")
    return (*out, *_friction(data, result, std))


def _friction(data: NormalEquations, result: Fit, std: Array) -> list[str]:
    """Friction terms that never showed, or whose error is a notable torque: a small term known to be small is no gap."""
    out: list[str] = []
    layout, n = data.layout, data.layout.n
    names = layout.names()
    middle = len(DELAYS) // 2 - len(DELAYS)
    for j in range(n):
        rows = float(data.rows_moving[:, j].sum())
        if rows == 0:
            continue
        G = data.moving[:, j].sum(axis=0)
        torque = np.sqrt(G[middle, middle] / rows)
        for c, k in enumerate(layout.index(j)[10 * n + 1 :]):
            size = np.sqrt(G[10 * n + 1 + c, 10 * n + 1 + c] / rows)
            if size < UNSEEN:
                out.append(f"{names[k]}: these motions never excite it, kept at zero")
            elif std[k] * size > NOTABLE * torque:
                out.append(f"{names[k]} = {result.theta[k]:.4g} +- {std[k]:.2g}: uncertain by {std[k] * size:.2g} N m of torque")
    return out
