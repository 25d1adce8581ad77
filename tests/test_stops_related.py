"""Accelerations in a box of angles, speeds, payloads and torques, whoever moves: a search for the largest and least ones, with the rigid body
that identification uses, finds none outside; what is bounded for all joints at once is much less than each row for itself; each part is needed."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from stopset.artifact import Model
from stopset.core.library import check, ffi, given, lib, view
from stopset.reach.stops import StopBounds
from stopset.reach.stops.parts import ALL_PARTS, Parts
from stopset.reach.stops.tube import OK, Plant, Stride, march, plant_struct
from stopset.reach.stops.tubes import KNOTS, PATIENCE, expected_stop
from stopset.robot.rigid import mass_matrix, torque
from stopset.sets import Box
from stopset.types import Array

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from stop_arms_wide import cobot7_like, random_arm, ur10e_like

from core_calls import range_struct, states_struct


class Case(NamedTuple):
    """A box around a pose: angles and speeds (n,), and dry friction."""

    q: Array
    x: tuple[Array, Array]
    w: tuple[Array, Array]
    B: tuple[Array, Array]


def plant_of(model: Model, rotor: float = 0.0) -> Plant:
    """With half of its rated payload in doubt, and a share of the rotors."""
    s = StopBounds.of(model, (0.5 * model.domain.payload[1], model.domain.payload[1])).setting
    assert s is not None
    return s.plant._replace(rotor_half=rotor * s.plant.rotor)


def case_of(plant: Plant, seed: int, size: float, most: int = 99) -> Case:
    """Speeds of which up to ``most`` may have both signs, and one is known to be zero."""
    n, rng = len(plant.rotor), np.random.default_rng(seed)
    off, middle = size * rng.uniform(-1.0, 1.0, n), rng.uniform(-2.0, 2.0, n)
    radius = rng.uniform(0.0, 20.0 * size, n)
    both = rng.permutation(n)[: min(n // 2, most)]
    middle[both], radius[both] = 0.2 * middle[both], 0.3 + 20.0 * size
    middle[rng.integers(n)] = 0.0
    lo, hi = middle - radius, middle + radius
    rest = rng.integers(n)
    lo[rest] = hi[rest] = 0.0
    wide = size * rng.uniform(0.2, 1.0, n)
    low = plant.coulomb_lo + 0.3 * plant.brake_lo
    return Case(rng.uniform(-np.pi, np.pi, n), (off - wide, off + wide), (lo, hi), (low, plant.coulomb_hi + 0.6 * plant.brake_hi))


def rates(plant: Plant, c: Case, claim: Array, related: bool, parts: Parts = ALL_PARTS) -> Array:
    """(4, n): forward lo, hi, backward lo, hi, as long as no acceleration is larger than its claim."""
    struct, _held = plant_struct(plant)
    (box, _box), (dry, _dry), out = states_struct(c.q, c.x, c.w), range_struct(*c.B), np.empty((4, len(c.q)))
    part = ffi.new("StopsetParts *", tuple(parts))
    check(lib.stopset_acceleration_bounds(struct, box, dry, view(given(claim)), int(related), part, view(out)))
    return out


def bounds(plant: Plant, c: Case, related: bool, parts: Parts = ALL_PARTS) -> Array | None:
    """`rates` once they are within what is claimed; None where that does not come to an end."""
    claim, moves = np.full(len(c.q), 10.0), (c.w[0] < 0.0) | (c.w[1] > 0.0)
    for _ in range(40):
        out = rates(plant, c, claim, related, parts)
        largest = np.where(moves, np.where(np.isfinite(out), np.abs(out), 0.0).max(axis=0), 0.0)
        if np.all(largest <= claim):
            return out
        claim = np.maximum(claim, 1.2 * largest)
    return None


class Draw:
    """One choice of everything that a case leaves open: ``at`` [0, 1] for angles, speeds, friction, u, D, rotors and the payload."""

    def __init__(self, plant: Plant, c: Case, sign: Array) -> None:
        self.p, self.c, self.sign, self.n = plant, c, sign, len(sign)

    def acceleration(self, at: Array) -> Array:
        n, p, c = self.n, self.p, self.c
        x, v, f, u, D, rotor = (at[k * n : (k + 1) * n] for k in range(6))
        q = c.q + c.x[0] + x * (c.x[1] - c.x[0])
        low, high = (
            np.where(self.sign > 0, np.maximum(c.w[0], 0.0), c.w[0]),
            np.where(self.sign < 0, np.minimum(c.w[1], 0.0), c.w[1]),
        )
        v = np.where(self.sign == 0, 0.0, low + v * (high - low))
        pi = p.pi + (2.0 * at[-1] - 1.0) * p.pi_half
        M = mass_matrix(p.chain, pi, q) + np.diag(p.rotor + (2.0 * rotor - 1.0) * p.rotor_half)
        push = p.u_lo + u * (p.u_hi - p.u_lo) - (p.viscous_lo + D * (p.viscous_hi - p.viscous_lo)) * v
        push = push - self.sign * (c.B[0] + f * (c.B[1] - c.B[0])) - torque(p.chain, pi, q, v, np.zeros(n))
        moving = self.sign != 0
        a = np.zeros(n)
        a[moving] = np.linalg.solve(M[np.ix_(moving, moving)], push[moving])
        return a

    def search(self, i: int, side: float, rng: np.random.Generator) -> float:
        """Largest (least) acceleration of joint i that one pass over all coordinates finds from somewhere."""
        at = rng.integers(0, 2, 6 * self.n + 1).astype(float)
        best = side * self.acceleration(at)[i]
        for k in rng.permutation(len(at)):
            at[k] = 1.0 - at[k]
            now = side * self.acceleration(at)[i]
            if now > best:
                best = now
            else:
                at[k] = 1.0 - at[k]
        return side * best


def searched(plant: Plant, c: Case, out: Array, seed: int, count: int) -> tuple[float, float]:
    """How far the search gets outside `bounds`, and the worst share of their range that it finds."""
    n, rng = len(c.q), np.random.default_rng(seed)
    cases = [(c.w[0] < 0.0, -1), ((c.w[0] <= 0.0) & (c.w[1] >= 0.0), 0), (c.w[1] > 0.0, 1)]
    can = [[s for possible, s in cases if possible[i]] for i in range(n)]
    found = np.array([[np.inf], [-np.inf], [np.inf], [-np.inf]]) * np.ones(n)
    for _ in range(count):
        sign = np.array([rng.choice(s) for s in can])
        if not sign.any():
            continue
        i = rng.choice(np.flatnonzero(sign))
        side = rng.choice([-1.0, 1.0])
        a, row = Draw(plant, c, sign).search(i, side, rng), (0 if sign[i] > 0 else 2) + (side > 0)
        found[row, i] = max(found[row, i], a) if side > 0 else min(found[row, i], a)
    beyond = np.where(np.isfinite(found), np.array([[-1.0], [1.0], [-1.0], [1.0]]) * (found - out), -np.inf)
    both = np.isfinite(found[0]) & np.isfinite(found[1])
    share = (out[1] - out[0])[both] / np.maximum((found[1] - found[0])[both], 1e-9)
    return float(beyond.max()), float(np.median(share)) if both.any() else 1.0


ARMS = {"UR10e": ur10e_like, "cobot": cobot7_like, "random": lambda: random_arm(5, 0), "two": lambda: random_arm(2, 0)}


@pytest.mark.parametrize("arm", list(ARMS))
def test_no_search_leaves_the_bounds(arm: str) -> None:
    for seed, (size, rotor) in enumerate(((0.003, 0.0), (0.02, 0.0), (0.02, 0.1), (0.05, 0.05))):
        plant = plant_of(ARMS[arm](), rotor)
        c = case_of(plant, seed, size)
        out = bounds(plant, c, True)
        if out is not None:
            assert searched(plant, c, out, seed, 60)[0] <= 1e-6


def test_what_is_shared_cancels() -> None:
    """Ranges of accelerations that angles, speeds and friction leave open: four fifths of those that each row for itself allows."""
    rows, all_rows = [], []
    plant = plant_of(ur10e_like())
    plant = plant._replace(pi_half=0.02 * plant.pi_half)
    for seed in range(8):
        c = case_of(plant, seed, 0.02, 2)
        boxes, shared = bounds(plant, c, False), bounds(plant, c, True)
        assert shared is not None
        if boxes is not None:
            assert not np.any(shared[[1, 3]] > boxes[[1, 3]]) and not np.any(shared[[0, 2]] < boxes[[0, 2]])
            moves = np.isfinite(shared[:2]).all(axis=0) & (c.w[1] > 0.0)
            rows += list((boxes[1] - boxes[0])[moves])
            all_rows += list((shared[1] - shared[0])[moves])
    assert np.median(np.array(all_rows) / np.array(rows)) < 0.85


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_bounds_that_forget_what_is_shared_are_left(share: float) -> None:
    worst = -np.inf
    for seed in range(6):
        plant = plant_of(ur10e_like() if seed % 2 else random_arm(3, 0))
        c = case_of(plant, seed, 0.02)
        c = c._replace(B=(c.B[0], c.B[0] + 1e-3))
        plant = plant._replace(**{f"{k}_{e}": getattr(plant, f"{k}_lo") for k in ("u", "viscous") for e in ("lo", "hi")})
        out = bounds(plant, c, True, ALL_PARTS._replace(shared=share))
        if out is not None:
            worst = max(worst, searched(plant, c, out, seed, 60)[0])
    assert worst > 0.1


@pytest.mark.parametrize(("size", "coupling"), [(1.5, 1.0), (0.01, 4.0)])
def test_where_slopes_say_nothing_each_row_stands_for_itself(size: float, coupling: float) -> None:
    """A box so wide that an inverse could turn its sign, and an inertia that is none."""
    plant = plant_of(ur10e_like())
    c, parts = case_of(plant, 0, size), ALL_PARTS._replace(coupling=coupling)
    both = [rates(plant, c, np.full(6, 100.0), related, parts) for related in (False, True)]
    assert np.array_equal(both[0], both[1], equal_nan=True)


def test_a_tube_closes_so_where_boxes_do_not() -> None:
    """Seven joints without load: most stops of one tube, without the kinetic energy; a third of them before."""
    s = StopBounds.of(cobot7_like(), (0.0, 0.0)).setting
    assert s is not None
    closed, rng, n = 0, np.random.default_rng(1), s.model.n
    for _ in range(8):
        q, dq = rng.uniform(-np.pi, np.pi, n), rng.uniform(-1.0, 1.0, n) * s.model.domain.dq.hi
        h = expected_stop(s.plant, q, np.abs(dq)) / KNOTS.stop
        r, v = s.noise.radius[:n], s.noise.radius[n:]
        closed += march(s.plant, Box(q - r, q + r), Box(dq - v, dq + v), Stride(h, KNOTS.stop * PATIENCE), ALL_PARTS).end == OK
    assert closed >= 3


def test_columns_are_not_asked_where_rows_fail_before_most_brakes_have_closed() -> None:
    """What neither closes costs little: the tube ends where the rows for themselves do, long before columns would."""
    model = ur10e_like()
    s = StopBounds.of(model, (0.98 * model.domain.payload[1], model.domain.payload[1])).setting
    assert s is not None
    p, rng, box = s.plant, np.random.default_rng(1), (np.full(6, 0.01), np.full(6, 0.05))
    closing, engaged = p.delay_lo.min(), (p.delay_hi + p.rise_hi).max()
    early = 0
    for _ in range(6):
        q, dq = rng.uniform(-np.pi, np.pi, 6), rng.uniform(-1.0, 1.0, 6) * model.domain.dq.hi
        h = expected_stop(p, q, np.abs(dq)) / 100
        tube = march(
            p, Box(q - box[0], q + box[0]), Box(dq - box[1], dq + box[1]), Stride(h, 600, (engaged - closing) / 35), ALL_PARTS
        )
        share = (tube.t[-1] - closing) / (engaged - closing)
        assert tube.end == OK or share < 0.75 or share > 1.0  # columns last until all brakes have closed, or are not asked
        early += tube.end != OK and share < 0.75
    assert early
