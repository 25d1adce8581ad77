"""Recordings of somebody else's simulator: other controllers, filters, motions and arms than our own blocks have."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
import found_outside
import found_pairs

from stopset.offline.description import load_robot
from stopset.offline.inspect.contradiction import loaded_trials, sums_of
from stopset.simulation import prepare


@pytest.mark.parametrize(
    ("seed", "healthy"),
    [
        (
            117001,
            False,
        ),  # torque through a filter of 20 Hz, 6 ms late at 100 Hz: gravity that came late was 11 % more friction of a shoulder
        (117014, False),  # a model of two circles, at other poses: a spring beside a torque scale of 9 % that takes it away again
        (119001, True),  # such a filter rounds reversals off: hysteresis over 0.2 mrad, which pass from one row to the next
    ],
)
def test_of_a_healthy_arm_nothing_is_named(seed: int, healthy: bool) -> None:
    answer: dict[str, Any] = found_outside.asked(seed, healthy)
    assert not answer["named"] and not answer["changed"], answer


def test_a_drive_that_tells_too_much_tells_no_friction_that_changed() -> None:
    """Beside a torque scale of 14 % the joint's friction "changed" from 0.90 to 1.16 N m: its torque was taken as recorded."""
    answer = found_outside.asked(123012)
    assert answer["named"] == ["torque_gain:bench_2"] and not answer["changed"], answer


def test_a_gas_spring_many_times_its_joints_friction_is_no_cable() -> None:
    """A prior of a share of that friction drew 19 N m towards none, and its levers to an end of their range: a cable was likelier."""
    answer = found_outside.asked(124003, others=True)
    assert answer["named"] == ["counterbalance:cobot_2"], answer


@pytest.mark.parametrize("script", [found_outside, found_pairs])
def test_no_answers_are_no_figure(script: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for folder in (tmp_path, tmp_path / "misspelt"):
        with pytest.raises(SystemExit) as left:
            script.main(["rate", "--out", str(folder)])
        said = capsys.readouterr()
        assert left.value.code == 2 and not said.out and "holds no answers" in said.err and said.err.count("\n") == 1
    assert not (tmp_path / "misspelt").exists()


def test_trials_of_a_healthy_arm_carry_no_loads() -> None:
    """By what the longest of six motions leaves open another one was 11 N m off "as if 3.9 kg hung at the flange"."""
    robot, seed = load_robot("lwa4p"), 150077
    scenario = prepare(robot, ["none"], seed, "short", cad="wrong" if seed % 3 else "exact")
    case = found_pairs.weeks_later(found_pairs.drawn(seed, robot.n), seed)
    trials = found_pairs.recorded(scenario, (12.0, 14.0, 16.0, 18.0, 13.0, 15.0), 125.0, case.trouble, seed + 100).trials
    sums = {r.label: data for r in trials if (data := sums_of(robot, r)) is not None}
    assert len(sums) == 6 and not loaded_trials(robot, sums)
