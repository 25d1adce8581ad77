"""Where to: tool, links and swept capsules at every half millisecond of simulated stops; speeds in a direction and towards a place."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stop_sampling import DT, Measured, draws, point_motion
from stopset.errors import NotCovered
from stopset.reach.stops import StopBound, StopBounds
from stopset.reach.stops.cartesian import Slices
from stopset.reach.stops.swiftness import swiftness
from stopset.robot.rigid import link_frames
from stopset.simulation.stop import simulate_stops

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from stop_arms import prbt_like
from stop_arms_wide import arms

BOUNDS = StopBounds.of(prbt_like(), (0.0, 0.25))
PLACES = np.array([[0.5, 0.2, 0.3], [0.0, 0.0, 1.2], [-2.0, 1.0, 0.0]])


def states() -> list[tuple[np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(51)
    return [(rng.uniform(-2.3, 2.3, 6), rng.uniform(-1.26, 1.26, 6)) for _ in range(3)]


def outside(bound: StopBound, q: np.ndarray, dq: np.ndarray, stops: int, bounds: StopBounds = BOUNDS) -> set[str]:
    """Which statements about space some simulated stop contradicts."""
    s, n = bounds.setting, len(q)
    assert s is not None and bound.motion is not None and bound.capsules is not None
    chain, robot, found = s.plant.chain, bounds.model.robot, set()
    directions = np.vstack([np.eye(3), -np.eye(3), np.random.default_rng(1).normal(size=(4, 3))])
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    fast = np.array([bound.directed_speed(d) for d in directions])
    far = np.array([bound.directed_distance(d) for d in directions])
    closing = np.array([bound.speed_towards(x) for x in PLACES])
    at = Measured(q, dq, s.noise.radius[:n], s.noise.radius[n:])
    drawn = draws(s.plant, at, np.arange(stops) % 5, np.random.default_rng(2))
    moved = simulate_stops(drawn.arms, drawn.q0, drawn.v0, DT, int(bound.time.max() / DT) + 1, drawn.u)
    for q0, qs, vs in zip(drawn.q0, *moved, strict=True):
        R0, o0 = link_frames(chain, q0)
        ends0 = np.array([*o0[1:], o0[-1] + R0[-1] @ robot.tip])
        for qk, vk in zip(qs, vs, strict=True):
            R, o = link_frames(chain, qk)
            ends = np.array([*o[1:], o[-1] + R[-1] @ robot.tip])
            tip = o[-1] + R[-1] @ s.payload_com
            speed = sum(np.cross(R[i] @ chain.axis[i], tip - o[i]) * vk[i] for i in range(n))
            travel = tip - (o0[-1] + R0[-1] @ s.payload_com)
            toward = PLACES - tip
            checks = {
                "tcp": np.linalg.norm(travel) <= bound.tcp + 1e-6,
                "box": np.all(travel <= bound.tcp_box[:, 1] + 1e-6) and np.all(travel >= bound.tcp_box[:, 0] - 1e-6),
                "tcp speed": np.linalg.norm(speed) <= bound.tcp_speed + 1e-3,
                "directed speed": np.all(directions @ speed <= fast + 1e-3),
                "directed distance": np.all(directions @ travel <= far + 1e-6),
                "towards": np.all(toward @ speed / np.linalg.norm(toward, axis=1) <= closing + 1e-3),
                "links": np.all(np.linalg.norm(ends - ends0, axis=1) <= bound.links + 1e-6),
                "capsules": all(_inside(o[i], ends[i], bound.capsules[:, i]) for i in range(n)),
            }
            found |= {name for name, good in checks.items() if not good}
    return found


def _inside(a: np.ndarray, b: np.ndarray, capsules: np.ndarray) -> bool:
    """Both ends of a link's axis, and its middle, in one capsule."""
    for c in capsules:
        p, u = c[:3], c[3:6] - c[:3]
        gaps = []
        for x in (a, 0.5 * (a + b), b):
            t = np.clip((x - p) @ u / max(float(u @ u), 1e-15), 0.0, 1.0)
            gaps.append(np.linalg.norm(x - p - t * u))
        if max(gaps) <= c[6] + 1e-6:
            return True
    return False


