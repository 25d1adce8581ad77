"""The core's rigid body against pinocchio, on random poses of arms, on URDFs with fixed side branches, and row by row."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from core_calls import maths, point_jacobian
from stopset.errors import StopsetError
from stopset.offline.description import load_robot
from stopset.robot import Robot
from stopset.robot.rigid import (
    Chain,
    gravity_torque,
    gravity_torques,
    link_frames,
    mass_matrices,
    mass_matrix,
    regressors,
    torque,
    torques,
)

pin = pytest.importorskip("pinocchio")
SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"
ARMS = [
    "lwa4p",
    *sorted(str(p) for p in SHARED.glob("*/robot.urdf")),
    *(str(SHARED / f"hidden_effect/{d}/robot.urdf") for d in ("d01", "d03", "d04")),
]
# both sides sum some 10^3 products of order 10^2 in double precision
TOLERANCE = 1e-10


def both(where: str) -> tuple[Robot, object]:
    if where != "lwa4p" and not Path(where).exists():
        pytest.skip("../shared/data is not here")
    robot = load_robot(where)
    model = pin.buildModelFromXML(robot.urdf)
    model.gravity.linear = robot.chain.gravity
    return robot, model


@pytest.mark.parametrize("where", ARMS)
def test_agrees_with_pinocchio(where: str) -> None:
    robot, model = both(where)
    data = model.createData()
    assert list(model.names)[1:] == list(robot.joints)
    rng = np.random.default_rng(1)
    for _ in range(20):
        q = rng.uniform(-np.pi, np.pi, robot.n)
        dq, ddq = rng.normal(size=(2, robot.n))
        want = pin.rnea(model, data, q, dq, ddq)
        assert np.abs(torque(robot.chain, robot.pi, q, dq, ddq) - want).max() < TOLERANCE
        assert np.abs(regressors(robot.chain, q, dq, ddq) @ robot.pi.ravel() - want).max() < TOLERANCE
        M = np.triu(pin.crba(model, data, q))
        assert np.abs(mass_matrix(robot.chain, robot.pi, q) - (M + np.triu(M, 1).T)).max() < TOLERANCE
        g = pin.computeGeneralizedGravity(model, data, q)
        assert np.abs(gravity_torque(robot.chain, robot.pi, q) - g).max() < TOLERANCE
        pin.forwardKinematics(model, data, q)
        R, o = link_frames(robot.chain, q)
        for i in range(robot.n):
            assert np.abs(data.oMi[i + 1].translation - o[i]).max() < TOLERANCE
            assert np.abs(data.oMi[i + 1].rotation - R[i]).max() < TOLERANCE


@pytest.mark.parametrize("where", ARMS)
def test_gravity_of_many_rows_agrees_with_pinocchio(where: str) -> None:
    robot, model = both(where)
    data = model.createData()
    q = np.random.default_rng(2).uniform(-np.pi, np.pi, (20, robot.n))
    theirs = [pin.computeGeneralizedGravity(model, data, x) for x in q]
    assert np.abs(gravity_torques(robot.chain, robot.pi, q) - theirs).max() < TOLERANCE


def test_rows_are_what_each_row_is() -> None:
    arm = load_robot("lwa4p")
    c, pi = arm.chain, arm.pi
    q, dq, ddq = np.random.default_rng(3).normal(size=(3, 7, arm.n))
    assert np.array_equal(torques(c, pi, q, dq, ddq), [torque(c, pi, *x) for x in zip(q, dq, ddq, strict=True)])
    assert np.array_equal(gravity_torques(c, pi, q), [gravity_torque(c, pi, x) for x in q])
    assert np.array_equal(mass_matrices(c, pi, q), [mass_matrix(c, pi, x) for x in q])
    assert np.array_equal(regressors(c, q, dq, ddq), [regressors(c, *x) for x in zip(q, dq, ddq, strict=True)])
    R, o = link_frames(c, q)
    for k in range(len(q)):
        for ours, alone in zip((R[k], o[k]), link_frames(c, q[k]), strict=True):
            assert np.array_equal(ours, alone)


@pytest.mark.parametrize("n", range(1, 10))
def test_joints_turned_together_have_the_bits_of_each_by_itself(n: int) -> None:
    """Sines are taken of four joints at once; angles near zero, and those that ask for more digits of pi, by themselves."""
    rng = np.random.default_rng(n)
    chain = Chain(np.tile(np.eye(3), (n, 1, 1)), rng.normal(size=(n, 3)), np.tile([0.0, 0.0, 1.0], (n, 1)), np.zeros(3))
    for _ in range(200):
        q = rng.choice([*rng.uniform(-7.0, 7.0, n), 0.0, 1e-9, -1e-4, np.pi, -0.5 * np.pi, 9e5, 1e7], n)
        together, whole = link_frames(chain, q)[0], np.eye(3)
        for i in range(n):
            one = Chain(*(x[i : i + 1] for x in chain[:3]), chain.gravity)
            alone = link_frames(one, q[i : i + 1])[0][0]
            assert np.array_equal(alone[1, 0], maths("sin", q[i : i + 1])[0], equal_nan=True)
            assert np.array_equal(alone[0, 0], maths("cos", q[i : i + 1])[0], equal_nan=True)
            whole = whole[:, :1] * alone[0] + whole[:, 1:2] * alone[1] + whole[:, 2:] * alone[2]
            assert np.array_equal(together[i], whole, equal_nan=True)


def test_a_points_jacobian_is_its_derivative() -> None:
    arm = load_robot("lwa4p")
    q, point, link = np.random.default_rng(4).normal(size=arm.n), np.array([0.1, -0.2, 0.3]), 3
    p, J = point_jacobian(arm.chain, q, link, point)
    R, o = link_frames(arm.chain, q)
    assert np.allclose(p, o[link] + R[link] @ point, atol=1e-15)
    step = 1e-6 * np.eye(arm.n)
    by_difference = [
        (point_jacobian(arm.chain, q + s, link, point)[0] - point_jacobian(arm.chain, q - s, link, point)[0]) / 2e-6 for s in step
    ]
    assert np.allclose(J, np.transpose(by_difference), atol=1e-9) and not J[:, link + 1 :].any()


def test_parameters_written_into_are_seen_and_strided_ones_too() -> None:
    """The call before is remembered by identity alone: whatever is in the arrays now decides."""
    arm = load_robot("lwa4p")
    q, pi = np.full(arm.n, 0.3), arm.pi.copy()
    before = gravity_torque(arm.chain, pi, q)
    pi *= 2.0
    assert np.allclose(gravity_torque(arm.chain, pi, q), 2.0 * before, rtol=1e-14)
    strided = np.repeat(pi, 2, axis=1)[:, ::2]
    assert np.array_equal(gravity_torque(arm.chain, strided, q), gravity_torque(arm.chain, pi, q))
    strided *= 2.0
    assert np.allclose(gravity_torque(arm.chain, strided, q), 4.0 * before, rtol=1e-14)


def test_wrong_shapes_and_too_many_joints_are_refused() -> None:
    """The core reads as many numbers as it is told: nothing may reach it that holds fewer."""
    arm = load_robot("lwa4p")
    q = np.zeros((4, arm.n))
    with pytest.raises(ValueError, match="rows of shapes"):
        torques(arm.chain, arm.pi, q, q, q[:3])
    with pytest.raises(ValueError, match="standard parameters"):
        torques(arm.chain, arm.pi[:-1], q, q, q)
    with pytest.raises(ValueError, match="chain of"):
        gravity_torques(arm.chain._replace(gravity=np.zeros(2)), arm.pi, q)
    n = 33
    long = Chain(np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3)), np.tile([0.0, 0.0, 1.0], (n, 1)), np.zeros(3))
    with pytest.raises(StopsetError, match="too many joints"):
        gravity_torque(long, np.zeros((n, 10)), np.zeros(n))
