"""The independent arm that the diagnosis is measured on: its rigid body, that everything it can hide leaves a trace, its sizes."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))

from independent_arm import read_arm, torques
from independent_effects import EFFECTS, OTHER_LAWS
from independent_outside import OUTSIDE
from independent_sets import Truth, _run, _trial, closed_loop, random_truth, urdf
from independent_sizing import RATIO, hide

from stopset.offline.description import load_robot
from stopset.robot import rigid

ARM = """<robot name="two"><link name="base"/>
<joint name="a" type="revolute"><parent link="base"/><child link="l1"/><origin xyz="0 0 0.3" rpy="0.2 -0.1 0.4"/><axis xyz="0 1 0"/>
<limit lower="-2.8" upper="2.8" effort="80" velocity="1.2"/></joint>
<link name="l1"><inertial><origin xyz="0.01 0.02 0.2"/><mass value="3.2"/>
<inertia ixx="0.045" iyy="0.045" izz="0.004" ixy="0.001" ixz="0" iyz="0"/></inertial></link>
<joint name="b" type="revolute"><parent link="l1"/><child link="l2"/><origin xyz="0 0.05 0.42" rpy="0 0.3 0"/><axis xyz="0 1 0"/>
<limit lower="-2.8" upper="2.8" effort="40" velocity="1.2"/></joint>
<link name="l2"><inertial><origin xyz="-0.01 0 0.16"/><mass value="2.0"/>
<inertia ixx="0.02" iyy="0.02" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>"""
SHEET = {"joints": {
    "a": {"gear_ratio": 120, "motor_inertia_kgm2": 5e-5, "torque_limit_Nm": 80},
    "b": {"gear_ratio": 100, "motor_inertia_kgm2": 4.3e-5, "torque_limit_Nm": 40},
}}  # fmt: skip
KINDS = EFFECTS | OTHER_LAWS | OUTSIDE
U = np.array([0.3, 0.6, 0.2, 0.8])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("arm")
    (out / "robot.urdf").write_text(ARM)
    (out / "robot.json").write_text(json.dumps(SHEET))
    return out


@pytest.fixture(scope="module")
def truth(folder: Path) -> Truth:
    return random_truth(read_arm(folder), 5, False)


def first_trial(truth: Truth) -> tuple[Any, ...]:
    """Positions, speeds and torques of the true arm in one slow trial, its friction and the torque from outside as drawn."""
    rng = np.random.default_rng(3)
    t = np.arange(1500) * 0.004
    q = truth.reach * 0.6 * np.sin(np.array([1.1, 1.7]) * t[:, None])
    temp, sc, sv, extra = _trial(truth, rng, 0.8, len(q))
    return _run(truth, q, temp, sc, sv, extra)


def test_its_rigid_body_is_the_one_of_the_description(folder: Path) -> None:
    arm, robot = read_arm(folder), load_robot(folder / "robot.urdf")
    q, dq, ddq = np.random.default_rng(1).normal(size=(3, 30, 2))
    ours = rigid.torques(robot.chain, robot.pi, q, dq, ddq) + robot.rotor * ddq
    assert np.allclose(torques(arm, q, dq, ddq), ours, atol=1e-9)
    again = read_arm_of(urdf(arm), folder)
    assert np.allclose(torques(again, q, dq, ddq), ours, atol=1e-6)


def read_arm_of(text: str, folder: Path) -> Any:
    other = folder / "again"
    other.mkdir(exist_ok=True)
    (other / "robot.urdf").write_text(text)
    (other / "robot.json").write_text(json.dumps(SHEET))
    return read_arm(other)


def test_a_healthy_motion_obeys_the_described_dynamics(truth: Truth) -> None:
    """What the motor gave is rigid body, Coulomb and viscous friction of the motion that came out."""
    plain = replace(truth, T=truth.T.copy())
    q, dq, tau = first_trial(plain)
    ddq = np.gradient(dq, 0.004, axis=0)
    _, sc, sv, _ = _trial(plain, np.random.default_rng(3), 0.8, len(q))
    friction = sc * plain.T[:, 0] * np.tanh(dq / 0.003) + sv * plain.T[:, 2] * dq
    left = tau - torques(plain.arm, q, dq, ddq) - friction
    fast = np.abs(dq).min(axis=1) > 0.05
    assert np.sqrt(np.mean(left[fast] ** 2, axis=0)) == pytest.approx(0.0, abs=0.02 * plain.T[:, 0].max())


@pytest.mark.parametrize("name", sorted(KINDS))
def test_whatever_is_hidden_leaves_a_trace(truth: Truth, name: str) -> None:
    """Same motions, same noise: only what was hidden can make a difference to what is recorded or told."""
    kind = KINDS[name]
    hidden = kind.apply(truth, 0, float(np.sqrt(kind.lo(truth, 0) * kind.hi(truth, 0))), U)
    few = (closed_loop(t)[-3:] for t in (truth, hidden))
    difference = np.concatenate([a[2]["tau"] - b[2]["tau"] for a, b in zip(*few, strict=True)])
    described = (
        np.abs(hidden.described.rotor - truth.described.rotor).max() + np.abs(hidden.described.pi - truth.described.pi).max()
    )
    assert np.sqrt(np.mean(difference**2, axis=0)).max() > 0.02 * truth.noise[0] or described > 1e-3


@pytest.mark.parametrize(("name", "level"), [("torque_ripple", "easy"), ("cubic_viscous~asinh", "hard"), ("snag", "easy")])
def test_what_is_hidden_has_the_size_asked_for(truth: Truth, name: str, level: str) -> None:
    _, _, ratio = hide(truth, KINDS[name], 0, level, U)
    assert ratio == pytest.approx(RATIO[level], rel=0.1)
