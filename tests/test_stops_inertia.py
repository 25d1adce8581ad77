"""What the stop proofs know of the inertia near a pose, against a rigid body of points that shares no line with them: values and slopes
anywhere in a box lie inside, second slopes are exact, third ones are needed; and on light arms that closes the tube."""

from __future__ import annotations

import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from core_calls import inertia_box
from stop_tubes import tube_of
from stopset.reach.stops import StopBounds
from stopset.reach.stops.expansion import curvature
from stopset.reach.stops.parts import ALL_PARTS, Parts
from stopset.reach.stops.tube import OK, Plant
from stopset.robot.rigid import Chain

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from stop_arms import ur5_like

Array = np.ndarray
SHIFTS = (2 * np.arange(4) + 1) * np.pi / 4  # a slope of a trigonometric polynomial of degree 2 from four values, exactly
EPSILON = np.zeros((3, 3, 3))
EPSILON[[0, 1, 2], [1, 2, 0], [2, 0, 1]], EPSILON[[0, 2, 1], [2, 1, 0], [1, 0, 2]] = 1.0, -1.0
WEIGHTS = (-1.0) ** np.arange(4) / (8 * np.sin(SHIFTS / 2) ** 2)


class Points:
    """An arm whose links are points of positive mass (m,) at places (m, 3) in their frames; ``load``: on the last, known by half."""

    def __init__(self, n: int, seed: int) -> None:
        rng = np.random.default_rng([n, seed])
        unit = rng.normal(size=(n, 3))
        self.axis = unit / np.linalg.norm(unit, axis=1)[:, None]
        self.p = rng.normal(size=(n, 3)) * 0.25
        self.mass = rng.uniform(0.1, 2.0, (n, 4))
        self.at = rng.normal(size=(n, 4, 3)) * 0.15
        self.load, self.load_at = float(rng.uniform(0.5, 2.0)), rng.normal(size=3) * 0.2

    def rotation(self, i: int, angle: float) -> Array:
        x, y, z = self.axis[i]
        K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K

    def inertia(self, q: Array, share: float = 1.0, links: bool = True) -> Array:
        """(n, n) from every point's Jacobian, ``share`` of the load on top of it."""
        n, R, o = len(q), np.eye(3), np.zeros(3)
        M, z, at = np.zeros((n, n)), np.zeros((n, 3)), np.zeros((n, 3))
        for i in range(n):
            o, R = o + R @ self.p[i], R @ self.rotation(i, q[i])
            z[i], at[i] = R @ self.axis[i], o
            mass, x = self.mass[i] * links, self.at[i]
            if i == n - 1:
                mass, x = np.append(mass, share * self.load), np.vstack([x, self.load_at])
            away = o + x @ R.T - at[: i + 1, None]
            J = np.einsum("abc,kb,kmc->kma", EPSILON, z[: i + 1], away)
            M[: i + 1, : i + 1] += np.einsum("kma,lma,m->kl", J, J, mass)
        return M

    def slope(self, q: Array, k: int, share: float = 1.0, links: bool = True) -> Array:
        return sum(w * self.inertia(q + s * np.eye(len(q))[k], share, links) for w, s in zip(WEIGHTS, SHIFTS, strict=True))

    def bend(self, q: Array, k: int, o: int, share: float = 1.0, links: bool = True) -> Array:
        return sum(w * self.slope(q + s * np.eye(len(q))[o], k, share, links) for w, s in zip(WEIGHTS, SHIFTS, strict=True))

    def plant(self, spoilt: float = 0.0) -> Plant:
        """As the proofs are told it, the load known by half; ``spoilt`` [kg m^2] off the first inertia of a link in the middle."""
        n = len(self.p)
        pi, half = np.zeros((n, 10)), np.zeros((n, 10))

        def add(row: Array, m: float, x: Array) -> None:
            row += m * np.array([
                1, *x, x[1] ** 2 + x[2] ** 2, -x[0] * x[1], x[0] ** 2 + x[2] ** 2, -x[0] * x[2], -x[1] * x[2], x[0] ** 2 + x[1] ** 2
            ])  # fmt: skip

        for i in range(n):
            for m, x in zip(self.mass[i], self.at[i], strict=True):
                add(pi[i], m, x)
        add(pi[-1], self.load, self.load_at)
        add(half[-1], 0.5 * self.load, self.load_at)
        pi[n // 2, 4] -= spoilt
        chain = Chain(np.tile(np.eye(3), (n, 1, 1)), self.p, self.axis, np.array([0.0, 0.0, -9.81]))
        K = [x + y for x, y in zip(curvature(chain, pi), curvature(chain, half), strict=True)]
        none = np.zeros(n)
        return Plant(chain, pi, half, none, none, *[none] * 12, type(curvature(chain, pi))(*K))


def outside(arm: Points, plant: Plant, q: Array, far: Array, parts: Parts, seed: int, count: int = 25) -> float:
    """By how much sampled inertias and slopes leave what is known of them, at most, relative to the largest of them."""
    n, rng = len(q), np.random.default_rng(seed)
    M, dM, turn = inertia_box(plant, q, -far, far, parts)
    here = [[arm.slope(q, k, s) for k in range(n)] for s in (0.5, 1.5)]
    worst = -np.inf
    for _ in range(count):
        x = q + far * rng.choice([-1.0, 1.0], n) * (1.0 if rng.random() < 0.7 else rng.random())
        row = rng.integers(2)
        share = (0.5, 1.5)[row]
        worst = max(worst, float(np.max((np.abs(arm.inertia(x, share) - M) - dM) / M.max())))
        for k in range(n):
            off = np.abs(arm.slope(x, k, share) - here[row][k]) - turn[:, :, k]
            worst = max(worst, float(np.max(off) / M.max()))
    return worst


@pytest.mark.parametrize(("n", "seed"), [(2, 0), (3, 0), (4, 1), (6, 0), (7, 0)])
def test_inertia_and_slopes_stay_inside_from_narrow_boxes_to_wide(n: int, seed: int) -> None:
    arm, rng = Points(n, seed), np.random.default_rng(seed)
    plant = arm.plant()
    for size in (0.003, 0.03, 0.3, 1.0):
        q = rng.uniform(-np.pi, np.pi, n)
        far = size * rng.uniform(0.2, 1.0, n)
        assert outside(arm, plant, q, far, ALL_PARTS, seed, 25 if n < 6 else 8) <= 1e-12


def test_second_slopes_are_exact() -> None:
    """In a box as narrow as a hair nothing is left but second slopes: the bound is their size, of load and half its range added."""
    for n, seed in ((3, 2), (6, 3)):
        arm, rng, hair = Points(n, seed), np.random.default_rng(seed), 1e-6
        plant, q = arm.plant(), rng.uniform(-np.pi, np.pi, n)
        for o in range(n):
            turn = inertia_box(plant, q, -hair * np.eye(n)[o], hair * np.eye(n)[o], ALL_PARTS)[2]
            for k in range(n):
                size = np.abs(arm.bend(q, k, o)) + np.abs(arm.bend(q, k, o, 0.5, links=False))
                low = np.minimum.outer(np.arange(n), np.arange(n)) < k  # others do not change with joint k at all
                assert np.allclose(turn[:, :, k] / hair, np.where(low, size, 0.0), atol=1e-4)


def grown(plant: Plant, q: Array, far: Array, one: Array, two: Array) -> Array:
    """What the bound of slopes grows by where a box goes on by ``one`` and ``two``, beyond what it grows by for each: third slopes."""
    boxes = [inertia_box(plant, q, -f, f, ALL_PARTS)[2] for f in (far + one + two, far + one, far + two, far)]
    return boxes[0] - boxes[1] - boxes[2] + boxes[3]


def test_every_third_slope_is_within_what_bounds_it() -> None:
    for n, seed in ((3, 4), (5, 4)):
        arm, rng, d = Points(n, seed), np.random.default_rng(seed), 1e-3
        plant, q = arm.plant(), rng.uniform(-np.pi, np.pi, n)
        for _ in range(6):
            k, o, u = rng.integers(n, size=3)
            third = sum(w * arm.bend(q + s * np.eye(n)[u], k, o) for w, s in zip(WEIGHTS, SHIFTS, strict=True))
            bound = grown(plant, q, np.zeros(n), d * np.eye(n)[o], d * np.eye(n)[u])[:, :, k] / d**2
            assert np.all(np.abs(third) <= bound + 1e-6)


def test_a_mass_that_lies_on_an_axis_at_the_pose_alone_is_not_forgotten() -> None:
    """Far from the first axis a mass lies on the second, where the third joint has folded it: it leaves when that unfolds."""
    arm = Points(3, 0)
    arm.axis, arm.p = np.tile([0.0, 0.0, 1.0], (3, 1)), np.array([[0.0, 0, 0], [10.0, 0, 0], [0.5, 0, 0]])
    arm.mass[:], arm.load, arm.load_at = 1e-9, 1.0, np.array([0.5, 0, 0])
    plant, q, d = arm.plant(), np.array([0.0, 0.0, np.pi]), np.array([0.0, 1e-3, 0.0])
    x = q + np.array([0.0, 0.0, 1.0])
    third = sum(w * arm.bend(x + s * np.eye(3)[1], 1, 1) for w, s in zip(WEIGHTS, SHIFTS, strict=True))[0, 0]
    bound = grown(plant, q, np.array([0.0, 0.0, 1.0]), d, d)[0, 0, 1] / d[1] ** 2
    assert 1.0 < abs(third) <= bound < 20.0 * abs(third)


def test_half_the_bound_is_left_and_so_is_one_without_third_slopes() -> None:
    """What the tests above would not notice: the bound is no larger than twice what is sampled, and each of its parts is needed."""
    half = straight = 0.0
    for seed in range(4):
        arm, rng = Points(4, seed), np.random.default_rng(seed)
        plant = arm.plant()
        q, far = rng.uniform(-np.pi, np.pi, 4), np.full(4, 0.02)
        half = max(half, outside(arm, plant, q, far, Parts(bend=0.5), seed, 60))
        hair = 1e-5
        second = inertia_box(plant, q, -np.full(4, hair), np.full(4, hair), ALL_PARTS)[2] / hair
        for k in range(4):  # second slopes at the pose alone do not hold a wide box
            x = q + 0.5 * rng.choice([-1.0, 1.0], 4)
            straight = max(straight, float(np.max(np.abs(arm.slope(x, k) - arm.slope(q, k)) - 0.5 * second[:, :, k])))
    assert half > 1e-6
    assert straight > 0.0


def test_parameters_of_no_body_are_bounded_by_bernstein_alone() -> None:
    arm = Points(4, 5)
    q, far = np.array([0.3, -1.0, 0.7, 2.0]), np.full(4, 0.2)
    good, bad = arm.plant(), arm.plant(spoilt=1.5)
    tensor = bad.pi[2, [4, 6, 9]]
    assert tensor[1] > tensor[0] + tensor[2]  # no body has that
    turns = [inertia_box(p, q, -far, far, ALL_PARTS)[2] for p in (good, bad)]
    assert turns[1][0, 1, 1] > 1.2 * turns[0][0, 1, 1]
    # and what is bounded is what the proofs are told: their own slopes at other poses, of the parameters of no body
    rng = np.random.default_rng(1)
    M, dM, turn = inertia_box(bad, q, -far, far, ALL_PARTS)
    none = np.zeros(4)
    for _ in range(50):
        x = rng.uniform(-far, far)
        there, rest, _ = inertia_box(bad, q + x, none, none, ALL_PARTS)
        assert np.all(np.abs(there - M) + rest <= dM + 1e-12)
        h = 1e-5
        for k in range(4):
            up, down = (inertia_box(bad, q + x + s * h * np.eye(4)[k], none, none, ALL_PARTS)[0] for s in (1, -1))
            at_up, at_down = (inertia_box(bad, q + s * h * np.eye(4)[k], none, none, ALL_PARTS)[0] for s in (1, -1))
            assert np.all(np.abs((up - down) - (at_up - at_down)) / (2 * h) <= turn[:, :, k] + 1e-8)


def test_wider_boxes_know_less() -> None:
    arm = Points(5, 1)
    plant, q = arm.plant(), np.linspace(-1.0, 1.0, 5)
    boxes = [inertia_box(plant, q, np.full(5, -r), np.full(5, r), ALL_PARTS) for r in (0.01, 0.02, 0.1, 0.5, 2.0)]
    for (_, narrow, turned), (_, wide, further) in pairwise(boxes):
        assert np.all(narrow <= wide) and np.all(turned <= further)


def test_one_tube_closes_a_light_arm_with_its_payload() -> None:
    """5 kg on a UR5-like arm with a quarter of its rotors, up to 2 rad/s: nine of ten; three with bounds of second slopes over all poses."""
    s = StopBounds.of(ur5_like(), (4.9, 5.0)).setting
    assert s is not None
    rng, closed = np.random.default_rng(1), 0
    for _ in range(20):
        q, dq = rng.uniform(-np.pi, np.pi, 6), rng.uniform(-2.0, 2.0, 6)
        closed += tube_of(s, q, dq, s.noise.radius[:6], s.noise.radius[6:]).end == OK
    assert closed >= 16
