"""The robot description read a second time, by pinocchio: two readers and two dynamics that share no line must agree.

A frame misread, a side branch forgotten or an inertia about the wrong point makes a model that fits its recordings and is wrong about
gravity and stops.  Asked at every identification, on random states over the joints' ranges.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from stopset.errors import RobotError
from stopset.robot import Robot
from stopset.robot.arm import robot_from_text
from stopset.robot.rigid import torques
from stopset.types import Array

STATES = 50
AGREES = 1e-9  # of the largest torque: both compute with 53 bits through some hundred operations
FAST = 2.0  # [rad/s], [rad/s^2] of the states


@dataclass(frozen=True, slots=True)
class Agreement:
    """The largest difference [N m] of joint torques on ``states`` random states, and who was asked."""

    by: str
    states: int
    largest_Nm: float


def read_again(robot: Robot) -> Agreement | None:
    """What pinocchio says of the description that ``robot`` was read from; None where it is not installed.

    Raises `RobotError` where the two differ by more than rounding.
    """
    try:
        import pinocchio
    except ImportError:
        return None
    robot = robot_from_text(robot.urdf, robot.datasheet, robot.name)  # as described, whatever was identified since
    arm, places = _reduced(pinocchio, robot)
    rng = np.random.default_rng(0)
    lo, hi = np.clip(robot.q_limit, -np.pi, np.pi).T
    q = rng.uniform(np.minimum(lo, hi), hi, (STATES, robot.n))
    dq, ddq = FAST * rng.normal(size=(2, STATES, robot.n))
    ours = torques(robot.chain, robot.pi, q, dq, ddq)
    theirs, data = np.empty_like(ours), arm.createData()
    for k in range(STATES):
        v, a = np.zeros((2, arm.nv))
        v[places], a[places] = dq[k], ddq[k]
        theirs[k] = np.asarray(pinocchio.rnea(arm, data, _configuration(pinocchio, arm, places, q[k]), v, a))[places]
    apart = np.abs(ours - theirs).max(axis=0)
    worst = int(np.argmax(apart))
    if apart[worst] > AGREES * float(np.abs(theirs).max()):
        raise RobotError(
            f"the description of {robot.name} is read in two ways: at {robot.joints[worst]} torques differ by {apart[worst]:.3g} N m from "
            "pinocchio's reading of the same URDF; expected both to agree to rounding: look for frames or inertias that only one of them "
            "knows, or report this URDF"
        )
    return Agreement(f"pinocchio {pinocchio.__version__}", STATES, float(f"{apart[worst]:.1g}"))


def _reduced(pinocchio: Any, robot: Robot) -> tuple[Any, list[int]]:
    """pinocchio's model with all joints but the robot's locked at zero, and where each joint stands in its speeds."""
    whole = pinocchio.buildModelFromXML(robot.urdf)
    missing = [j for j in robot.joints if not whole.existJointName(j)]
    if missing:
        raise RobotError(f"pinocchio finds no joint {', '.join(missing)} in the description of {robot.name}; mend the URDF")
    locked = [k for k in range(1, whole.njoints) if whole.names[k] not in robot.joints]
    arm = pinocchio.buildReducedModel(whole, locked, pinocchio.neutral(whole)) if locked else whole
    arm.gravity.linear = np.array(robot.chain.gravity)
    return arm, [int(arm.joints[arm.getJointId(j)].idx_v) for j in robot.joints]


def _configuration(pinocchio: Any, arm: Any, places: list[int], q: Array) -> Array:
    """pinocchio's configuration (nq,): a continuous joint is its cosine and sine there."""
    step = np.zeros(arm.nv)
    step[places] = q
    return np.asarray(pinocchio.integrate(arm, pinocchio.neutral(arm), step))