def test_every_simulated_stop_stays_in_its_space() -> None:
    for q, dq in states():
        assert outside(BOUNDS.bound(q, dq), q, dq, 10) == set()


def light(k: int) -> tuple[StopBounds, np.ndarray, np.ndarray]:
    """A heavy load on light wrists, whose speeds the energy hardly bounds; a state of it."""
    model, top = arms()["random arm of 7 joints, 1"]
    rated, rng = model.domain.payload[1], np.random.default_rng(60 + k)
    return StopBounds.of(model, (rated, rated)), rng.uniform(-np.pi, np.pi, 7), rng.uniform(-1.0, 1.0, 7) * top


@pytest.mark.parametrize("k", range(3))
def test_every_stop_of_light_wrists_stays_in_its_space(k: int) -> None:
    bounds, q, dq = light(k)
    bound = bounds.bound(q, dq)
    assert bound.layer == "energy" and outside(bound, q, dq, 10, bounds) == set()


def test_a_body_told_slower_than_its_mass_makes_it_is_contradicted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("stopset.reach.stops.bounds.swiftness", lambda *x: 0.1 * swiftness(*x))
    found = set[str]()
    for k in range(3):
        bounds, q, dq = light(k)
        found |= outside(bounds.bound(q, dq), q, dq, 10, bounds)
    assert found >= {"tcp", "tcp speed", "directed speed", "directed distance", "towards", "links"}


def test_statements_made_too_small_are_contradicted() -> None:
    """The same sampling finds each of them wrong when it is weakened: lengths at 60 %, capsules at 30 %."""
    found = set()
    for q, dq in states():
        good = BOUNDS.bound(q, dq)
        m = good.motion
        capsules = good.capsules.copy()
        capsules[:, :, 6] *= 0.3
        weak = replace(
            good, tcp=0.6 * good.tcp, tcp_box=0.6 * good.tcp_box, tcp_speed=0.6 * good.tcp_speed, links=0.6 * good.links,
            capsules=capsules, motion=replace(m, travel=0.6 * m.travel, travel_ball=0 * m.travel_ball, pace=0.6 * m.pace, pace_ball=0 * m.pace_ball),
        )  # fmt: skip
        found |= outside(weak, q, dq, 5)
    assert found == {"tcp", "box", "tcp speed", "directed speed", "directed distance", "towards", "links", "capsules"}


def test_a_direction_is_a_direction_and_scales_do_not_matter() -> None:
    bound = BOUNDS.bound(*states()[0])
    assert bound.directed_speed([0, 0, 2.0]) == pytest.approx(bound.directed_speed([0, 0, 1.0]))
    # no direction is faster than the fastest
    assert bound.directed_speed([1, 1, 0]) <= 1.2 * bound.tcp_speed
    for bad in ([0, 0, 0], [np.nan, 0, 1], [1, 0]):
        with pytest.raises(NotCovered, match="direction"):
            bound.directed_speed(bad)
    refused = StopBound("0", False, "no stop provable")
    assert refused.directed_speed([1, 0, 0]) is None and refused.speed_towards([1, 0, 0]) is None


def test_joints_that_may_turn_anywhere_leave_no_farther_than_the_arm_reaches() -> None:
    chain, rng, tool = prbt_like().robot.chain, np.random.default_rng(8), np.array([0.05, 0.0, 0.1])
    turn, q = np.full((1, 6), np.pi), rng.uniform(-0.3, 0.3, 6)
    anywhere = Slices(np.array([0.0, 1.0]), -turn, turn, -turn, turn)
    far, _, box = point_motion(chain, q, np.zeros(6), anywhere, 5, tool)

    def place(q: np.ndarray) -> np.ndarray:
        R, o = link_frames(chain, q)
        return o[-1] + R[-1] @ tool

    moved = np.array([place(q + rng.uniform(-np.pi, np.pi, 6)) - place(q) for _ in range(20_000)])
    assert np.linalg.norm(chain.p[1:], axis=1).sum() < np.linalg.norm(moved, axis=1).max() <= far < 2.3
    assert np.all(moved >= box[:, 0]) and np.all(moved <= box[:, 1])
