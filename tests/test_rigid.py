"""Our compiled rigid-body functions against pinocchio, on random arms poses and on URDFs with fixed side branches."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from stopset.robot import Robot, load_robot
from stopset.robot.rigid import gravity_torque, gravity_torques, link_frames, mass_matrix, regressor, torque

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
        assert np.abs(regressor(robot.chain, q, dq, ddq) @ robot.pi.ravel() - want).max() < TOLERANCE
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
