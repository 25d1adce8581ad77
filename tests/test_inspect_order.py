"""Columns under the names of other joints: what a driver lists in an order of its own is told, and makes no model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nominal_cases import JOINTS, Truth, arm, moving
from stopset.errors import RecordingError
from stopset.offline.description import load_robot
from stopset.offline.inspect import inspect_recordings
from stopset.offline.inspect.gate import check_signals
from stopset.offline.inspect.order import exchanged
from stopset.recording import Meta, Recording, read_recordings, write_recordings

META = Meta(joints=JOINTS)
ALL, TORQUE = ("q", "dq", "tau"), ("tau",)


@pytest.fixture(scope="module")
def motion() -> Recording:
    return moving(Truth(arm()), 0, 40.0, 1.2, 3)


def with_order(r: Recording, order: list[int], signals: tuple[str, ...]) -> Recording:
    return replace(r, **{x: np.ascontiguousarray(getattr(r, x)[:, order]) for x in signals})


@pytest.mark.parametrize("signals", [ALL, TORQUE])
@pytest.mark.parametrize("order", [[1, 0, 2], [0, 2, 1], [2, 1, 0]])
def test_exchanged_columns_are_told(tmp_path: Path, motion: Recording, order: list[int], signals: tuple[str, ...]) -> None:
    robot, wrong = arm(mass=0.95, shift=0.003), with_order(motion, order, signals)
    write_recordings(tmp_path / "rec.parquet", META, [wrong])
    (i,) = inspect_recordings([tmp_path / "rec.parquet"], robot)
    (found,) = [f for f in i.findings if f.severity == "error"]
    names = " and ".join(j for k, j in enumerate(JOINTS) if order[k] != k)
    what = "torques" if signals == TORQUE else "angles, speeds and torques"
    assert found.kind == "joint_order" and found.seen.startswith(f"{what} of {names} stand")
    with pytest.raises(RecordingError, match=f"{names} stand in each other's place"):
        check_signals(robot, META, [wrong])


@pytest.mark.parametrize("robot", [arm(), arm(mass=0.7, shift=0.02), arm(mass=1.6), arm(sheet=False)])
def test_an_arm_in_order_is_not_accused(motion: Recording, robot: object) -> None:
    assert exchanged(robot, [motion]) is None  # type: ignore[arg-type]
    assert exchanged(robot, [motion.cut(0, 200)]) is None  # type: ignore[arg-type]


@pytest.mark.shared
def test_a_real_arm_whose_driver_lists_the_elbow_first(shared_data: Callable[[str], Path]) -> None:
    robot = load_robot(shared_data("ur10e/robot.urdf"))
    trials = [
        r
        for name in ("identification", "validation", "payload_a")
        for r in read_recordings(shared_data(f"ur10e/{name}.parquet"), robot)
    ]
    assert all(exchanged(robot, [r]) is None for r in trials)
    ros = np.array([2, 1, 0, 3, 4, 5]).tolist()
    found = exchanged(robot, [with_order(r, ros, ALL) for r in trials[:5]])
    assert found is not None and found.joints == (0, 2) and found.motion
