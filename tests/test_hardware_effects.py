"""Effects as large as real arms have them: named at their joint with their size, and not by the name of a finer law."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stopset.offline.description import robot_from_text
from stopset.offline.diagnose import Diagnosis, diagnose
from stopset.recording import Recordings
from stopset.simulation import prepare
from stopset.simulation.hidden import Hidden
from stopset.simulation.plant import largest_gravity
from stopset.simulation.sizing import inject
from test_hidden_effects import ARM

ROBOT = robot_from_text(ARM)
CARRIED = 0.4  # of the largest gravity torque: what a balancing cylinder takes off


def found(effect: str, joint: str, size: float, seed: int) -> tuple[Diagnosis, dict[str, float | str]]:
    """The answer where an effect of this size is hidden at a joint, and what was hidden."""
    scenario = prepare(ROBOT, ["none"], seed, "short", cad="wrong" if seed % 2 else "exact")
    cell, said = inject(scenario.cell, [Hidden(effect, ROBOT.joints.index(joint), size)])
    recordings = tuple(replace(scenario, cell=cell).recordings())
    return diagnose(scenario.robot, Recordings(replace(scenario.meta, sources=()), recordings)), said[0]


@pytest.mark.parametrize("seed", [3, 6])
def test_a_gas_spring_that_carries_the_arm_is_a_counterbalance(seed: int) -> None:
    size = CARRIED * float(largest_gravity(ROBOT)[1])
    answer, truth = found("counterbalance", "lift", size, seed)
    assert answer.verdict == "missing" and [r.label for r in answer.ranked] == ["counterbalance:lift"]
    reported = answer.ranked[0].parameters
    assert reported["q_0"].value == pytest.approx(float(truth["stretched_out_rad"]) % (2 * np.pi), abs=0.1)
    assert reported["r"].value == pytest.approx(
        float(truth["lever_ratio"]), abs=0.1
    )  # its force is not quite a constant, as the law's is


@pytest.mark.parametrize("seed", [3, 4])
def test_a_cable_at_the_end_of_its_reach_is_no_spring(seed: int) -> None:
    answer, truth = found("cable", "turn", 0.5, seed)
    assert answer.verdict == "missing" and answer.ranked[0].label == "cable:turn"
    reported, A = answer.ranked[0].parameters, float(truth["torque_Nm"])
    assert reported["k"].value == pytest.approx(A / 0.6, rel=0.2) and reported["k_3"].value == pytest.approx(
        A / 0.6**3 / 6, rel=0.6
    )


def test_a_dress_pack_that_hardly_stiffens_is_a_spring_however_sure_the_rest_is() -> None:
    answer, truth = found("spring", "turn", 1.5, 4)
    assert answer.verdict == "missing" and [r.label for r in answer.ranked] == ["spring:turn"]
    assert answer.ranked[0].parameters["k"].value == pytest.approx(float(truth["stiffness_Nm_per_rad"]), rel=0.1)


def test_what_a_stiffening_dress_pack_leaves_is_too_little_to_contradict_the_spring() -> None:
    """Its rest, a thousandth of what the spring takes away, was large beside the sensors' noise and the evidence saturated: unknown."""
    answer, truth = found("spring", "turn", 1.5, 3)
    assert answer.verdict == "missing" and [r.label for r in answer.ranked] == ["spring:turn"]
    stiffness = float(truth["stiffness_Nm_per_rad"])  # at its centre; it is k (1 + 0.15 x^2) about there, and x reaches 1.6 rad
    assert stiffness < answer.ranked[0].parameters["k"].value < 1.4 * stiffness


def test_friction_by_the_square_of_the_load_is_no_friction_by_the_load() -> None:
    answer, truth = found("quadratic_load", "lift", 0.01, 4)
    assert answer.verdict == "missing" and [r.label for r in answer.ranked] == ["quadratic_load:lift"]
    assert answer.ranked[0].parameters["k_2"].value == pytest.approx(float(truth["friction_per_load_squared"]), rel=0.3)
