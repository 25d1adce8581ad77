"""The shipped arm: its numbers are the published ones, physically possible, and in the right place."""

from __future__ import annotations

import numpy as np

from stopset.offline.description import load_robot
from stopset.robot.rigid import gravity_torque, link_frames, mass_matrix

ARM = load_robot("lwa4p")
# coordinates are sums of products of a dozen doubles of order 1
TOLERANCE = 1e-12


def tip(q: np.ndarray) -> np.ndarray:
    R, o = link_frames(ARM.chain, q)
    return o[-1] + R[-1] @ ARM.tip


def test_joints_and_limits_are_the_published_ones() -> None:
    assert ARM.joints == tuple(f"arm_{i}_joint" for i in range(1, 7))
    assert ARM.torque_limit.tolist() == [370, 370, 176, 176, 41.6, 20.1]
    assert np.allclose(ARM.rotor, [1.34] * 4 + [0.17] * 2, rtol=1e-12)
    assert [n for n in ARM.notes if "no collision geometry" not in n] == [], "every key of robot.json is understood"


def test_upright_arm_reaches_the_sum_of_its_lengths() -> None:
    # d1 + a2 + d4 + flange, all on the base axis
    assert np.abs(tip(np.zeros(6)) - [0, 0, 0.205 + 0.350 + 0.305 + 0.084]).max() < TOLERANCE


def test_stretched_forward_by_joint_2_alone() -> None:
    reach = 0.350 + 0.305 + 0.084
    p = tip(np.array([0, np.pi / 2, 0, 0, 0, 0]))
    assert abs(np.hypot(p[0], p[1]) - reach) < TOLERANCE and abs(p[2] - 0.205) < TOLERANCE


def test_bodies_are_physically_possible() -> None:
    for m, hx, hy, hz, ixx, ixy, iyy, ixz, iyz, izz in ARM.pi:
        com = np.array([hx, hy, hz]) / m
        origin = np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
        moments = np.linalg.eigvalsh(origin - m * (com @ com * np.eye(3) - np.outer(com, com)))
        assert m > 0 and moments[0] > 0 and moments[0] + moments[1] > moments[2]


def test_masses_hang_below_where_they_should() -> None:
    """Upright, only lateral offsets load a joint; stretched forward, joint 2 carries the arm."""
    upright = gravity_torque(ARM.chain, ARM.pi, np.zeros(6))
    forward = gravity_torque(ARM.chain, ARM.pi, np.array([0, np.pi / 2, 0, 0, 0, 0]))
    mass = ARM.pi[1:, 0].sum()
    assert abs(forward[1]) > 9.81 * mass * 0.25 and abs(forward[1]) < 9.81 * mass * (0.350 + 0.305 + 0.084)
    assert np.abs(upright).max() < 0.1 * abs(forward[1])
    assert abs(forward[0]) < TOLERANCE, "axis 1 is vertical"
    assert np.linalg.eigvalsh(mass_matrix(ARM.chain, ARM.pi, np.zeros(6)))[0] > 0


def test_brakes_can_hold_the_arm_with_the_least_torque_assumed() -> None:
    """Else no stop could be proven anywhere near the stretched pose."""
    worst = np.zeros(6)
    rng = np.random.default_rng(0)
    for q in rng.uniform(-np.pi, np.pi, (2000, 6)):
        worst = np.maximum(worst, np.abs(gravity_torque(ARM.chain, ARM.pi, q)))
    for drive, g in zip(ARM.drives, worst, strict=True):
        assert drive.brake_torque * (1 - drive.brake_tolerance) > g
        assert abs(drive.brake_delay[0] + drive.brake_rise[0] - 0.02) < TOLERANCE
        assert abs(drive.brake_delay[1] + drive.brake_rise[1] - 0.08) < TOLERANCE
