"""Static poses for gravity: chosen one after the other for what they add, each approached from both sides."""

from __future__ import annotations

import numpy as np

from stopset.errors import RobotError
from stopset.offline.nominal.unidentifiable import parameter_scale
from stopset.offline.plan.motion import MotionLimits, heights
from stopset.robot import Robot
from stopset.robot.rigid import gravity_torques, regressors
from stopset.types import Array

APPROACH = 0.05  # [rad] from below and from above: beyond the pre-sliding range of gears
CANDIDATES = 1500


def static_poses(robot: Robot, e: MotionLimits, count: int, rng: np.random.Generator) -> Array:
    """(count, n) poses, greedily D-optimal for the gravity parameters, holdable and above the floor.

    Source: Swevers et al. (1997); greedy choice after Fedorov (1972).
    """
    low, high = e.q[:, 0] + APPROACH, e.q[:, 1] - APPROACH
    q = rng.uniform(low, high, (CANDIDATES, robot.n))
    hold = (np.abs(gravity_torques(robot.chain, robot.pi, q)) + e.friction <= e.tau).all(axis=1)
    if e.floor is not None:
        hold &= heights(robot, q) >= e.floor
    q = q[hold]
    if not len(q):
        raise RobotError(
            f"{robot.name}: none of {CANDIDATES} random poses can be held by its drives and stays above the floor; expected some: "
            "lower --floor or raise --torque"
        )
    zero = np.zeros_like(q)
    weight = 1 / np.where(np.isfinite(e.tau), e.tau, 1.0)
    Y = regressors(robot.chain, q, zero, zero) * parameter_scale(robot) * weight[:, None]
    s, V = np.linalg.svd(Y.reshape(-1, Y.shape[2]), full_matrices=False)[1:]
    Y = Y @ V[s > 1e-8 * s[0]].T
    P = np.eye(Y.shape[2]) * 1e8 / s[0] ** 2
    chosen: list[int] = []
    for _ in range(min(count, len(q))):
        # gain of each pose: log det(1 + Y P Y')
        gain = np.linalg.slogdet(np.eye(robot.n) + np.einsum("kia,ab,kjb->kij", Y, P, Y))[1]
        gain[chosen] = -np.inf
        k = int(np.argmax(gain))
        chosen.append(k)
        W = P @ Y[k].T
        P = P - W @ np.linalg.solve(np.eye(robot.n) + Y[k] @ W, W.T)
    return np.asarray(q[chosen])
