"""The next abstraction: gone to by itself where the linear model's sets say too little, and only where a richer one is tighter."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from stopset.artifact import load_model
from stopset.cli.main import main
from stopset.offline.campaign.settings import Settings
from stopset.offline.description import robot_from_text
from stopset.offline.identify.pipeline import identify
from stopset.recording import Meta, Recording, write_recordings
from stopset.robot import Robot
from stopset.robot.rigid import torques
from synthetic import names, urdf

JOINTS = names(2)
VISCOUS, DRY, RATE = np.array([3.0, 1.5]), 0.3, 125.0


def direct_drive() -> Robot:
    """Two links without gears: what their drives feel turns with the pose, which no constant mass matrix holds."""
    return robot_from_text(
        urdf(JOINTS), {"joints": {j: {"gear_ratio": 1, "reflected_motor_inertia_kgm2": 0.002} for j in JOINTS}}
    )


def geared() -> Robot:
    rows = {j: {"gear_ratio": 100, "reflected_motor_inertia_kgm2": 3.0} for j in JOINTS}
    return robot_from_text(urdf(JOINTS), {"joints": rows})


def motion(robot: Robot, k: int, speed: float) -> Recording:
    rng = np.random.default_rng([7, k])
    t, w = np.arange(0, 8.0, 1 / RATE), 2 * np.pi * np.array([0.15, 0.3, 0.45, 0.6])[:, None, None]
    a, p = rng.normal(size=(4, 2))[:, None, :] / w, rng.uniform(0, 2 * np.pi, (4, 2))[:, None, :]
    q, dq, ddq = (np.sum(a * w**d * np.sin(w * t[:, None] + p + d * np.pi / 2), axis=0) for d in range(3))
    q, dq, ddq = (speed / np.abs(dq).max(axis=0) * x for x in (q, dq, ddq))
    tau = torques(robot.chain, robot.pi, q, dq, ddq) + robot.rotor * ddq + VISCOUS * dq + DRY * np.sign(dq)
    tau = tau + 0.02 * rng.normal(size=tau.shape)
    return Recording("closed_loop", k, 0, k, t, q + 1e-5 * rng.normal(size=q.shape), dq + 1e-3 * rng.normal(size=q.shape), tau)


def recorded(path: Path, robot: Robot, speed: float = 1.2) -> Path:
    trials = [motion(robot, k, speed) for k in range(3)]
    write_recordings(path, Meta(joints=JOINTS, robot="planar", rate_hz=RATE), trials)
    return path


@pytest.fixture(scope="module")
def wide(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(tmp_path_factory.mktemp("wide") / "r.parquet", direct_drive())


def test_sets_that_say_too_little_are_tried_with_the_next_abstraction(wide: Path) -> None:
    settings = Settings(horizon=0.5)
    linear = identify(direct_drive(), [wide], settings)
    found = identify(direct_drive(), [wide], Settings(horizon=0.5, ladder=True))
    assert linear.tightness.median > 3.0 and linear.model.abstraction.kind == 1
    assert found.model.abstraction.kind == 3 and not found.model.abstraction.linear
    # wider nowhere, and at half the width in the mean over angles and speeds
    ratio = found.tightness.half[1] / linear.tightness.half[1]
    assert np.all(ratio < 1.0) and np.exp(np.mean(np.log(ratio))) < 0.5, ratio
    (note,) = [x for x in found.model.notes if x.startswith("next abstraction")]
    assert (
        f"{linear.tightness.median:.1f} times" in note
        and "model 2 of order 3 would lack no less" in note
        and "model 3 of order 3" in note
    )
    assert "was taken" in note
    # what goes into the file is what was taken: a revision of it asks for the same
    assert found.model.provenance["settings"]["model"] == 3 and not found.model.provenance["settings"]["ladder"]


def test_tight_sets_stay_linear_to_the_last_bit(tmp_path: Path) -> None:
    path = recorded(tmp_path / "r.parquet", geared())
    one, other = (identify(geared(), [path], Settings(horizon=0.5, ladder=asked)).model for asked in (False, True))
    assert one.abstraction.linear
    np.testing.assert_array_equal(one.powered.U.lo, other.powered.U.lo)
    np.testing.assert_array_equal(one.powered.U.hi, other.powered.U.hi)
    assert one.notes == other.notes and one.provenance == other.provenance


def test_a_richer_model_that_is_no_better_is_not_taken_and_that_is_said(wide: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Asked of a motion too large for a Taylor polynomial about its middle."""
    path = recorded(wide.with_name("large.parquet"), direct_drive(), speed=2.5)
    monkeypatch.setattr("stopset.offline.identify.ladder.WIDE", 1.0)
    found = identify(direct_drive(), [path], Settings(horizon=0.5, ladder=True))
    (note,) = [x for x in found.model.notes if x.startswith("next abstraction")]
    assert found.model.abstraction.linear and "the linear model stays" in note and "was taken" not in note


def test_a_model_that_is_named_is_the_one_identified(tmp_path: Path, wide: Path) -> None:
    import json

    (tmp_path / "robot.urdf").write_text(urdf(JOINTS))
    sheet = {"joints": {j: {"gear_ratio": 1, "reflected_motor_inertia_kgm2": 0.002} for j in JOINTS}}
    (tmp_path / "robot.json").write_text(json.dumps(sheet))
    words = ["identify", "--robot", str(tmp_path / "robot.urdf"), "--data", str(wide), "--accept-wide", "--quiet"]
    for options, kind in ((["--model", "1"], 1), ([], 3)):
        out = tmp_path / f"{kind}.model.json"
        assert main([*words, *options, "--out", str(out)]) == 0
        assert load_model(out).abstraction.kind == kind
