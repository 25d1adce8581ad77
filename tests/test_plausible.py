"""Recordings in a wrong unit, of a wrong sign or by a wrong clock: refused before they become a model that encloses itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nominal_cases import JOINTS, Truth, arm, campaign
from stopset.errors import RecordingError
from stopset.offline.identify.pipeline import Settings, identify
from stopset.offline.inspect import inspect_recordings
from stopset.offline.inspect.inertia import Momentum
from stopset.recording import Meta, Recording, Recordings, write_recordings
from stopset.robot.rigid import gravity_torques
from synthetic import arm as lags
from synthetic import names, recordings, save_trials

WRONG = {
    "mN m": (lambda r: replace(r, tau=1e3 * r.tau), "it is in mN m"),
    "kN m": (lambda r: replace(r, tau=1e-3 * r.tau), "it is in kN m"),
    "sign": (lambda r: replace(r, tau=-r.tau), "turn the sign of tau"),
    "clock": (lambda r: replace(r, t=1.05 * r.t), "t runs 5.0% fast"),
    "sign of dq": (lambda r: replace(r, dq=-r.dq), "dq has the wrong sign"),
    "swapped": (lambda r: replace(r, dq=r.dq[:, [1, 0, 2]]), "columns may be swapped"),
}
Break = Callable[[Recording], Recording]


@pytest.fixture(scope="module")
def motor() -> Recordings:
    """Poses and motions of an arm whose data sheet is known."""
    return campaign(Truth(arm()), seconds=8.0)


@pytest.mark.parametrize("name", list(WRONG))
def test_motor_torque_that_is_wrong_makes_no_model(tmp_path: Path, motor: Recordings, name: str) -> None:
    how, says = WRONG[name]
    path = tmp_path / "r.parquet"
    write_recordings(path, Meta(joints=JOINTS), [how(r) for r in motor.trials])
    with pytest.raises(RecordingError, match=r"make no model of this arm: .*" + says):
        identify(arm(), [path], Settings(horizon=0.2))


@pytest.mark.parametrize("name", list(WRONG))
def test_compensated_torque_that_is_wrong_makes_no_model_and_inspect_says_why(
    tmp_path: Path, motor: Recordings, name: str
) -> None:
    """``u`` of eq. (11): what is left of the motor torque without gravity and friction, in motions slow and fast."""
    how, says = WRONG[name]
    robot, path = arm(), tmp_path / "r.parquet"

    def left(r: Recording) -> Recording:
        gravity = gravity_torques(robot.chain, robot.pi, np.ascontiguousarray(r.q))
        return replace(r, phase="open_loop", tau=r.tau - gravity - 6.0 * np.sign(r.dq))

    moving = [left(r) for r in motor.trials if r.phase != "static"]
    meta = Meta(joints=JOINTS, effort="compensated_torque")
    write_recordings(path, meta, moving)
    assert not inspect_recordings([path], robot)[0].wrong
    write_recordings(path, meta, [how(r) for r in moving])
    assert any(says in f.says for f in inspect_recordings([path], robot)[0].findings if f.severity == "error")
    with pytest.raises(RecordingError, match=r"make no model of this arm: .*" + says):
        identify(robot, [path], Settings(horizon=0.2))


def test_rotors_that_no_data_sheet_tells_are_no_wrong_unit(tmp_path: Path) -> None:
    """Joints forty times as inert as their links: harmonic drives are; a description without rotors is no reason to refuse."""
    robot = lags(names(2))
    assert not any(np.isfinite(d.rotor_inertia) for d in robot.drives)
    trials = recordings((30.0, 4.0), (20.0, 3.0), suites=3, trials=4)
    momentum = Momentum(robot)
    for r in trials:
        momentum.add(r)
    scale, std = momentum.scales()
    assert scale.tolist() == [1.0, 1.0] and np.all(std < 0.1)
    identify(robot, [save_trials(tmp_path / "r.parquet", trials, names(2))], Settings(horizon=0.2))
    # but its sign is known all the same
    with pytest.raises(RecordingError, match="turn the sign of tau"):
        wrong = [replace(r, tau=-r.tau) for r in trials]
        identify(robot, [save_trials(tmp_path / "n.parquet", wrong, names(2))], Settings(horizon=0.2))


def test_what_balances_an_arm_beyond_its_weight_turns_no_sign(tmp_path: Path, motor: Recordings) -> None:
    """A hydraulic cylinder bears more than the links that it was made for: the drive pushes down where the description lifts (a real KUKA
    KR 300, whose torque was called one of the wrong sign)."""
    robot, path = arm(), tmp_path / "r.parquet"

    def balanced(r: Recording) -> Recording:
        weight = gravity_torques(robot.chain, robot.pi, np.ascontiguousarray(r.q))
        return replace(r, tau=r.tau - weight * np.array([0.0, 2.2, 0.0]))

    write_recordings(path, Meta(joints=JOINTS), [balanced(r) for r in motor.trials])
    assert not inspect_recordings([path], robot)[0].wrong
    notes = identify(robot, [path], Settings(horizon=0.2, friction="plain")).model.notes
    assert [n for n in notes if "shoulder: the torque is -" in n and "steps up where the joint turns round" in n]
