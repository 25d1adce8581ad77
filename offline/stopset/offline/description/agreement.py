"""The core held to pinocchio on the very arm that is identified: two dynamics that share no line must agree.

A frame misplaced, a side branch forgotten or an inertia about the wrong point makes a model that fits its recordings and is wrong
about gravity and stops.  Asked at every identification, on random states over the joints' ranges.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from typing import Any

import numpy as np

from stopset.errors import RobotError
from stopset.offline.description.read import read_tree
from stopset.offline.description.reduce import library, reduced
from stopset.robot import Robot
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


def held_to_pinocchio(robot: Robot) -> Agreement:
    """How far the core's torques of ``robot`` as described lie from pinocchio's of the same description.

    Raises `RobotError` where the two differ by more than rounding.
    """
    pinocchio = library()
    robot = robot.as_described
    tree = read_tree(robot.urdf, robot.datasheet, robot.name)
    model = reduced(ET.tostring(tree.root, encoding="unicode"), tree.outline, tree.held).model
    model.gravity.linear = np.array(robot.chain.gravity)
    rng = np.random.default_rng(0)
    lo, hi = np.clip(robot.q_limit, -np.pi, np.pi).T
    q = rng.uniform(np.minimum(lo, hi), hi, (STATES, robot.n))
    dq, ddq = FAST * rng.normal(size=(2, STATES, robot.n))
    ours = torques(robot.chain, robot.pi, q, dq, ddq)
    data = model.createData()
    theirs = np.array([pinocchio.rnea(model, data, _configuration(pinocchio, model, q[k]), dq[k], ddq[k]) for k in range(STATES)])
    difference = np.abs(ours - theirs).max(axis=0)
    worst = int(np.argmax(difference))
    if difference[worst] > AGREES * float(np.abs(theirs).max()):
        raise RobotError(
            f"the description of {robot.name} is taken in two ways: at {robot.joints[worst]} torques differ by {difference[worst]:.3g} N m from "
            "pinocchio's; expected both to agree to rounding: look for frames or inertias that only one of them knows, or report this URDF"
        )
    return Agreement(f"pinocchio {pinocchio.__version__}", STATES, float(f"{difference[worst]:.1g}"))


def _configuration(pinocchio: Any, model: Any, q: Array) -> Array:
    """pinocchio's configuration (nq,): a joint that turns on is its cosine and sine there."""
    return np.asarray(pinocchio.integrate(model, pinocchio.neutral(model), q))
