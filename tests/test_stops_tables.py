"""Single-axis tables at full extension: certified, above the slowest simulated stop, tighter than the prototype's, and shaped like
the published tables of other arms."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stopset.reach.stops import Ramp, StopBounds
from stopset.sets import Box

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from stop_arms import prbt_like
from stops_tables import SHARES, TOP, table

# certified bounds [deg] of the prototype, 0.25 kg (none for joint 3 at full speed)
PROTOTYPE = {0: (0.92, 2.16, 3.68), 1: (1.86, 3.54, 5.72), 2: (1.45, 2.85, np.inf)}


@pytest.fixture(scope="module")
def light() -> dict:  # type: ignore[type-arg]
    return table((0.23, 0.25), pieces=1)


@pytest.fixture(scope="module")
def heavy() -> dict:  # type: ignore[type-arg]
    return table((3.0, 3.1), pieces=1)


def test_every_cell_is_certified_by_one_tube_and_holds_the_slow_corner(light: dict, heavy: dict) -> None:  # type: ignore[type-arg]
    for cells in (light, heavy):
        for cell in cells.values():
            assert cell.layer == "tube"
            assert cell.nominal[0] < cell.slow[0] <= cell.bound[0] and cell.nominal[1] < cell.slow[1] <= cell.bound[1]


def test_no_cell_is_looser_than_the_prototype(light: dict) -> None:  # type: ignore[type-arg]
    for joint, angles in PROTOTYPE.items():
        for share, angle in zip(SHARES, angles, strict=True):
            assert np.rad2deg(light[joint, share].bound[0]) <= angle


def test_power_off_grows_between_linear_and_quadratic_and_downwards_is_longer(light: dict, heavy: dict) -> None:  # type: ignore[type-arg]
    for cells in (light, heavy):
        for joint in (0, 1, 2):
            slow, fast = cells[joint, 0.33].bound[0], cells[joint, 1.0].bound[0]
            assert 1.0 < np.log(fast / slow) / np.log(1 / 0.33) < 2.0
        # UR5: 2.3 with 5 kg; here the rotors carry more of the inertia
        assert 1.2 < cells[1, 1.0].bound[0] / cells[0, 1.0].bound[0] < 2.5
    for key in light:
        assert heavy[key].bound[0] > light[key].bound[0] and heavy[key].bound[1] > light[key].bound[1]


@pytest.mark.parametrize("brake", [222.0, 40.0, 15.0])
def test_a_long_stop_is_shaped_like_the_vendors(brake: float) -> None:
    """s / (v t): 0.5 for a constant deceleration from the start; vendors' stops of 150 to 530 ms have 0.35 to 0.51, the delay of
    short ones raises it."""
    model = prbt_like((0.0, 0.25))
    torque = model.brakes.torque.centre.copy()
    torque[0] = brake
    weak = replace(model.brakes, torque=Box.of(0.9 * torque, 1.1 * torque))
    bound = StopBounds.of(replace(model, brakes=weak)).bound(np.zeros(6), TOP * np.eye(6)[0])
    assert bound.certified
    shape = bound.angle[0] / (TOP * bound.time[0])
    assert 0.35 <= shape <= 1.0
    if bound.time[0] > 0.15:
        assert shape <= 0.65


def test_a_published_fixed_time_ramp_is_reproduced() -> None:
    """Techman TM5-700, category 1, full load and extension, axis 1: 8.94, 17.86 and 26.00 degrees at 33, 66 and 100 % of 180 deg/s,
    the same for every load: a ramp of 0.295 s."""
    model = prbt_like((0.0, 3.0), top_speed=np.pi)
    exact = Box.symmetric(np.full(12, 1e-12))
    strong = replace(model.robot, torque_limit=np.full(6, 1e4), dq_limit=np.full(6, np.pi))
    model = replace(model, robot=strong, sets={"powered": replace(model.powered, V=exact)})
    ramp = Ramp.stated(6, time=0.295, control=0.0)
    for payload in ((1.0, 1.0), (3.0, 3.0)):
        bounds = StopBounds.of(model, payload, ramp=ramp)
        for share, degrees in ((0.33, 8.94), (0.66, 17.86), (1.0, 26.00)):
            angle = np.rad2deg(bounds.bound(np.zeros(6), share * np.pi * np.eye(6)[0], "1").forward[0])
            assert angle == pytest.approx(degrees, rel=0.03)
