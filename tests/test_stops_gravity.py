"""Gravity over all poses: what is bounded is never exceeded and nearly met, and stops that brakes surely end are given a number."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize

from stop_sampling import sample_stops
from stopset.reach.stops import StopBounds
from stopset.reach.stops.expansion import expand
from stopset.reach.stops.gravity import gravity_curvature
from stopset.reach.stops.start import Start
from stopset.reach.stops.tube import OK
from stopset.reach.stops.tubes import tubes_of
from stopset.robot.rigid import Chain, gravity_torque
from stopset.types import Array

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from stop_arms_wide import random_arm


def arm_of(n: int, seed: int) -> tuple[Chain, Array]:
    """An arm whose axes, offsets and centres point anywhere, on a base that hangs askew."""
    rng = np.random.default_rng([n, seed])
    R = np.array([np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(n)])
    R *= np.sign(np.linalg.det(R))[:, None, None]
    axis = rng.normal(size=(n, 3))
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    if seed % 2:  # axes that are nearly each other's: most angles to gravity are then out of reach
        R, axis = np.tile(np.eye(3), (n, 1, 1)), np.array([0.0, 0.0, 1.0]) + 0.2 * rng.normal(size=(n, 3))
        axis /= np.linalg.norm(axis, axis=1)[:, None]
    pi = np.zeros((n, 10))
    pi[:, 0], pi[:, 1:4] = rng.uniform(0.5, 5.0, n), rng.normal(scale=0.5, size=(n, 3))
    gravity = np.array([0.0, 0.0, 9.81 if seed % 3 == 1 else -9.81]) + (rng.normal(size=3) if seed % 3 else 0.0)
    return Chain(R, rng.normal(scale=0.3, size=(n, 3)), axis, gravity), pi


def largest_found(chain: Chain, pi: Array, i: int, seed: int) -> float:
    rng = np.random.default_rng(seed)

    def less(q: Array) -> float:
        return -abs(float(gravity_torque(chain, pi, q)[i]))

    best = 0.0
    for _ in range(6):
        first = min(rng.uniform(-np.pi, np.pi, (100, len(pi))), key=less)
        best = max(best, -float(minimize(less, first, method="L-BFGS-B").fun))
    return best


@pytest.mark.parametrize(("n", "seed"), [(1, 0), (2, 1), (3, 2), (4, 3), (5, 4), (6, 5), (7, 6)])
def test_the_largest_gravity_is_never_exceeded_and_is_met(n: int, seed: int) -> None:
    chain, pi = arm_of(n, seed)
    bound = gravity_curvature(chain, pi)[1]
    for i in range(n):
        found = largest_found(chain, pi, i, seed)
        assert 0.99 * bound[i] <= found <= bound[i]


@pytest.mark.parametrize(("n", "seed"), [(3, 0), (4, 1), (5, 2), (6, 3), (7, 4), (7, 5)])
def test_second_slopes_of_gravity_are_bounded(n: int, seed: int) -> None:
    (chain, pi), rng, h = arm_of(n, seed), np.random.default_rng(seed), 1e-5
    bend, load = gravity_curvature(chain, pi)
    worst = 0.0
    for q in rng.uniform(-np.pi, np.pi, (150, n)):
        assert np.all(np.abs(gravity_torque(chain, pi, q)) <= load)
        for k in range(n):
            up, down = (expand(chain, pi, 0 * pi, np.zeros(n), q + s * h * np.eye(n)[k]).dg for s in (1, -1))
            slope = np.abs(up - down) / (2 * h)
            assert np.all(slope <= bend[:, :, k] + 1e-7)
            worst = max(worst, float(np.max(slope / bend[:, :, k])))
    assert worst > 0.7


def test_upright_axes_behind_one_another_feel_no_gravity() -> None:
    chain = Chain(
        np.tile(np.eye(3), (3, 1, 1)), np.full((3, 3), 0.3), np.tile([0.0, 0.0, 1.0], (3, 1)), np.array([0.0, 0.0, -9.81])
    )
    pi = np.zeros((3, 10))
    pi[:, :4] = [2.0, 0.4, 0.1, 0.3]
    bend, load = gravity_curvature(chain, pi)
    assert np.all(load < 1e-9) and np.all(bend < 1e-9)


def test_stops_that_brakes_surely_end_have_a_number() -> None:
    """Joints 2 and 3 of this arm are upright; the load's pull on them, bounded by its reach, was ten times their brakes: no number."""
    model = random_arm(6, 2)
    rated = model.domain.payload[1]
    s, rng = StopBounds.of(model, (0.98 * rated, rated)).setting, np.random.default_rng(1)
    assert s is not None
    r, v = s.noise.radius[:6], s.noise.radius[6:]
    for k in range(3):
        q, dq = rng.uniform(-np.pi, np.pi, 6), rng.uniform(-1.0, 1.0, 6) * model.domain.dq.hi
        tube = tubes_of(s, Start(q, dq, r, v), 1)[-1]
        assert tube.end == OK and np.all(tube.margin > 0.0)
        assert sample_stops(s.plant, q, dq, r, v, s.payload_com, tube, 40, k).escaped == 0
