"""The core is held to pinocchio on the described arm, whatever it is: two dynamics agree, and a misread frame makes no model."""

from __future__ import annotations

from dataclasses import replace

import pytest

from stopset.errors import RobotError
from stopset.offline.description import load_robot, robot_from_text
from stopset.offline.description.agreement import AGREES, held_to_pinocchio
from stopset.robot import Robot
from test_description import ARM, FINGERS

pytest.importorskip("pinocchio")


@pytest.mark.parametrize("robot", [
    load_robot("lwa4p"),
    robot_from_text(ARM, FINGERS),
    robot_from_text(ARM, {"locked": ["finger_1", "finger_2", "shoulder"]}),
    robot_from_text(ARM, {"tip": "lower", "gravity": [0.0, 6.9, -6.9]}),
])  # fmt: skip
def test_the_core_agrees(robot: Robot) -> None:
    reported = held_to_pinocchio(robot)
    assert reported.by.startswith("pinocchio") and reported.states >= 50
    assert 0.0 <= reported.largest_Nm < AGREES
    # what was identified since is not the description
    assert held_to_pinocchio(robot.with_parameters(1.3 * robot.pi)) == reported


@pytest.mark.parametrize("what", ["frame", "branch", "axis"])
def test_a_description_misread_makes_no_model(monkeypatch: pytest.MonkeyPatch, what: str) -> None:
    right = robot_from_text(ARM, FINGERS)
    p, axis, pi = right.arm.p.copy(), right.arm.axis.copy(), right.arm.pi.copy()
    if what == "frame":
        p[1, 0] += 1e-6
    elif what == "axis":
        axis[1] *= -1.0
    else:
        pi[1, 0] -= 1e-6
    with pytest.raises(RobotError, match=r"taken in two ways: at \w+ torques differ by .* expected both to agree"):
        held_to_pinocchio(replace(right, arm=replace(right.arm, p=p, axis=axis, pi=pi)))
