"""The momenta of all joints bound their speeds, whoever rests, and the brakes' work bounds how far a point gets: sampled stops of light, loaded
arms stay inside, and each bound that leaves out a part of its proof is escaped."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from stop_sampling import DT, Measured, draws, point_motion, sample_stops, tool_travel
from stopset.artifact import Model
from stopset.reach.stops import StopBounds
from stopset.reach.stops.cartesian import Slices
from stopset.reach.stops.parts import ALL_PARTS, Parts
from stopset.reach.stops.setting import Setting
from stopset.reach.stops.start import Start
from stopset.reach.stops.tube import OK, Tube
from stopset.reach.stops.tubes import march_box
from stopset.robot.rigid import link_frames
from stopset.simulation.stop import simulate_stops
from stopset.types import Array

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from stop_arms_wide import cobot7_like, random_arm, ur10e_like


def loaded(model: Model) -> Setting:
    rated = model.domain.payload[1]
    s = StopBounds.of(model, (0.98 * rated, rated)).setting
    assert s is not None
    return s


def tube_from(s: Setting, seed: int, parts: Parts = ALL_PARTS) -> tuple[Array, Array, Tube]:
    """A random state up to full speed and its tube with all there is."""
    n, rng = s.model.n, np.random.default_rng(seed)
    q, dq = rng.uniform(-np.pi, np.pi, n), rng.uniform(-1.0, 1.0, n) * s.model.domain.dq.hi
    return q, dq, march_box(s, s.plant, Start(q, dq, s.noise.radius[:n], s.noise.radius[n:]), parts, energetic=True)


@pytest.mark.parametrize("make", [ur10e_like, cobot7_like, lambda: random_arm(7, 1)], ids=["UR10e", "cobot", "random"])
def test_sampled_stops_stay_inside(make) -> None:  # type: ignore[no-untyped-def]
    s = loaded(make())
    n = s.model.n
    for seed in range(3):
        q, dq, tube = tube_from(s, seed)
        assert tube.end == OK
        far = tool_travel(s, q, s.noise.radius[:n], tube)
        x = sample_stops(s.plant, q, dq, s.noise.radius[:n], s.noise.radius[n:], s.payload_com, tube, 100, seed)
        assert x.escaped == 0 and x.tcp <= far


def test_a_resting_joint_is_pulled() -> None:
    """Bounds of momenta that forget what the others pull at a joint that rests are escaped."""
    s = loaded(random_arm(6, 0))
    n = s.model.n
    q, dq, tube = tube_from(s, 2, ALL_PARTS._replace(pull=0.0))
    assert tube.end == OK
    assert sample_stops(s.plant, q, dq, s.noise.radius[:n], s.noise.radius[n:], s.payload_com, tube, 40, 2).escaped > 0


def test_what_holds_the_energy_is_braked() -> None:
    """Bounds in which momenta are counted for a third less than they are lose energy that is still there: they are escaped."""
    s = loaded(ur10e_like())
    q, dq, tube = tube_from(s, 0, ALL_PARTS._replace(held=0.7))
    assert tube.end == OK
    assert sample_stops(s.plant, q, dq, s.noise.radius[:6], s.noise.radius[6:], s.payload_com, tube, 40, 2).escaped > 0


def travels(s: Setting, q: Array, dq: Array, tube: Tube, count: int) -> float:
    """Largest of sum_i (all of the way of joint i from a knot on) / way_i over sampled stops and knots."""
    n, steps, worst = s.model.n, int(np.ceil(tube.t[-1] / DT)) + 2, 0.0
    at = Measured(q, dq, s.noise.radius[:n], s.noise.radius[n:])
    x = draws(s.plant, at, np.arange(count) % 5, np.random.default_rng(5))
    for qs in simulate_stops(x.arms, x.q0, x.v0, DT, steps, x.u)[0]:
        gone = np.vstack([np.zeros(n), np.abs(np.diff(qs, axis=0)).cumsum(axis=0)])
        knots = np.minimum(np.ceil(tube.t / DT).astype(int), steps)  # a little later than the knot: no more is left
        worst = max(worst, float(((gone[-1] - gone[knots]) / tube.travel_left).sum(axis=1).max()))
    return worst


def test_the_brakes_work_bounds_all_ways_together() -> None:
    s = loaded(ur10e_like())
    for seed in range(3):
        q, dq, tube = tube_from(s, seed)
        assert np.isfinite(tube.travel_left).any()
        assert 0.05 < travels(s, q, dq, tube, 40) <= 1.0
    # on one joint nothing is lost but what is not known
    alone = loaded(random_arm(2, 0))
    q, dq, tube = tube_from(alone, 1)
    assert 0.6 < travels(alone, q, dq, tube, 40) <= 1.0


def test_a_point_stays_within_what_is_left() -> None:
    """Every displacement of a box and on from there is in the point's sets; left out what is left, it is not."""
    s, rng = loaded(cobot7_like()), np.random.default_rng(3)
    n, chain = s.model.n, s.plant.chain
    q, lo, hi = rng.uniform(-2.0, 2.0, n), np.full((1, n), -0.05), np.full((1, n), 0.1)
    left = rng.uniform(0.1, 0.5, (1, n))
    anywhere = Slices(np.array([0.0, 1.0]), np.full((1, n), -3.0), np.full((1, n), 3.0), 0.0 * lo, 0.0 * hi, lo, hi, left)
    far, _, box = point_motion(chain, q, np.zeros(n), anywhere, n - 1, s.payload_com)
    none, _, _ = point_motion(chain, q, np.zeros(n), anywhere._replace(left=0.0 * left), n - 1, s.payload_com)
    start, worst = _point(chain, q, s.payload_com), 0.0
    for k in range(4000):
        d = np.where(rng.random(n) < 0.5, lo[0], hi[0])
        on = np.zeros(n)
        on[rng.integers(n)] = 1.0 if k % 2 else -1.0
        p = _point(chain, q + d + on * left[0], s.payload_com) - start
        worst = max(worst, float(np.linalg.norm(p)))
        assert np.all(box[:, 0] <= p) and np.all(p <= box[:, 1])
    assert none < worst <= far


def _point(chain, q: Array, point: Array) -> Array:  # type: ignore[no-untyped-def]
    R, o = link_frames(chain, q[None])
    out: Array = o[0, -1] + R[0, -1] @ point
    return out


def test_bred_stops_go_farther() -> None:
    """Stops bred from the farthest directed ones come nearer to the bound than as many more directed ones, and none leaves it."""
    s = loaded(random_arm(7, 1))
    n = s.model.n
    q, dq, tube = tube_from(s, 0)
    at = q, dq, s.noise.radius[:n], s.noise.radius[n:]
    more = sample_stops(s.plant, *at, s.payload_com, tube, 750, 1)
    bred = sample_stops(s.plant, *at, s.payload_com, tube, 250, 1, 500)
    assert more.stops == bred.stops and more.escaped == bred.escaped == 0
    way = [np.maximum(x.forward, x.back) for x in (more, bred)]
    assert np.mean(way[1] / way[0]) > 1.0 and np.all(way[1] > 0.98 * way[0])
