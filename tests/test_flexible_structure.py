"""A pedestal that rocks and a link that bends are no elastic gears, and the answer says that and where they may sit."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stopset.offline.description import load_robot, robot_from_text
from stopset.offline.diagnose import Diagnosis
from stopset.offline.diagnose.columns.elasticity import swing
from stopset.offline.diagnose.columns.structure import Giving, Spring, gears, places
from stopset.offline.diagnose.diagnose import answered
from stopset.offline.diagnose.evidence.engine import Engine
from stopset.offline.diagnose.examination import examine
from stopset.offline.diagnose.search.structures import Structure
from stopset.recording import Recordings
from stopset.simulation import prepare
from test_hidden_effects import ARM

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
import flexible_structure

ROBOT = robot_from_text(ARM)


@pytest.fixture(scope="module")
def engine() -> Engine:
    scenario = prepare(ROBOT, ["none"], 4, "short")
    trials = tuple(scenario.recordings())[:20]
    return Engine.build(scenario.robot, Recordings(replace(scenario.meta, sources=()), trials))


def test_a_structure_about_a_joint_s_own_axis_is_that_joint_s_gear(engine: Engine) -> None:
    """One chain with a joint more against the gear's own columns: the same swing, the same torques, but for what is not linear in it."""
    rate, damping = 80.0, 0.1
    for j, own in list(enumerate(gears(ROBOT)))[1:]:
        giving = Giving.of(engine.source, own)
        got = giving.columns(Spring(rate, damping))
        K, D = rate**2 * giving.inertia, damping * rate * giving.inertia
        want = swing(engine.source, j, {"K": K, "D": D, "exact": 1.0})
        moving = np.concatenate([want[i][0] for i in range(ROBOT.n)], axis=1)
        assert np.linalg.norm(got - moving) < 0.03 * np.linalg.norm(moving)


def test_it_may_sit_under_the_base_and_at_every_link_across_it() -> None:
    found = places(ROBOT)
    assert [p.where for p in found] == ["the base", "the link before lift", "the link before bend"]
    for p in found:
        assert p.axes @ p.axes.T == pytest.approx(np.eye(2)) and np.abs(p.axes @ p.before).max() < 1e-12
    weightless = replace(ROBOT, chain=ROBOT.chain._replace(gravity=np.zeros(3)))
    assert [p.where for p in places(weightless)] == [p.where for p in found[1:]]  # nothing is level there


def test_a_pedestal_is_taken_about_both_its_axes_and_a_link_about_any_across_it(engine: Engine) -> None:
    base, _, link = places(ROBOT)
    both = Giving.of(engine.source, base, 0.5)
    spring = Spring(40.0, 0.1)
    alone = [both.crossed(angle) for angle in (0.0, np.pi / 2)]
    assert [x.inertia for x in alone] == pytest.approx(
        [both.inertia] * 2, rel=0.2
    )  # one stiffness of both is near that of either
    apart = sum(x.columns(spring) for x in alone)
    assert np.linalg.norm(both.columns(spring) - apart) < 0.2 * np.linalg.norm(apart)
    giving = Giving.of(engine.source, link)
    one, other = (giving.crossed(angle).columns(spring) for angle in (0.3, 0.3 + np.pi))
    assert one == pytest.approx(other)  # an axis has no sides


def asked(kind: str, seed: int) -> Diagnosis:
    return flexible_structure.asked(ROBOT, kind, seed)[1]


@pytest.mark.parametrize(
    ("kind", "seed", "where"),
    [("pedestal", 501, "the base"), ("link", 513, "the link before bend"), ("link", 514, "the link before bend")],
)
def test_where_a_structure_gives_none_is_named_and_the_answer_says_where_it_may_sit(kind: str, seed: int, where: str) -> None:
    """Of the first two nothing is claimed, of the last one a gear."""
    s, answer = flexible_structure.asked(ROBOT, kind, seed)
    assert answer.verdict == "unknown" and not answer.ranked
    told = answer.structure
    assert told is not None and told.may_sit_at[0] == where and told.joints and told.explains > 0.5
    assert told.hertz == pytest.approx(s.frequency, rel=0.25)  # it depends on the pose, and is stated of the rows' median inertia
    written = json.loads(json.dumps(answer.as_json()))["structure"]
    assert written["may_sit_at"] == list(told.may_sit_at) and written["explains"] == told.explains
    assert "stiffen it" in written["says"]


@pytest.mark.parametrize("seed", [2, 4])
def test_no_gear_is_named_where_a_structure_gives(seed: int) -> None:
    assert not asked("pedestal", seed).ranked and not asked("link", seed).ranked


@pytest.mark.parametrize(("hide", "verdict"), [("none", "none"), ("outside_bump", "unknown"), ("outside_walk", "unknown")])
def test_no_structure_is_told_where_none_gives(hide: str, verdict: str) -> None:
    answer = flexible_structure.diagnosed(ROBOT, None, 541, hide)
    assert answer.verdict == verdict and answer.structure is None and answer.as_json()["structure"] is None


def test_what_explains_less_than_half_takes_no_name_away() -> None:
    """Of a real UR10e a gear that is none was claimed beside its load, and a link that bends explained 29 % of what was left: no name stood."""
    scenario = prepare(ROBOT, ["payload"], 4, "short")
    made = Recordings(replace(scenario.meta, sources=()), tuple(scenario.recordings()))
    x = examine(scenario.robot, made)
    names = [r.label for r in answered(x).ranked]
    assert "payload" in names
    little, most = (Structure(("the base",), ("turn",), 5.0, share) for share in (0.29, 0.9))
    beside = answered(replace(x, structures={0: little}))
    assert (beside.verdict, [r.label for r in beside.ranked], beside.structure) == ("missing", names, None)
    alone = replace(x, found=replace(x.found, claims=x.found.claims[:1]), ranked=x.ranked[:1], structures={0: most})
    assert answered(alone).verdict == "unknown" and answered(alone).structure is most


def test_a_soft_gear_is_no_link_that_bends_about_the_same_axis() -> None:
    """Seed 721's was taken for one: a gear is held against a structure as it was claimed, with the swings that its trials began with."""
    answer = flexible_structure.diagnosed(load_robot("lwa4p"), None, 721, "elasticity")
    assert [r.label for r in answer.ranked] == ["elasticity:arm_2_joint"] and answer.structure is None


def test_the_same_arm_on_a_rigid_structure_lacks_nothing() -> None:
    """What is simulated of the structure is all that is told of it: stiffer than any of its torques can show, it is a rigid one."""
    rng = np.random.default_rng(3)
    s = replace(flexible_structure.pedestal(ROBOT.chain, rng), frequency=200.0, damping=0.3)
    assert flexible_structure.diagnosed(ROBOT, s, 3).verdict == "none"
