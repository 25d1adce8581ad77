"""A pedestal that rocks and a link that bends are no elastic gears, and say so."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stopset.offline.description import robot_from_text
from stopset.offline.diagnose import Diagnosis
from stopset.offline.diagnose.columns.elasticity import swing
from stopset.offline.diagnose.columns.structure import Giving, Place, places
from stopset.offline.diagnose.evidence.engine import Engine
from stopset.recording import Recordings
from stopset.simulation import prepare
from test_hidden_effects import ARM

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
import flexible_structure

ROBOT = robot_from_text(ARM)


def test_a_structure_about_a_joint_s_own_axis_is_that_joint_s_gear() -> None:
    """One chain with a joint more against the gear's own columns: the same swing, the same torques."""
    scenario = prepare(ROBOT, ["none"], 4, "short")
    trials = tuple(scenario.recordings())[:20]
    source = Engine.build(scenario.robot, Recordings(replace(scenario.meta, sources=()), trials)).source
    c, K, D = ROBOT.chain, 900.0, 4.0
    for j in range(1, ROBOT.n):
        own = Place("", j, c.R[j] @ c.axis[j], c.p[j], np.zeros(3))
        got, want = Giving.of(source, own).columns(K, D), swing(source, j, {"K": K, "D": D})
        for i, (moving, _) in want.items():
            assert got[:, i] == pytest.approx(moving[:, 0], rel=1e-6, abs=1e-6 * float(np.abs(moving).max()))


def test_it_may_sit_under_the_base_and_at_every_link_across_it() -> None:
    found = places(ROBOT)
    assert {p.where for p in found} == {"the base", "the link before lift", "the link before bend"}
    assert all(abs(p.axis @ p.before) < 1e-12 and np.linalg.norm(p.axis) == pytest.approx(1.0) for p in found)


def asked(kind: str, seed: int) -> Diagnosis:
    return flexible_structure.asked(ROBOT, kind, seed)[1]


def test_a_link_that_bends_is_no_gear_and_the_answer_says_where_it_may_sit() -> None:
    answer = asked("link", 4)
    assert answer.verdict == "unknown" and not answer.ranked
    told = " ".join(x for u in answer.unexplained for x in u.resembles)
    assert "flexible structure" in told and "the link before bend" in told


@pytest.mark.parametrize(("kind", "seed"), [("pedestal", 1), ("link", 2), ("pedestal", 3)])
def test_no_gear_is_named_where_a_structure_gives(kind: str, seed: int) -> None:
    answer = asked(kind, seed)
    assert answer.verdict == "unknown" and not answer.ranked


def test_the_same_arm_on_a_rigid_structure_lacks_nothing() -> None:
    """What is simulated of the structure is all that is told of it: stiffer than any of its torques can show, it is a rigid one."""
    rng = np.random.default_rng(3)
    s = replace(flexible_structure.pedestal(ROBOT.chain, rng), frequency=200.0, damping=0.3)
    assert flexible_structure.diagnosed(ROBOT, s, 3).verdict == "none"
