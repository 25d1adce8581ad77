"""The description is read twice, by two libraries: they agree on every kind of URDF, and a misread frame makes no model."""

from __future__ import annotations

import sys
from dataclasses import replace

import pytest
from stopset.offline.identify.second_reading import AGREES, read_again

from stopset.errors import RobotError
from stopset.offline.description import load_robot, robot_from_text
from stopset.offline.identify import second_reading
from stopset.robot import Robot

pytest.importorskip("pinocchio")


def link(name: str, mass: float) -> str:
    return (
        f'<link name="{name}"><inertial><origin xyz="0.02 -0.01 0.1" rpy="0.1 0.2 0.3"/><mass value="{mass}"/>'
        '<inertia ixx="0.03" iyy="0.02" izz="0.01" ixy="0.001" ixz="-0.002" iyz="0.003"/></inertial></link>'
    )


def joint(name: str, kind: str, parent: str, child: str) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><origin xyz="0.1 0 0.3" rpy="0.4 0 1.1"/>'
        '<axis xyz="0 0.6 0.8"/><limit lower="-2" upper="2" effort="50" velocity="2"/></joint>'
    )


# a turned base, a continuous joint, a camera beside the chain, two fingers
ARM = (
    '<robot name="branches"><link name="world"/>'
    + "".join(link(name, 1.0 + k) for k, name in enumerate(("base", "upper", "lower", "camera", "hand", "left", "right")))
    + joint("mount", "fixed", "world", "base")
    + joint("shoulder", "continuous", "base", "upper")
    + joint("elbow", "revolute", "upper", "lower")
    + joint("bracket", "fixed", "upper", "camera")
    + joint("flange", "fixed", "lower", "hand")
    + joint("finger_1", "prismatic", "hand", "left")
    + joint("finger_2", "revolute", "hand", "right")
    + "</robot>"
)


@pytest.mark.parametrize("robot", [
    load_robot("lwa4p"),
    robot_from_text(ARM, {"locked": ["finger_2"]}),
    robot_from_text(ARM, {"locked": ["finger_2", "shoulder"]}),
    robot_from_text(ARM, {"tip": "lower", "gravity": [0.0, 6.9, -6.9]}),
])  # fmt: skip
def test_two_readers_agree(robot: Robot) -> None:
    told = read_again(robot)
    assert told is not None and told.by.startswith("pinocchio") and told.states >= 50
    assert 0.0 <= told.largest_Nm < AGREES
    # what was identified since is not the description
    assert read_again(robot.with_parameters(1.3 * robot.pi)) == told


@pytest.mark.parametrize("what", ["frame", "branch", "axis"])
def test_a_description_misread_makes_no_model(monkeypatch: pytest.MonkeyPatch, what: str) -> None:
    right = robot_from_text(ARM, {"locked": ["finger_2"]})

    def misread(*_: object) -> Robot:
        p, axis, pi = right.chain.p.copy(), right.chain.axis.copy(), right.pi.copy()
        if what == "frame":
            p[1, 0] += 1e-6
        elif what == "axis":
            axis[1] *= -1.0
        else:
            pi[1, 0] -= 1e-6
        return replace(right, chain=right.chain._replace(p=p, axis=axis), pi=pi)

    monkeypatch.setattr(second_reading, "robot_from_text", misread)
    with pytest.raises(RobotError, match=r"read in two ways: at \w+ torques differ by .* expected both to agree"):
        read_again(right)


def test_without_pinocchio_it_is_said_and_nothing_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pinocchio", None)
    assert read_again(load_robot("lwa4p")) is None
