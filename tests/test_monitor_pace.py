"""How fast samples come: another cycle than the model's is said as that, and what scatters, is lost or held up is none."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest

from monitor_arm import known_model
from stopset.monitor.jointstate import JointState, to_json
from stopset.monitor.pace import ANOTHER, LEAST, LONG, MOST, Pace
from stopset.monitor.rhythm import HOP, STAMPS, Rhythm
from stopset.monitor.source import JointStateSource

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from monitor_pace import stamps

PERIOD, START = 0.01, 1.7e9
JOINTS = known_model().joints


def paced(times: list[float], period: float = PERIOD) -> list[str]:
    """What is said after each sample of a sender of ``joint_states`` with these stamps [s]."""
    source, pace, said = JointStateSource(JOINTS, period), Pace(period), []
    for t in times:
        source.take("", to_json(JointState(round(t * 1e9), JOINTS, (0.1,) * 6, (0.0,) * 6, (0.0,) * 6)))
        if (sample := source.next(0.0)) is not None:
            pace.take(sample.t)
        said.append(pace.why)
    return said


@pytest.mark.parametrize("ratio", [0.25, 0.5, 0.9, 0.97, 1.03, 1.05, 1.5, 2.0, 3.0])
def test_another_cycle_is_said_as_that(ratio: float) -> None:
    """1.05: a logger found in the field. Whatever becomes of its samples otherwise, within two thirds of a second."""
    said = paced([START + ratio * PERIOD * k for k in range(1000)])
    seen, last = f"samples come every {10 * ratio:.3g} ms", 2 * LEAST if abs(ratio - 1) > 0.04 else MOST
    assert all(why.startswith(seen) and "identified at steps of 10 ms" in why for why in said[last:]), set(said[last:])


def test_a_sender_that_scatters_is_known_too() -> None:
    rng = np.random.default_rng(0)
    said = paced([START + 0.0105 * k + rng.normal(0.0, 2e-4) for k in range(2000)])
    assert np.mean([bool(why) for why in said[MOST:]]) == 1.0


@pytest.mark.parametrize(
    ("scatter", "lost", "held_up"), [(0, 0, 0), (2e-4, 0.1, 0), (1e-3, 0.02, 0), (2.5e-3, 0.02, 0), (0, 0.3, 0), (0, 0, 0.2), (2e-4, 0.1, 0.1)]
)  # fmt: skip
def test_what_scatters_is_lost_or_held_up_is_no_other_cycle(scatter: float, lost: float, held_up: float) -> None:
    said = 0
    for seed in range(5):
        rng, late, times = np.random.default_rng(seed), 0.0, []
        for k in range(2000):
            late += rng.uniform(0.0, PERIOD) if rng.random() < held_up else 0.0  # and what follows is late by as much
            if rng.random() >= lost:
                times.append(START + PERIOD * k + late + rng.normal(0.0, scatter))
        said += sum(bool(why) for why in paced(times))
    assert said <= 0.001 * 5 * 2000, said


def test_no_pause_no_set_clock_and_no_stamp_that_is_none_is_another_cycle() -> None:
    pace, t = Pace(PERIOD), START
    for k in range(2000):
        t += {500: 3600.0, 900: -0.5, 1300: -3600.0}.get(k, PERIOD)
        pace.take(0.0 if k % 50 == 7 else t)  # a frame without a time is as old as can be
        assert not pace.why, (k, pace.why)
    for _ in range(MOST):
        pace.take(math.nan)
    assert pace.why, "and what cannot be told is not good"
    assert Pace(PERIOD).why == "" and ANOTHER < 0.05


@pytest.mark.parametrize("before", [0, 200])
def test_making_up_for_a_pause_does_not_make_another_cycle_good(before: int) -> None:
    """A sender 5 % too slow that stands still for 30 ms and then sends what waited: when the pause has left what is looked at, the mean is right."""
    pace, t, said = Pace(0.004), START, []
    for k in range(before):
        pace.take(START + 0.0042 * k)
    for k in range(before, before + 600):
        due = START + 0.0042 * k
        held_up = due // 0.7 * 0.7 + 0.03  # once in 0.7 s
        t = max(due, held_up, t + 1e-4)
        pace.take(t)
        said.append(pace.fault)
    assert all(said) and sum("samples come every 4.2 ms" in why for why in said) > 400


@pytest.mark.parametrize("held_up", [0.0, 0.03])
def test_stamps_that_scatter_by_a_quarter_of_a_cycle_hide_another_one_for_seconds_and_not_for_ever(held_up: float) -> None:
    """5 % too slow, each stamp late by some 1 ms: of 128 intervals none is surely another cycle's. And one that is set right is good again."""
    slow, right = stamps(0.0042, 1e-3, held_up, 6000), stamps(0.004, 1e-3, 0.0, 3000)
    pace, said = Pace(0.004), []
    for t in [*slow, *(slow[-1] + right)]:
        pace.take(START + t)
        said.append(pace.fault)
    assert all(why.startswith("samples come every 4.") for why in said[LONG // 2 : len(slow)])
    assert not any(said[len(slow) + LONG :])


@pytest.mark.parametrize(("period", "scatter", "held_up", "lost"), [
    (0.0041, 1e-3, 0.0, 0.0), (0.0041, 1e-3, 0.03, 0.03), (0.0041, 2e-3, 0.0, 0.0), (0.0041, 2e-3, 0.03, 0.0), (0.0042, 2e-3, 0.03, 0.03),
    (0.0039, 1e-3, 0.0, 0.0), (0.0039, 2e-3, 0.03, 0.0),
])  # fmt: skip
def test_a_cycle_a_little_off_is_told_by_its_line_where_stamps_scatter(
    period: float, scatter: float, held_up: float, lost: float
) -> None:
    """2.5 % beside the tolerated 2, stamps late by up to half a cycle and more: told within five seconds, and then for good."""
    t = stamps(period, scatter, held_up, 6000)
    pace, said = Pace(0.004), []
    for x in t[np.random.default_rng(1).random(len(t)) >= lost].tolist():
        pace.take(START + x)
        said.append(pace.why)
    assert all("samples come every" in why for why in said[1300:]), sum(not why for why in said[1300:])


@pytest.mark.parametrize("off", [-5e-4, 5e-4, 0.019])
@pytest.mark.parametrize(
    ("scatter", "held_up", "lost"), [(1e-3, 0.03, 0.1), (2e-3, 0.0, 0.1), (2e-3, 0.03, 0.03), (1e-3, 0.0, 0.3)]
)
def test_the_line_of_a_tolerated_cycle_is_no_other_one(off: float, scatter: float, held_up: float, lost: float) -> None:
    """Lost samples make the mean another cycle's, so the line is looked for in all of them."""
    for seed in range(3):
        t, rhythm = stamps(0.004 * (1.0 + off), scatter, held_up, 6000), Rhythm(0.004, ANOTHER)
        t = t[np.random.default_rng(seed).random(len(t)) >= lost]
        for k in range(STAMPS, len(t), HOP):
            rhythm.take(t[k - STAMPS : k])
            assert rhythm.other() == 0.0, k


def test_stamps_without_a_cycle_of_their_own_have_no_line() -> None:
    """Each as late as the one before and by some more now and then, or any instants at all: broad hills, and noise."""
    for seed in range(10):
        rng = np.random.default_rng(seed)
        onward = np.cumsum(np.where(rng.random(6000) < 0.2, rng.uniform(0.004, 0.008, 6000), 0.004))
        for t in (onward, np.cumsum(rng.exponential(0.0041, 6000))):
            rhythm = Rhythm(0.004, ANOTHER)
            for k in range(STAMPS, len(t), HOP):
                rhythm.take(t[k - STAMPS : k])
                assert rhythm.other() == 0.0, (seed, k)
