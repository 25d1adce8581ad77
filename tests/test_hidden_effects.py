"""The story of the hidden effect: `stopset simulate --hide` for all there is, and the diagnosis gives the right answer.

What is right is written down here before anything is diagnosed. Plain friction is part of every model, so more of it is no
missing effect. A joint zero that is off shows in torques as a shifted centre of mass: it is either named, or listed among
what these recordings cannot show.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from stopset.cli.main import main
from stopset.effects import catalogue
from stopset.offline.description import load_robot
from stopset.offline.diagnose import Diagnosis, diagnose
from stopset.recording import read_recordings
from stopset.simulation.hidden import kinds

# a turntable, an upper arm and a light forearm with a flange: the smallest arm on which all effects differ (two parallel
# axes alone can't tell a tilted base from a shoulder whose zero is off)
ARM = """<robot name="three"><link name="base"/>
<joint name="turn" type="revolute"><parent link="base"/><child link="l1"/><origin xyz="0 0 0.3"/><axis xyz="0 0 1"/>
<limit lower="-2.8" upper="2.8" effort="80" velocity="1.2"/></joint>
<link name="l1"><inertial><origin xyz="0.01 0 0.1"/><mass value="4.0"/>
<inertia ixx="0.03" iyy="0.03" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="lift" type="revolute"><parent link="l1"/><child link="l2"/><origin xyz="0.02 0 0.2"/><axis xyz="0 1 0"/>
<limit lower="-2.8" upper="2.8" effort="80" velocity="1.2"/></joint>
<link name="l2"><inertial><origin xyz="0.01 0 0.2"/><mass value="3.2"/>
<inertia ixx="0.045" iyy="0.045" izz="0.004" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="bend" type="revolute"><parent link="l2"/><child link="l3"/><origin xyz="0 0.05 0.42"/><axis xyz="0 1 0"/>
<limit lower="-2.8" upper="2.8" effort="40" velocity="1.2"/></joint>
<link name="l3"><inertial><origin xyz="-0.01 0 0.12"/><mass value="0.8"/>
<inertia ixx="0.006" iyy="0.006" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="flange" type="fixed"><parent link="l3"/><child link="tool"/><origin xyz="0 0 0.25"/></joint>
<link name="tool"/></robot>"""
SEED = "1"
PLAIN = ("none", "coulomb", "viscous")  # every model has plain friction
ABSORBED = ("encoder_offset", "encoder_eccentricity")
HEAVY = ("counterbalance",)  # as small as this it is a weight within the description's tolerance: tests/test_hardware_effects.py
AT = {
    "spring": "spring:turn",
    "cable": "cable:turn",
}  # on a joint that gravity loads, masses within the description's tolerance imitate a spring
# the arm's oil thins as asinh does: near the cubic where it thins a little, another law (rightly "unknown") where it thins a lot
SIZE = {"cubic_viscous": "hard"}
SHIFTS = ("payload", "rotor_inertia", "torque_gain", "spring")  # masses and rotors, fitted again, imitate them in motion
OUTSIDE = ("outside_bump", "outside_resonance", "outside_weave", "outside_walk")
NAMED = tuple(n for n in catalogue() if n in kinds() and n not in (*PLAIN, *ABSORBED, *HEAVY, "residual_gravity"))


@pytest.fixture(scope="module")
def urdf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("arm") / "three.urdf"
    path.write_text(ARM)
    return path


def simulated(urdf: Path, hide: str, out: Path) -> dict[str, object]:
    """What anyone would type; returns what is hidden."""
    words = ["simulate", "--robot", str(urdf), "--hide", hide, "--plan", "short", "--seed", SEED, "--out", str(out)]
    words += ["--size", SIZE.get(hide, "easy")]
    assert main(words) == 0
    truth = json.loads((out / "truth.json").read_text())
    assert isinstance(truth, dict)
    return truth


def story(urdf: Path, hide: str, out: Path) -> tuple[dict[str, object], Diagnosis]:
    """Simulate, then diagnose against the description alone."""
    truth = simulated(urdf, hide, out)
    return truth, diagnose(load_robot(out / "robot.urdf"), read_recordings(out / "recording.parquet"))


def hidden_at(truth: dict[str, object]) -> tuple[str, ...]:
    effects = truth["effects"]
    assert isinstance(effects, list) and len(effects) == 1
    return tuple(effects[0]["joints"])


def test_every_effect_of_the_catalogue_can_be_hidden_and_nothing_else_is_called_so() -> None:
    ours = {name for name, effect in catalogue().items() if effect.law.__module__.startswith("stopset.")}
    # a motor's inertia between two joints is not part of the simulated arm: tests/test_as_found.py finds it on recordings of its own law
    # play shows behind the gear only, where that recorder reads nothing: tests/test_backlash.py
    between = {"coupled_wrist", "opposed_wrist", "backlash"}
    assert ours - between | set(OUTSIDE) == set(kinds())
    assert {*NAMED, *ABSORBED, *HEAVY, "residual_gravity", "coulomb", "viscous"} == ours - between


@pytest.mark.parametrize("hide", PLAIN)
def test_nothing_is_missing_where_nothing_is_hidden(urdf: Path, tmp_path: Path, hide: str) -> None:
    truth, found = story(urdf, hide, tmp_path)
    assert truth["verdict"] == found.verdict == "none"
    assert not found.ranked


@pytest.mark.parametrize("hide", NAMED)
def test_the_hidden_effect_is_named_first_at_its_joint(urdf: Path, tmp_path: Path, hide: str) -> None:
    truth, found = story(urdf, AT.get(hide, hide), tmp_path)
    assert found.verdict == "missing"
    first = found.ranked[0]
    assert first.effect == hide
    assert set(first.joints) <= set(hidden_at(truth)) and bool(first.joints) == (catalogue()[hide].scope != "arm")
    assert first.error_after < first.error_before or hide in SHIFTS


@pytest.mark.parametrize("hide", ABSORBED)
def test_what_torques_cannot_show_is_named_rightly_or_listed_as_not_to_be_seen(urdf: Path, tmp_path: Path, hide: str) -> None:
    truth, found = story(urdf, hide, tmp_path)
    joint = hidden_at(truth)
    if found.ranked:
        assert (found.ranked[0].effect, found.ranked[0].joints) == (hide, joint)
    else:
        assert any(b.effect == hide and set(joint) <= set(b.joints) for b in found.not_identifiable)
        assert found.verdict == "none"


@pytest.mark.parametrize("hide", OUTSIDE)
def test_a_cause_outside_the_catalogue_is_unknown_and_its_variables_are_named(urdf: Path, tmp_path: Path, hide: str) -> None:
    truth, found = story(urdf, hide, tmp_path)
    assert truth["verdict"] == found.verdict == "unknown"
    assert not found.ranked and found.next_experiment
    effects = truth["effects"]
    assert isinstance(effects, list)
    said = effects[0]["params"]["depends_on"]
    if hide == "outside_walk":
        assert "no recorded variable" in found.depends_on[0]
    else:
        assert set(said.split(", ")) <= set(found.depends_on)


def test_gravity_left_in_compensated_torque_is_named_by_the_whole_command_line(urdf: Path, tmp_path: Path) -> None:
    truth = simulated(urdf, "residual_gravity", tmp_path / "cell")
    cell, model, answer = tmp_path / "cell", tmp_path / "m.model.json", tmp_path / "d.json"
    rec = str(cell / "recording.parquet")
    assert main(["identify", "--robot", str(cell / "robot.urdf"), "--data", rec, "--out", str(model)]) in (0, 1)
    assert main(["diagnose", str(model), "--data", rec, "--json", str(answer)]) == 0
    found = json.loads(answer.read_text())
    assert found["verdict"] == "missing"
    first = found["ranked_effects"][0]
    assert (first["effect"], first["joint"]) == ("residual_gravity", *hidden_at(truth))
    assert first["parameters"]["k_g"]["value"] == pytest.approx(0.3, abs=0.1)
