"""Arms of many kinds on which stop bounds must stay useful: a UR10e, a seven-joint cobot, and arms drawn at random."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from stop_arms import Array, prbt_like, ur5_like

from stopset.artifact import Abstraction, Brakes, Domain, Guarantee, Model, UncertaintySets
from stopset.effects.base import Fitted
from stopset.offline.description import robot_from_text
from stopset.robot.arm import Robot
from stopset.robot.rigid import gravity_torque
from stopset.sets import Box

Rows = list[tuple[tuple[float, ...], tuple[float, ...], str, float, tuple[float, ...], tuple[float, ...]]]

# Universal Robots' public tables of the UR10e: kinematics, masses, centres; inertias of solid cylinders
_H = 1.5707963267948966
_UR10E: Rows = [  # xyz, rpy, axis of the joint; mass, centre, inertia of the link behind it
    ((0, 0, 0.1807), (0, 0, 0), "0 0 1", 7.369, (0.021, 0, 0.027), (0.0341, 0.0353, 0.0216)),
    ((0, 0, 0), (_H, 0, 0), "0 0 1", 13.051, (-0.2327, 0, 0.158), (0.0281, 0.7707, 0.7694)),
    ((-0.6127, 0, 0), (0, 0, 0), "0 0 1", 3.989, (-0.2382, 0, 0.068), (0.0101, 0.3093, 0.3065)),
    ((-0.57155, 0, 0.17415), (0, 0, 0), "0 0 1", 2.1, (0, 0.007, 0.018), (0.0050, 0.0022, 0.0050)),
    ((0, -0.11985, 0), (_H, 0, 0), "0 0 1", 1.98, (0, 0.007, 0.018), (0.0050, 0.0022, 0.0050)),
    ((0, 0.11655, 0), (-_H, 0, 0), "0 0 1", 0.615, (0, 0, -0.026), (0.0005, 0.0005, 0.0006)),
]
# a seven-joint cobot in the proportions of a Franka Emika Panda; masses and inertias rounded from public identifications
_COBOT7: Rows = [
    ((0, 0, 0.333), (0, 0, 0), "0 0 1", 4.97, (0.004, 0.002, -0.17), (0.55, 0.55, 0.01)),
    ((0, 0, 0), (-_H, 0, 0), "0 0 1", 0.65, (-0.003, -0.029, 0.003), (0.008, 0.028, 0.026)),
    ((0, -0.316, 0), (_H, 0, 0), "0 0 1", 3.23, (0.028, 0.039, -0.067), (0.037, 0.036, 0.011)),
    ((0.0825, 0, 0), (_H, 0, 0), "0 0 1", 3.59, (-0.053, 0.104, 0.027), (0.026, 0.020, 0.028)),
    ((-0.0825, 0.384, 0), (-_H, 0, 0), "0 0 1", 1.23, (-0.012, 0.041, -0.038), (0.036, 0.029, 0.009)),
    ((0, 0, 0), (_H, 0, 0), "0 0 1", 1.67, (0.060, -0.014, -0.010), (0.002, 0.004, 0.005)),
    ((0.088, 0, 0), (_H, 0, 0), "0 0 1", 0.74, (0.010, -0.004, 0.062), (0.013, 0.010, 0.005)),
]


def urdf(name: str, rows: Rows, tip: tuple[float, ...], top: Array, effort: Array) -> str:
    """A serial arm of revolute joints."""
    out = [f'<robot name="{name}"><link name="l0"/>']
    for i, (xyz, rpy, axis, mass, centre, (ixx, iyy, izz)) in enumerate(rows):
        words = [" ".join(f"{x:.9g}" for x in v) for v in (xyz, rpy, centre)]
        out.append(
            f'<link name="l{i + 1}"><inertial><origin xyz="{words[2]}"/><mass value="{mass:.9g}"/>'
            f'<inertia ixx="{ixx:.9g}" iyy="{iyy:.9g}" izz="{izz:.9g}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="joint_{i + 1}" type="revolute"><origin xyz="{words[0]}" rpy="{words[1]}"/><parent link="l{i}"/>'
            f'<child link="l{i + 1}"/><axis xyz="{axis}"/><limit lower="-6.2832" upper="6.2832" velocity="{top[i]:.9g}" '
            f'effort="{effort[i]:.9g}"/></joint>'
        )
    out.append(
        f'<link name="flange"/><joint name="tool" type="fixed"><origin xyz="{" ".join(f"{x:.9g}" for x in tip)}"/>'
        f'<parent link="l{len(rows)}"/><child link="flange"/></joint></robot>'
    )
    return "".join(out)


def arm_model(
    robot: Robot, rotor: Array, brake: Array, coulomb: Array, viscous: Array, u: Array, rated: float, top: Array
) -> Model:
    """A model with the relative uncertainty of the reference arms: brakes +-10 %, 15 to 25 ms and again as long to rise."""
    n = robot.n
    noise = Box.symmetric(np.r_[np.full(n, 1e-3), np.full(n, 1e-2)])
    sets = UncertaintySets(noise, Box.symmetric(u), noise, 0.004, 1.0)
    effects = [Fitted("coulomb", j, {"F_c": float(f)}, {"F_c": 0.0}) for j, f in zip(robot.joints, coulomb, strict=True)]
    effects += [Fitted("viscous", j, {"F_v": float(f)}, {"F_v": 0.0}) for j, f in zip(robot.joints, viscous, strict=True)]
    times = Box.of(np.full(n, 0.015), np.full(n, 0.025))
    return Model(
        robot=robot, rotor=rotor, effort="motor_torque", effects=tuple(effects),
        abstraction=Abstraction(1, 1, np.eye(n), viscous[:, None]), sets={"powered": sets},
        domain=Domain(Box.symmetric(np.full(n, 2 * np.pi)), Box.symmetric(top), Box.symmetric(np.full(n, 1e4)), payload=(0.0, rated)),
        guarantee=Guarantee(0, 0, 1.0, 0.95, "a constructed model, no recordings"),
        brakes=Brakes(Box.of(0.9 * brake, 1.1 * brake), times, times, "assumed"),
    )  # fmt: skip


def ur10e_like() -> Model:
    """UR10e with its 12.5 kg: rotors of motors of its size, brakes 1.5 times the joints' largest torque."""
    effort = np.array([330.0, 330.0, 150.0, 56.0, 56.0, 56.0])
    top = np.array([2.09, 2.09, 3.14, 3.14, 3.14, 3.14])
    robot = robot_from_text(urdf("ur10e_like", _UR10E, (0, 0, 0), top, effort), {}, "ur10e_like")
    return arm_model(
        robot, np.array([3.6, 3.6, 1.4, 0.35, 0.35, 0.35]), 1.5 * effort, 0.05 * effort, np.array([12.0, 12.0, 6.0, 1.5, 1.5, 1.5]),
        np.array([2.0, 2.0, 2.0, 0.4, 0.4, 0.4]), 12.5, top,
    )  # fmt: skip


