"""Speeds that momenta in a box leave open, and momenta of joints that do not move on: a search over poses, payloads and rotors with the rigid
body that identification uses finds none outside; what one angle does to all joints at once is counted once; bounds that count half of it are left."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from stopset.artifact import Model
from stopset.core.library import check, ffi, lib, view
from stopset.reach.stops import StopBounds
from stopset.reach.stops.parts import ALL_PARTS, Parts
from stopset.reach.stops.tube import Plant, plant_struct
from stopset.robot.rigid import mass_matrix
from stopset.types import Array

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from stop_arms_wide import cobot7_like, random_arm, ur10e_like

from core_calls import range_struct, states_struct


class Case(NamedTuple):
    """A box around a pose: angles, speeds and momenta (n,)."""

    plant: Plant
    q: Array
    x: tuple[Array, Array]
    v: tuple[Array, Array]
    p: tuple[Array, Array]


def inertia(c: Case, at: Array) -> Array:
    """Of the case with ``at`` [0, 1] for angles, rotors and the payload."""
    n, p = len(c.q), c.plant
    q, pi = c.q + c.x[0] + at[:n] * (c.x[1] - c.x[0]), p.pi + (2.0 * at[-1] - 1.0) * p.pi_half
    return np.asarray(mass_matrix(p.chain, pi, q) + np.diag(p.rotor + (2.0 * at[n : 2 * n] - 1.0) * p.rotor_half))


def case_of(model: Model, seed: int, size: float, rotor: float, momentum: float = 0.02) -> Case:
    """Momenta around those of some speeds in the middle of the box, which holds all speeds that they allow."""
    s = StopBounds.of(model, (0.9 * model.domain.payload[1], model.domain.payload[1])).setting
    assert s is not None
    plant, n, rng = s.plant._replace(rotor_half=rotor * s.plant.rotor), model.n, np.random.default_rng(seed)
    off, wide, middle = size * rng.uniform(-0.5, 0.5, n), size * rng.uniform(0.2, 1.0, n), rng.uniform(-2.0, 2.0, n)
    c = Case(plant, rng.uniform(-np.pi, np.pi, n), (off - wide, off + wide), (middle, middle), (middle, middle))
    p = inertia(c, np.full(2 * n + 1, 0.5)) @ middle
    radius = momentum * np.abs(p) + 1e-3
    c = c._replace(p=(p - radius, p + radius))
    found = np.array([np.linalg.solve(inertia(c, rng.random(2 * n + 1)), rng.uniform(*c.p)) for _ in range(200)])
    more = 0.5 * (found.max(axis=0) - found.min(axis=0)) + 0.01
    return c._replace(v=(found.min(axis=0) - more, found.max(axis=0) + more))


def bounds(c: Case, parts: Parts = ALL_PARTS) -> Array:
    """(4, n): speeds lo, hi; momenta of joints that do not move backward, lo, and forward, hi."""
    struct, _held = plant_struct(c.plant)
    (box, _box), (p, _p), out = states_struct(c.q, c.x, c.v), range_struct(*c.p), np.empty((4, len(c.q)))
    check(lib.stopset_speed_bounds(struct, box, p, ffi.new("StopsetParts *", tuple(parts)), view(out)))
    return out


def searched(c: Case, out: Array, seed: int, count: int) -> tuple[float, float]:
    """How far speeds get outside, coordinate by coordinate from random corners; median share of their range that is found."""
    n, rng = len(c.q), np.random.default_rng(seed)
    found = np.array([[np.inf], [-np.inf]]) * np.ones(n)

    def speeds(at: Array) -> Array:
        p = c.p[0] + at[2 * n + 1 :] * (c.p[1] - c.p[0])
        return np.asarray(np.linalg.solve(inertia(c, at[: 2 * n + 1]), p))

    for k in range(count):
        i, way = k % n, rng.choice([-1.0, 1.0])
        at = rng.integers(0, 2, 3 * n + 1).astype(float)
        best = -np.inf
        for j in [-1, *rng.permutation(3 * n + 1)]:
            if j >= 0:
                at[j] = 1.0 - at[j]
            v = speeds(at)
            if way * v[i] > best and np.all((v >= c.v[0]) & (v <= c.v[1])):
                best = way * v[i]
                found = np.array([np.minimum(found[0], v), np.maximum(found[1], v)])
            elif j >= 0:
                at[j] = 1.0 - at[j]
    beyond = max(float(np.max(out[0] - found[0])), float(np.max(found[1] - out[1])))
    return beyond, float(np.median((out[1] - out[0]) / (found[1] - found[0])))


def pulled(c: Case, out: Array, seed: int, count: int) -> float:
    """How far momenta of a joint that does not move forward (backward) get outside, the others' in their box."""
    n, rng, beyond = len(c.q), np.random.default_rng(seed), -np.inf
    for _ in range(count):
        i, at = rng.integers(n), rng.integers(0, 2, 2 * n + 1).astype(float)
        M, others = inertia(c, at), np.arange(n) != i
        v = np.zeros(n)
        v[i] = rng.choice([c.v[0][i], 0.0, c.v[1][i]])
        p = np.where(rng.random(n) < 0.5, *c.p)
        v[others] = np.linalg.solve(M[np.ix_(others, others)], p[others] - M[others, i] * v[i])
        if not np.all((v >= c.v[0]) & (v <= c.v[1])):
            continue
        own = float(M[i] @ v)
        beyond = max(beyond, own - out[3, i] if v[i] <= 0.0 else -np.inf, out[2, i] - own if v[i] >= 0.0 else -np.inf)
    return beyond


