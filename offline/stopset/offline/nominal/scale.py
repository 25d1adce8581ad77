"""How large the measured torque is against the robot's own model: the question before any identification."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stopset.effects.base import Part
from stopset.offline.nominal.delay import joint_reduced, lag_weights
from stopset.offline.nominal.normal_equations import TOGETHER, NormalEquations
from stopset.robot import Robot
from stopset.types import Array

LAWS: tuple[Part, Part] = ("dry friction", "damping")
PULL = 1e-6  # of columns scaled to one, which hold of the rigid body what one joint cannot tell apart
SHARE = 0.3  # least part of the torque, root mean square, that the rigid body must make up


def torque_scales(robot: Robot, data: NormalEquations) -> tuple[Array, Array]:
    """(n,), (n,): measured over modelled rigid-body torque (CAD, data sheet), and its standard error.

    Friction is fitted beside it.  ``nan`` where a joint feels no load or did not move.
    """
    n = robot.n
    theta = np.concatenate([robot.pi.ravel(), robot.rotor])
    scale, std = np.full(n, np.nan), np.full(n, np.inf)
    lags = lag_weights(0.0)
    for j in range(n):
        G = joint_reduced(data.moving[:, j].sum(axis=0), lags) + joint_reduced(data.still[j], lags)
        rows = float(data.rows_moving[:, j].sum() + data.rows_still[j])
        index = data.layout.index(j)
        head, own = 10 * n + 1, len(index)
        known = bool(np.isfinite(robot.drives[j].rotor_inertia))
        T = np.zeros((len(G), 1 + own - head + 1 + (not known)))
        T[:head, 0] = theta[index[:head]]
        if not known:  # no data sheet: acceleration may cost anything, the scale is gravity's and the links'
            T[head - 1, -2] = 1.0
        T[head:own, 1 : 1 + own - head] = np.eye(own - head)
        T[-1, -1] = 1.0
        S = T.T @ G @ T
        if rows < 50 or S[0, 0] <= 0:
            continue
        d = 1 / np.sqrt(np.maximum(np.diag(S)[:-1], 1e-12 * np.trace(S)))
        A = d[:, None] * S[:-1, :-1] * d + 1e-9 * np.eye(len(S) - 1)
        x = d * np.linalg.solve(A, d * S[:-1, -1])
        if x[0] ** 2 * S[0, 0] < SHARE**2 * S[-1, -1]:
            continue  # friction is all there is: a gravity-free joint tells nothing of units
        v = np.append(x, -1.0)
        variance = max(float(v @ S @ v), 0.0) / rows * TOGETHER
        scale[j], std[j] = x[0], np.sqrt(variance * np.linalg.inv(A)[0, 0]) * d[0]
    return scale, std


@dataclass(frozen=True, slots=True)
class Rubbing:
    """(n,) each of a joint: ``dry`` friction [N m], what falls or rises with speed at the usual one, ``wet`` [N m], the error ``std`` of both
    together [N m], ``slope`` [N m s/rad] and all of its torque's ``size`` [N m]; ``nan`` where nothing tells."""

    dry: Array
    wet: Array
    std: Array
    slope: Array
    size: Array


def rubbing(robot: Robot, data: NormalEquations) -> Rubbing:
    """Dry and viscous friction of either sign, whatever the links weigh: all of the rigid body is fitted beside it."""
    n, lags = robot.n, lag_weights(0.0)
    dry, wet, slope, size = (np.full(n, np.nan) for _ in range(4))
    std = np.full(n, np.inf)
    for j in range(n):
        rows = float(data.rows_moving[:, j].sum())
        head = 10 * n + 1
        parts = [c.effect.part for c in data.layout.columns[j]]
        if rows < 50 or not set(LAWS) <= set(parts):
            continue
        G = joint_reduced(data.moving[:, j].sum(axis=0), lags)
        at = [*range(head), *(head + parts.index(x) for x in LAWS), len(G) - 1]
        S = G[np.ix_(at, at)]
        d = 1 / np.sqrt(np.maximum(np.diag(S)[:-1], 1e-12 * np.trace(S)))
        inverse = np.linalg.inv(d[:, None] * S[:-1, :-1] * d + PULL * np.eye(len(S) - 1))
        x = d * (inverse @ (d * S[:-1, -1]))
        v = np.append(x, -1.0)
        variance = max(float(v @ S @ v), 0.0) / rows * TOGETHER
        speed = float(np.sqrt(S[-2, -2] / rows))
        usual = np.array([1.0, speed]) * d[-2:]
        dry[j], wet[j], slope[j] = x[-2], speed * x[-1], x[-1]
        std[j] = float(np.sqrt(variance * usual @ inverse[-2:, -2:] @ usual))
        size[j] = float(np.sqrt(S[-1, -1] / rows))
    return Rubbing(dry, wet, std, slope, size)