def cobot7_like() -> Model:
    """A light arm of seven joints with 3 kg, strong brakes and little rotor inertia."""
    effort = np.array([87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0])
    top = np.array([2.17, 2.17, 2.17, 2.17, 2.61, 2.61, 2.61])
    robot = robot_from_text(urdf("cobot7_like", _COBOT7, (0, 0, 0.107), top, effort), {}, "cobot7_like")
    return arm_model(
        robot, np.array([0.6, 0.6, 0.45, 0.45, 0.2, 0.2, 0.2]), 1.5 * effort, 0.03 * effort, np.array([2.0, 2.0, 2.0, 2.0, 0.4, 0.4, 0.4]),
        np.array([1.0, 1.0, 1.0, 1.0, 0.2, 0.2, 0.2]), 3.0, top,
    )  # fmt: skip


def random_arm(n: int, seed: int) -> Model:
    """An arm of ``n`` joints: lengths, masses, rotors from light to heavy, brakes from barely holding on."""
    rng = np.random.default_rng([n, seed])
    reach = rng.uniform(0.5, 1.6)
    length = rng.dirichlet(np.full(n, 2.0)) * reach
    mass = rng.uniform(6.0, 12.0) * reach * np.sort(rng.dirichlet(np.full(n, 2.0)))[::-1] * 2.0
    rated = float(rng.uniform(0.1, 0.4) * mass.sum())
    rows: Rows = []
    end = np.array([0.0, 0.0, 0.1])
    for i in range(n):
        along = length[i] * _unit(rng) * np.array([0.3, 0.3, 1.0])
        turn = (0.0, 0.0, 0.0) if i == 0 else tuple(rng.choice([0.0, _H, -_H], p=[0.4, 0.3, 0.3]) * _axis(rng))
        radius = rng.uniform(0.04, 0.08)
        body = np.linalg.norm(along)
        I = mass[i] * np.array([radius**2 / 4 + body**2 / 12, radius**2 / 4 + body**2 / 12, radius**2 / 2])  # noqa: E741
        rows.append(
            (tuple(end), turn, "0 0 1" if i == 0 or rng.random() < 0.5 else "0 1 0", float(mass[i]), tuple(0.5 * along), tuple(I))
        )
        end = along
    top = rng.uniform(1.2, 3.2, n)
    robot = robot_from_text(urdf(f"random_{n}_{seed}", rows, tuple(end), top, np.full(n, 1e3)), {}, f"random_{n}_{seed}")
    # what gravity can ask of each joint with the rated payload, over poses
    pi = robot.pi.copy()
    pi[-1] += rated * np.r_[1.0, robot.tip, 0, 0, 0, 0, 0, 0]
    ask = np.abs([gravity_torque(robot.chain, pi, rng.uniform(-np.pi, np.pi, n)) for _ in range(500)]).max(axis=0)
    ask = np.maximum(ask, 0.3 * np.maximum.accumulate(ask[::-1])[::-1])
    brake = ask * rng.uniform(1.6, 3.0)
    weight = rng.uniform(0.15, 1.5)  # rotor over what it carries: light cobots to heavy geared arms
    carried = np.array([sum(mass[k] * (length[i : k + 1].sum() / 2) ** 2 for k in range(i, n)) for i in range(n)])
    rotor = np.maximum(weight * carried, 0.02)
    return arm_model(robot, rotor, brake, 0.05 * brake, 0.02 * brake, 0.01 * brake, rated, top)


def _unit(rng: np.random.Generator) -> NDArray[np.float64]:
    v = rng.normal(size=3)
    out: Array = v / np.linalg.norm(v)
    return out


def _axis(rng: np.random.Generator) -> NDArray[np.float64]:
    return np.eye(3)[rng.integers(3)]


def arms() -> dict[str, tuple[Model, Array]]:
    """Name: model, top speed [rad/s]."""
    out: dict[str, tuple[Model, Array]] = {
        "PRBT-like": (prbt_like(), np.full(6, 1.26)),
        "UR5-like, light rotors": (ur5_like(), np.full(6, 2.0)),
        "UR10e-like": (ur10e_like(), ur10e_like().domain.dq.hi),
        "cobot of seven joints": (cobot7_like(), cobot7_like().domain.dq.hi),
    }
    for n, seed in ((2, 0), (3, 0), (4, 0), (5, 0), (6, 0), (6, 1), (6, 2), (7, 0), (7, 1), (7, 2)):
        model = random_arm(n, seed)
        out[f"random arm of {n} joints, {seed}"] = (model, model.domain.dq.hi)
    return out
