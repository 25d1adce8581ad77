"""Point-to-point motions: straight in joint space, as fast as speed and torque limits allow, or slower on purpose.

The time-optimal law of toppra switches its torques abruptly; a moving average of the way over time takes the edges off
and stays on the path.  toppra holds the limits at grid points only, so every motion is checked densely and slowed where
it exceeds them.

Source: Pham & Pham (2018), TOPP-RA.
"""

from __future__ import annotations

import numpy as np

from stopset.errors import RobotError
from stopset.offline.nominal.preprocess import derivative
from stopset.offline.plan.motion import MotionLimits, PlannedMotion, fitted, heights
from stopset.robot import Robot
from stopset.robot.rigid import gravity_torques, torque
from stopset.types import Array

GRID = 60
SMOOTH = 0.08  # [s] length of the moving average
HOLDABLE = 0.9  # of the allowed torque that gravity and friction may take on the way: the rest accelerates
LEAST_TRAVEL = 0.6  # [rad] that some joint moves, or the motion is not worth its time


def random_goals(robot: Robot, e: MotionLimits, count: int, rng: np.random.Generator) -> Array:
    """(count + 1, n) uniformly random corners of a chain of motions, from the middle on where that is admissible.

    Gravity can be held on every way between them, and no way leads below the floor, if there is one.
    Raises `RobotError` if there is no such way.
    """
    middle = e.q.mean(axis=1)
    goals = [middle] if _admissible(robot, e, middle[None]) else []
    tries = 0
    while len(goals) < count + 1 and tries < 1000 * count:
        tries += 1
        q = rng.uniform(e.q[:, 0], e.q[:, 1])
        if not goals:
            goals = [q] if _admissible(robot, e, q[None]) else []
            continue
        line = goals[-1] + np.linspace(0, 1, 24)[:, None] * (q - goals[-1])
        if np.abs(q - goals[-1]).max() >= LEAST_TRAVEL and _admissible(robot, e, line):
            goals.append(q)
    if len(goals) < 2:
        raise RobotError(
            f"{robot.name}: none of {tries} random ways can be held by its drives and stays above the floor; expected some: lower "
            "--floor or raise --torque"
        )
    return np.array(goals)


def _admissible(robot: Robot, e: MotionLimits, q: Array) -> bool:
    """Whether gravity can be held at all poses ``q`` (N, n), and all are above the floor."""
    held = np.abs(gravity_torques(robot.chain, robot.pi, q)) + e.friction <= HOLDABLE * e.tau
    return bool(held.all()) and (e.floor is None or float(heights(robot, q).min()) >= e.floor)


def ptp(robot: Robot, e: MotionLimits, start: Array, goal: Array, rate: float) -> PlannedMotion:
    """The fastest smooth straight motion from ``start`` to ``goal`` (n,) within the envelope."""
    law = _fastest(robot, e, start, goal)
    t = np.arange(0.0, law[0][-1] + SMOOTH + 0.5 / rate, 1 / rate)
    s = np.interp(t - 0.5 * SMOOTH, *law)
    width = max(3, round(SMOOTH * rate))
    kernel = np.convolve(np.ones(width) / width, np.ones(width) / width)  # twice: continuous acceleration
    pad = len(kernel)
    s = np.convolve(np.concatenate([np.zeros(pad), s, np.ones(pad)]), kernel, mode="valid")
    h = 1 / rate
    inner = np.flatnonzero((s > 1e-9) & (s < 1 - 1e-9))
    s = np.clip(s[max(inner[0] - 1, 0) : inner[-1] + 2], 0.0, 1.0)[:, None]
    ds = derivative(s, h)
    dds = derivative(ds, h)
    displacement = goal - start
    return fitted(
        robot,
        e,
        PlannedMotion(h * np.arange(len(s), dtype=np.float64), start + s * displacement, ds * displacement, dds * displacement),
    )


def _fastest(robot: Robot, e: MotionLimits, start: Array, goal: Array) -> tuple[Array, Array]:
    """(t, s): way parameter over time, time-optimal by toppra."""
    import toppra
    from toppra import algorithm, constraint

    toppra.setup_logging("CRITICAL")
    path = toppra.SplineInterpolator([0.0, 1.0], np.array([start, goal]))

    def inverse(q: Array, v: Array, a: Array) -> Array:
        x = [np.ascontiguousarray(y, dtype=float) for y in (q, v, a)]
        return np.asarray(torque(robot.chain, robot.pi, *x) + robot.rotor * x[2])

    limits = [constraint.JointVelocityConstraint(np.column_stack([-e.dq, e.dq]))]
    tau = np.where(np.isfinite(e.tau), np.maximum(e.tau - e.friction, 1e-3), 1e6)
    limits.append(constraint.JointTorqueConstraint(inverse, np.column_stack([-tau, tau]), np.zeros(robot.n)))
    # without torque limits nothing bounds the acceleration: top speed is then reached in a third of a second
    if not np.isfinite(e.tau).all():
        limits.append(constraint.JointAccelerationConstraint(np.column_stack([-3 * e.dq, 3 * e.dq])))
    solver = algorithm.TOPPRA(limits, path, gridpoints=np.linspace(0, 1, GRID + 1), parametrizer="ParametrizeConstAccel")
    _, speed, _ = solver.compute_parameterization(0, 0)
    if speed is None or not np.isfinite(speed).all():
        # gravity nearly at the limit somewhere: a gentle law of five seconds, slowed by `fitted` if need be
        t = np.linspace(0, 5, 101)
        u = t / 5
        return t, u**3 * (10 - 15 * u + 6 * u**2)
    grid = np.linspace(0, 1, GRID + 1)
    dt = 2 * np.diff(grid) / np.maximum(speed[1:] + speed[:-1], 1e-6)
    knots = np.r_[0.0, np.cumsum(dt)]
    # constant acceleration between grid points
    t = np.linspace(0, knots[-1], 20 * GRID)
    k = np.clip(np.searchsorted(knots, t, side="right") - 1, 0, GRID - 1)
    a = (speed[k + 1] ** 2 - speed[k] ** 2) / (2 * (grid[k + 1] - grid[k]))
    d = t - knots[k]
    return t, np.clip(grid[k] + speed[k] * d + 0.5 * a * d * d, 0.0, 1.0)