ARMS = {"UR10e": ur10e_like, "cobot": cobot7_like, "random": lambda: random_arm(5, 0), "two": lambda: random_arm(2, 0)}


@pytest.mark.parametrize("arm", list(ARMS))
def test_no_search_leaves_the_bounds(arm: str) -> None:
    for seed, (size, rotor, momentum) in enumerate(
        ((0.003, 0.0, 0.0), (0.02, 0.0, 0.0), (0.02, 0.1, 0.1), (0.05, 0.05, 0.3), (0.3, 0.0, 0.3))
    ):
        c = case_of(ARMS[arm](), seed, size, rotor, momentum)
        out = bounds(c)
        assert searched(c, out, seed, 60)[0] <= 1e-9
        assert (
            pulled(c._replace(v=(c.v[0] - 3.0, c.v[1] + 3.0)), bounds(c._replace(v=(c.v[0] - 3.0, c.v[1] + 3.0))), seed, 200)
            <= 1e-9
        )


def test_what_one_angle_does_to_all_is_counted_once() -> None:
    """Ranges of speeds over those that are found: on two joints what angles and the payload do is met, on seven at most twice that."""
    assert (
        np.median([searched(c, bounds(c), s, 60)[1] for s in range(4) for c in [case_of(random_arm(2, 0), s, 0.02, 0.0)]]) < 1.1
    )
    assert np.median([searched(c, bounds(c), s, 60)[1] for s in range(4) for c in [case_of(cobot7_like(), s, 0.02, 0.0)]]) < 2.0


def test_an_inertia_that_is_none_says_less_and_not_more() -> None:
    c = case_of(ur10e_like(), 0, 0.003, 0.0)
    assert np.all(np.isfinite(bounds(c)[:2]))
    out = bounds(c, ALL_PARTS._replace(coupling=4.0))
    assert not np.any(np.isnan(out))


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_bounds_that_forget_what_is_shared_are_left(share: float) -> None:
    worst = -np.inf
    for seed in range(6):
        c = case_of(random_arm(2 + seed % 2, 0), seed, 0.02, 0.0, 0.0)
        worst = max(worst, searched(c, bounds(c, ALL_PARTS._replace(shared=share)), seed, 60)[0])
    assert worst > 1e-2
