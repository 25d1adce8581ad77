"""What is left to limits, planes and wanted stops: never more than there is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from monitor_arm import known_model
from stopset.artifact import save_model
from stopset.monitor.certificates import Numbers
from stopset.monitor.config import ConfigError, Plane, StopLimits, Stops, load_config
from stopset.monitor.margins import ends, exceeded, margins, travels
from stopset.monitor.override import STRETCHES, keeps, largest_override
from stopset.monitor.stopworker import answer_for, prepare
from stopset.offline.description import load_robot
from stopset.types import Array

ROBOT = load_robot("lwa4p")
NONE = np.zeros(6)


def numbers(angle: float, time: float = 0.1, tcp: float = 0.05) -> Numbers:
    a = np.full(6, angle)
    return Numbers(np.full(6, time), a, a, tcp, np.full(6, True))


def outran(steps: int) -> tuple[Array, Array]:
    """Over random poses and joint motions: the farthest that ends of links got, and what was bounded, (steps, 6) each."""
    rng, got, bound = np.random.default_rng(0), np.zeros((steps, 6)), np.zeros((steps, 6))
    for k in range(steps):
        q, s = rng.uniform(-3, 3, 6), rng.uniform(0, 0.6, 6) * (rng.uniform(size=6) < 0.7)
        points, bound[k] = travels(ROBOT, q, s)
        corners = [q + s * c for c in rng.choice([-1.0, 1.0], (12, 6))] + [q + s * rng.uniform(-1, 1, 6) for _ in range(4)]
        got[k] = np.max([np.linalg.norm(ends(ROBOT, x)[0] - points, axis=1) for x in corners], axis=0)
    return got, bound


def test_no_end_of_a_link_outruns_its_bound() -> None:
    got, bound = outran(300)
    assert np.all(got <= bound + 1e-12)
    moved = bound > 0.05
    assert 1.0 < np.median(bound[moved] / got[moved]) < 3.0, "and it is of use"


def test_planes_joint_limits_and_wanted_stops() -> None:
    q = np.array([0.0, 0.3, 0.2, 0.1, 0.0, 0.0])
    floor = Plane("floor", (0.0, 0.0, 2.0), 0.0)
    limits = StopLimits("0", time_s=0.2, tcp_m=0.04, radius_m=0.05, planes=(floor,))
    found = margins(ROBOT, limits, q, numbers(0.01), np.full(6, 1e-3))
    assert found["planes_m"]["floor"] == pytest.approx(ends(ROBOT, q)[0][0, 2] - 0.05), "the shoulder, which stays where it is"
    front = Plane("front", (1.0, 0.0, 0.0), -1.0)
    left = margins(ROBOT, replace(limits, planes=(front,)), q, numbers(0.01), NONE)["planes_m"]["front"]
    assert 0.0 < 1.0 + float(ends(ROBOT, q)[0][:, 0].min()) - 0.05 - left < 0.05
    assert found["joint_limits_rad"]["arm_2_joint"] == pytest.approx(ROBOT.q_limit[1, 1] - 0.3 - 0.011)
    assert found["time_s"] == pytest.approx(0.1) and found["angle_rad"] is None
    assert exceeded(found) == ["limits.tcp_m"]
    wall = replace(floor, name="wall", normal=(1.0, 0.0, 0.0), offset=10.0)
    assert "plane wall" in exceeded(margins(ROBOT, replace(limits, planes=(wall,)), q, numbers(0.01), NONE))
    assert margins(ROBOT, limits, q, Numbers.none(6, "no bound"), NONE) == {"certified": False, "why": "no bound"}


def test_the_override_is_proven_for_all_slower_speeds(tmp_path: Path) -> None:
    """By the stop bounds themselves, on an arm that moves; a speed just above the answer's next stretch is not kept."""
    path = tmp_path / "arm.model.json"
    save_model(known_model(), path)
    prepared, why = prepare(str(path), None, Stops(("0",)))
    assert prepared is not None, why

    def bound(lo: Array, hi: Array) -> Numbers:
        return answer_for(prepared, "0", lo, hi).numbers

    q, dq = np.array([0.2, 0.4, 0.6, 0.1, 0.3, 0.0]), np.array([1.0, -0.6, 0.5, 0.4, -0.5, 0.8])
    whole = bound(np.concatenate([q, dq]), np.concatenate([q, dq]))
    assert whole.provable.all(), whole.why
    hidden = np.r_[np.full(6, 5e-4), np.full(6, 5e-3)]  # by the bus, of angles and speeds
    assert largest_override(bound, q, dq, hidden, StopLimits("0")) == 1.0
    wanted = StopLimits("0", tcp_m=0.5 * whole.tcp)
    part = largest_override(bound, q, dq, hidden, wanted)
    assert 0.2 <= part < 1.0
    rng = np.random.default_rng(0)
    for x in [*rng.uniform(0.0, part, 10), part, part]:
        assert keeps(bound(*[np.concatenate([q, x * dq]) + hidden * rng.choice([-1.0, 1.0], 12)] * 2), wanted)
    faster = min(1.0, part + 2 / STRETCHES)
    assert not keeps(bound(*[np.concatenate([q, faster * dq])] * 2), wanted), "and it is not far below the truth"
    assert largest_override(bound, q, dq, hidden, StopLimits("0", tcp_m=1e-6)) == 0.0


def test_the_override_looks_at_all_that_a_reading_may_hide() -> None:
    """Every state at every part of the speed is in a box that was bounded: joints that hardly move, and what the bus rounds away."""
    q, dq, hidden = np.zeros(6), np.array([1.0, 9e-4, -9e-4, 0.5, 0.0, -0.3]), np.r_[np.full(6, 1e-4), np.full(6, 2e-3)]
    boxes: list[tuple[Array, Array]] = []

    def bound(lo: Array, hi: Array) -> Numbers:
        boxes.append((lo, hi))
        return numbers(0.01)

    assert largest_override(bound, q, dq, hidden, StopLimits("0")) == 1.0
    rng = np.random.default_rng(2)
    for part in np.linspace(0.0, 1.0, 300):
        x = np.concatenate([q, part * dq]) + hidden * rng.choice([-0.999, 0.999], 12)
        assert any(np.all(lo <= x) and np.all(x <= hi) for lo, hi in boxes)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ('[limits]\ncategory = "1"', "expected one that is bounded"),
        ("[limits]\ntcp_m = 0.0", "limits.tcp_m"),
        ("[limits]\nplanes = [{name = 'x', normal = [0.0, 0.0, 0.0], offset = 0.0}]", "not all zero"),
        ("[limits]\nplanes = [{name = 'x', normal = [0.0, 1.0], offset = 0.0}]", "three numbers"),
    ],
)
def test_limits_that_make_no_sense_are_refused(text: str, word: str, tmp_path: Path) -> None:
    path = tmp_path / "c.toml"
    path.write_text('model = "m"\ndata_id = 1\n[bus]\nlink = "hub:1"\n[stops]\ncategories = ["0"]\n' + text)
    with pytest.raises(ConfigError, match=word):
        load_config(path)
