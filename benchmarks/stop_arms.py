"""The two arms on which stop bounds are measured, with the stated uncertainty; also used by the tests."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stopset.artifact import Abstraction, Brakes, Domain, Guarantee, Model, UncertaintySets
from stopset.effects.base import Fitted
from stopset.offline.description import load_robot, robot_from_text
from stopset.robot import Robot
from stopset.robot.rigid import mass_matrix
from stopset.sets import Box
from stopset.types import Array

# Universal Robots UR5: kinematics, masses and centres of the maker's public tables, inertias of solid cylinders.
_UR5 = [  # xyz, rpy of the joint; mass, centre, inertia (ixx iyy izz) of the link behind it
    ((0, 0, 0.089159), (0, 0, 0), 3.7, (0, 0, 0), (0.0103, 0.0103, 0.0067)),
    ((0, 0.13585, 0), (0, 1.5707963267948966, 0), 8.393, (0, 0, 0.28), (0.2269, 0.2269, 0.0151)),
    ((0, -0.1197, 0.425), (0, 0, 0), 2.275, (0, 0, 0.25), (0.0494, 0.0494, 0.0041)),
    ((0, 0, 0.39225), (0, 1.5707963267948966, 0), 1.219, (0, 0, 0), (0.1112, 0.1112, 0.2194)),
    ((0, 0.093, 0), (0, 0, 0), 1.219, (0, 0, 0), (0.1112, 0.1112, 0.2194)),
    ((0, 0, 0.09465), (0, 0, 0), 0.1879, (0, 0, 0), (0.0171, 0.0171, 0.0338)),
]
_UR5_AXES = ["0 0 1", "0 1 0", "0 1 0", "0 1 0", "0 0 1", "0 1 0"]


def _ur5_urdf() -> str:
    rows = ['<robot name="ur5_like"><link name="l0"/>']
    for i, (xyz, rpy, mass, centre, (ixx, iyy, izz)) in enumerate(_UR5):
        rows.append(
            f'<link name="l{i + 1}"><inertial><origin xyz="{centre[0]} {centre[1]} {centre[2]}"/><mass value="{mass}"/>'
            f'<inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="joint_{i + 1}" type="revolute"><origin xyz="{xyz[0]} {xyz[1]} {xyz[2]}" '
            f'rpy="{rpy[0]} {rpy[1]} {rpy[2]}"/><parent link="l{i}"/><child link="l{i + 1}"/><axis xyz="{_UR5_AXES[i]}"/>'
            f'<limit lower="-6.2832" upper="6.2832" velocity="3.19" effort="150"/></joint>'
        )
    rows.append(
        '<link name="flange"/><joint name="tool" type="fixed"><origin xyz="0 0.0823 0"/><parent link="l6"/>'
        '<child link="flange"/></joint></robot>'
    )
    return "".join(rows)


def model(
    robot: Robot, rotor: Array, brake: Array, coulomb: Array, viscous: Array, payload: tuple[float, float],
    top_speed: float, tolerance: float = 0.10, delay: tuple[float, float] = (0.015, 0.025),
) -> Model:  # fmt: skip
    """A model with the stop notes' uncertainty: u in +-[2 2 2 .4 .4 .4] N m, q0 +-1 mrad, v0 +-10 mrad/s."""
    n = robot.n
    noise = Box.symmetric(np.r_[np.full(n, 1e-3), np.full(n, 1e-2)])
    sets = UncertaintySets(noise, Box.symmetric([2.0, 2.0, 2.0, 0.4, 0.4, 0.4]), noise, 0.004, 1.0)
    effects = [Fitted("coulomb", j, {"F_c": float(f)}, {"F_c": 0.0}) for j, f in zip(robot.joints, coulomb, strict=True)]
    effects += [Fitted("viscous", j, {"F_v": float(f)}, {"F_v": 0.0}) for j, f in zip(robot.joints, viscous, strict=True)]
    return Model(
        robot=robot, rotor=rotor, effort="motor_torque", effects=tuple(effects),
        abstraction=Abstraction(1, 1, np.eye(n), viscous[:, None]), sets={"powered": sets},
        domain=Domain(Box.symmetric(np.full(n, 2 * np.pi)), Box.symmetric(np.full(n, top_speed)),
                      Box.symmetric(np.full(n, 500.0)), payload=payload),
        guarantee=Guarantee(0, 0, 1.0, 0.95, "a constructed model, no recordings"),
        brakes=Brakes(Box.of((1 - tolerance) * brake, (1 + tolerance) * brake), Box.of(np.full(n, delay[0]),
                      np.full(n, delay[1])), Box.of(np.full(n, delay[0]), np.full(n, delay[1])), "assumed"),
    )  # fmt: skip


def prbt_like(payload: tuple[float, float] = (0.0, 3.0), top_speed: float = 1.26) -> Model:
    """PRBT 6 / LWA-4P: public inertials, assumed rotors and brakes of the stop notes."""
    return model(
        load_robot("lwa4p"), np.array([2.56, 2.56, 1.54, 1.54, 0.30, 0.30]),
        np.array([222.0, 222.0, 106.0, 106.0, 25.0, 12.0]), np.array([15.0, 15.0, 10.0, 8.0, 3.0, 2.0]),
        np.array([5.0, 5.0, 3.0, 3.0, 1.0, 1.0]), payload, top_speed,
    )  # fmt: skip


def shipped(payload: tuple[float, float] = (0.0, 3.0)) -> Model:
    """The arm in the box before anything was measured: brakes and rotors of its data sheet, +-30 %, 15 to 60 ms."""
    arm = prbt_like(payload)
    return replace(arm, brakes=None, rotor=np.array([d.rotor_inertia for d in arm.robot.drives]))


def uncertain_rotors() -> Model:
    """The PRBT-like arm as compensated torque tells it: two opinions on each rotor, 30 % apart, both allowed."""
    arm = prbt_like((0.0, 0.25))
    q = np.zeros(arm.n)  # the middle of the domain, where the identified inertia is compared
    rigid = np.diag(mass_matrix(arm.robot.chain, arm.robot.pi, q))
    seen = np.diag(1.0 / (rigid + 1.3 * arm.rotor))
    viscous = np.array([f.values["F_v"] for f in arm.effects if f.effect == "viscous"])[:, None]
    return replace(arm, effort="compensated_torque", abstraction=Abstraction(1, 1, seen, viscous))


def ur5_like(
    payload: tuple[float, float] = (0.0, 5.0), top_speed: float = 3.19, rotor_scale: float = 0.25,
    delay: tuple[float, float] = (0.015, 0.025),
) -> Model:  # fmt: skip
    """UR5: ``rotor_scale`` 1 is the near-diagonal arm of the stop notes, 0.25 the one no earlier bound could do."""
    return model(
        robot_from_text(_ur5_urdf(), {}, "ur5_like"), rotor_scale * np.array([6.0, 6.0, 6.0, 1.0, 1.0, 1.0]),
        np.array([180.0, 180.0, 180.0, 35.0, 35.0, 35.0]), np.array([15.0, 15.0, 10.0, 3.0, 3.0, 2.0]),
        np.array([5.0, 5.0, 3.0, 1.0, 1.0, 1.0]), payload, top_speed, delay=delay,
    )  # fmt: skip
