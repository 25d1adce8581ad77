"""Laws of the whole arm, which have one number for all joints: that they do not agree on it is no finding."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from stopset.offline.description import robot_from_text
from stopset.offline.diagnose import Diagnosis, diagnose
from stopset.recording import Recording, Recordings
from stopset.robot.rigid import gravity_torques, torques
from stopset.simulation import prepare
from test_hidden_effects import ARM


def with_shares(shares: tuple[float, ...]) -> Diagnosis:
    """Of a healthy arm whose joints' torque holds ``shares`` of the Coriolis torque too much."""
    scenario = prepare(robot_from_text(ARM), ["none"], 3, "compact", cad="exact")
    robot = scenario.robot

    def shifted(r: Recording) -> Recording:
        speeds = torques(robot.chain, robot.pi, r.q, r.dq, 0 * r.q) - gravity_torques(robot.chain, robot.pi, r.q)
        return dataclasses.replace(r, tau=r.tau + np.array(shares) * speeds)

    meta = dataclasses.replace(scenario.meta, sources=())
    return diagnose(robot, Recordings(meta, tuple(map(shifted, scenario.recordings()))))


@pytest.mark.parametrize(("shares", "named"), [((-0.9, -0.9, -0.9), True), ((-0.9, 0.9, 0.4), False)])
def test_a_law_of_the_whole_arm_that_joints_do_not_agree_on_is_no_finding(shares: tuple[float, ...], named: bool) -> None:
    """Of a small arm whose model is off by a little at one joint a Coriolis torque was named that it has to -9 %."""
    found = with_shares(shares)
    told = [r for r in found.ranked if r.effect == "coriolis"]
    assert bool(told) == named, found.ranked
    if named:
        assert told[0].parameters["x"].value == pytest.approx(-0.9, abs=0.1)
    else:
        assert any("the joints do not agree on it" in x for u in found.unexplained for x in u.resembles), found.unexplained
