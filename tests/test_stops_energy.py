"""Where joint-wise bands cannot be closed the kinetic energy bounds the stop: sampled stops stay inside, weakened energy does not,
and where brakes do not surely hold the arm there is still no number."""

from __future__ import annotations

import itertools
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import linprog

from core_calls import largest_energy, range_struct
from stop_sampling import sample_stops, tightness
from stop_tubes import tube_of
from stopset.core.library import check, ffi, lib, view
from stopset.reach.stops import StopBounds
from stopset.reach.stops.expansion import curvature
from stopset.reach.stops.parts import ALL_PARTS
from stopset.reach.stops.start import Start
from stopset.reach.stops.tube import ENDLESS, OK, UNBOUNDED, Plant, Stride, march
from stopset.reach.stops.tubes import KNOTS, expected_stop, march_box, tubes_of
from stopset.robot.rigid import Chain, mass_matrix
from stopset.sets import Box
from stopset.types import Array

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from stop_arms import prbt_like, ur5_like
from stop_arms_wide import random_arm, ur10e_like
from stops_operations import calls_in, compiled


def hard_states(count: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """States of the arm with strong coupling that one tube of joint speeds does not close."""
    bounds, rng, out = StopBounds.of(ur5_like(), (4.75, 5.0)), np.random.default_rng(77), []
    s = bounds.setting
    assert s is not None
    while len(out) < count:
        q, dq = rng.uniform(-np.pi, np.pi, 6), rng.uniform(-2.0, 2.0, 6)
        if tube_of(s, q, dq, s.noise.radius[:6], s.noise.radius[6:]).end != OK:
            out.append((q, dq))
    return out


def test_strong_coupling_is_bounded_and_marked() -> None:
    bounds = StopBounds.of(ur5_like(), (4.75, 5.0))
    s = bounds.setting
    assert s is not None
    r, v = s.noise.radius[:6], s.noise.radius[6:]
    for k, (q, dq) in enumerate(hard_states(4)):
        bound = bounds.bound(q, dq)
        assert bound.certified and bound.layer == "energy" and "kinetic energy" in bound.why
        assert bound.holding_margin is not None and bound.holding_margin.min() >= 0.0
        tube = march_box(s, s.plant, Start(q, dq, r, v), energetic=True)
        x = sample_stops(s.plant, q, dq, r, v, s.payload_com, tube, 100, k)
        assert x.escaped == 0 and x.tcp <= bound.tcp
        assert np.all(x.forward <= bound.forward + 2e-6) and np.all(x.back <= bound.back + 2e-6)


def test_energy_without_disturbance_is_escaped() -> None:
    """A tube whose plant has stronger brakes than the arm: the same sampling finds escapes, also of the energetic tube."""
    s = StopBounds.of(ur5_like(), (4.75, 5.0)).setting
    assert s is not None
    r, v = s.noise.radius[:6], s.noise.radius[6:]
    strong = s.plant._replace(brake_lo=4.0 * s.plant.brake_lo, brake_hi=4.0 * s.plant.brake_hi, delay_hi=s.plant.delay_lo)
    escaped = 0
    for k, (q, dq) in enumerate(hard_states(3)):
        tube = march_box(s, strong, Start(q, dq, r, v), energetic=True)
        if tube.end == OK:
            escaped += sample_stops(s.plant, q, dq, r, v, s.payload_com, tube, 60, k).escaped
    assert escaped > 0


@pytest.mark.parametrize(("make", "still"), [(ur10e_like, 0.7), (lambda: random_arm(4, 0), 0.7), (lambda: random_arm(7, 1), 0.5)])
def test_a_way_costs_the_energy_that_it_has(make, still) -> None:  # type: ignore[no-untyped-def]
    """Ways weighed with a share of the kinetic energy that is there are escaped; with all of it none is (Lemma 13)."""
    model = make()
    rated, n = model.domain.payload[1], model.n
    s = StopBounds.of(model, (0.98 * rated, rated)).setting
    assert s is not None
    escaped = {1.0: 0, still: 0}
    for seed in range(3):
        rng = np.random.default_rng(seed)
        q, dq = rng.uniform(-np.pi, np.pi, n), rng.uniform(-1.0, 1.0, n) * model.domain.dq.hi
        start = Start(q, dq, s.noise.radius[:n], s.noise.radius[n:])
        for share in escaped:
            tube = march_box(s, s.plant, start, ALL_PARTS._replace(still=share), energetic=True)
            assert tube.end == OK
            escaped[share] += sample_stops(s.plant, q, dq, start.q_radius, start.dq_radius, s.payload_com, tube, 60, 2).escaped
    assert escaped[1.0] == 0 and escaped[still] > 0


def test_ways_are_weighed_before_all_brakes_hold() -> None:
    """A light arm with a heavy load: while brakes rise a joint's way and what is left of the energy are not both at their largest. The same
    bound on the core before Lemma 13 was 9.6 times the worst sampled stop."""
    model = random_arm(7, 1)
    s, top = StopBounds.of(model, (0.98 * model.domain.payload[1], model.domain.payload[1])).setting, model.domain.dq.hi
    assert s is not None
    rng, r, v = np.random.default_rng(77), s.noise.radius[:7], s.noise.radius[7:]
    q, dq = rng.uniform(-np.pi, np.pi, 7), rng.uniform(-top, top)
    tube = march_box(s, s.plant, Start(q, dq, r, v), energetic=True)
    x = sample_stops(s.plant, q, dq, r, v, s.payload_com, tube, 250, 0, 500)
    assert x.escaped == 0
    assert np.median(tightness(tube, 1.0, x, dq, top).angle) < 8.0


def test_what_travel_is_left_is_not_known_before_every_brake_holds() -> None:
    """A joint without dry friction coasts until its brake engages: no travel left is claimed before, and a finite one later."""
    s = StopBounds.of(ur5_like(), (4.75, 5.0)).setting
    assert s is not None
    none = np.zeros(6)
    smooth = s.plant._replace(coulomb_lo=none)
    q, dq, r = np.array([0.1, 0.5, 0.3, -0.4, 0.2, 0.1]), np.full(6, 0.3), np.full(6, 1e-3)
    lasts = expected_stop(smooth, q, dq)
    tube = march(
        smooth, Box(q - r, q + r), Box(dq - r, dq + r), Stride(lasts / KNOTS.stop, 6 * KNOTS.stop), ALL_PARTS, energetic=True
    )
    free = tube.t < smooth.delay_hi.min()
    assert tube.end == OK and np.all(np.isinf(tube.travel_left[free])) and free.sum() > 3
    assert np.all(np.isfinite(tube.travel_left[-2])) and np.all(tube.travel_left[-2] > 0.0)


def one_joint(B: float, speed: float) -> tuple[Plant, float]:
    """An upright axis with all brakes closed at the cut, and how far it goes: its energy over its brake."""
    chain = Chain(np.eye(3)[None], np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]), np.array([0.0, 0.0, -9.81]))
    pi, none, some = np.array([[1.0, 0.3, 0, 0, 0.1, 0, 0.1, 0, 0, 0.2]]), np.zeros(1), np.full(1, 1e-9)
    brake = np.full(1, B)
    plant = Plant(
        chain, pi, 0 * pi, np.ones(1), none, none, none, none, none, none, none, brake, brake, none, none, some, some,
        curvature(chain, pi),
    )  # fmt: skip
    return plant, 0.5 * 1.2 * speed**2 / B


@pytest.mark.parametrize("speed", [1.0, -2.5])
def test_work_that_brakes_take_bounds_the_way_of_one_joint_exactly(speed: float) -> None:
    plant, far = one_joint(6.0, speed)
    v, q = np.full(1, speed), np.zeros(1)
    steps = int(1.2 * abs(speed) * 1.2 / 6.0 / 1e-3)
    tube = march(plant, Box(q, q), Box(v, v), Stride(1e-3, steps), ALL_PARTS, energetic=True)
    end = max(tube.d_hi.max(), -tube.d_lo.min())
    assert tube.end == OK and far <= end <= 1.02 * far
    # an arm that goes on for longer than is asked is bounded from the first moment on: by its energy, not by time
    brief = march(plant, Box(q, q), Box(1e3 * v, 1e3 * v), Stride(1.0, 5), ALL_PARTS, energetic=True)
    assert max(brief.d_hi.max(), -brief.d_lo.min()) <= 1.01e6 * far


def three_links(brake: Array) -> Plant:
    """Three equal links in a vertical plane, all brakes closed at the cut."""
    z, some = np.zeros(3), np.full(3, 1e-9)
    offsets, axes = np.array([[0.0, 0, 0], [0.3, 0, 0], [0.3, 0, 0]]), np.tile([0.0, 1.0, 0.0], (3, 1))
    chain = Chain(np.tile(np.eye(3), (3, 1, 1)), offsets, axes, np.array([0.0, 0.0, -9.81]))
    pi = np.tile([2.0, 0.3, 0, 0, 0.1, 0, 0.1, 0, 0, 0.1], (3, 1))
    return Plant(
        chain, pi, 0 * pi, np.full(3, 0.5), z, brake, brake, z, z, z, z, brake, brake, z, some, some, some, curvature(chain, pi)
    )  # fmt: skip


def test_travel_whose_claims_creep_is_given_up_and_asked_for_again() -> None:
    """Between what brakes surely hold and what they may not, each claim of travel finds gravity a little heavier and asks for more."""
    plant, q, r = three_links(np.array([16.0, 6.0, 4.0])), np.array([-1.7, -2.9, -2.9]), np.full(3, 1e-4)
    known = {}
    for speed in (1.95, 1.9585, 1.97):
        v = np.array([speed, 0.0, 0.0])
        tube = march(plant, Box(q - r, q + r), Box(v, v), Stride(1e-3, 400), ALL_PARTS, energetic=True)
        known[speed] = bool(np.isfinite(tube.travel_left[0]).all())
        assert tube.end == OK and np.isfinite(tube.travel_left[5]).all()
    assert known == {1.95: True, 1.9585: False, 1.97: False}


def test_the_brake_and_gravity_stop_what_rises_and_gravity_takes_from_the_brake_what_falls() -> None:
    """An axis that lies, its weight beside it: a stop is known by its energy alone, in a step of a second."""
    plant, _ = one_joint(6.0, 1.0)
    chain = plant.chain._replace(gravity=np.array([0.0, -9.81, 0.0]))
    plant = plant._replace(chain=chain, curvature=curvature(chain, plant.pi))
    q, work, weight = np.zeros(1), 0.5 * 1.2 * 0.3**2, 0.3 * 9.81
    for sign in (1.0, -1.0):
        v = np.full(1, sign * 0.3)
        tube = march(plant, Box(q, q), Box(v, v), Stride(1.0, 2, 1e-6), ALL_PARTS, energetic=True)
        # as far as it gets the weight is nearly as far beside the axis; before, what rises was let go as far as what falls
        assert work / (6.0 + sign * weight) <= np.abs([tube.d_lo, tube.d_hi]).max() <= 1.02 * work / (6.0 + sign * weight)


def test_steps_are_short_while_brakes_close() -> None:
    plant, _ = one_joint(6.0, 1.0)
    plant = plant._replace(
        delay_lo=np.full(1, 0.0125), delay_hi=np.full(1, 0.02), rise_lo=np.full(1, 0.01), rise_hi=np.full(1, 0.02)
    )
    q, v = np.zeros(1), np.ones(1)
    tube = march(plant, Box(q, q), Box(v, v), Stride(0.01, 200, 1e-3), ALL_PARTS)
    assert tube.end == OK
    h, closing = np.diff(tube.t), (tube.t >= 0.0125 - 1e-12) & (tube.t < 0.04 - 1e-12)
    assert np.allclose(tube.t[:4], [0.0, 0.01, 0.0125, 0.0135])  # no step passes the first moment at which the brake may close
    assert np.allclose(h[closing[:-1]], 1e-3) and np.allclose(h[~closing[:-1]][2:], 0.01)
    even = march(plant, Box(q, q), Box(v, v), Stride(0.01, 200), ALL_PARTS)
    assert tube.d_hi.max() < even.d_hi.max()


def test_an_energy_beyond_all_numbers_bounds_nothing() -> None:
    plant, _ = one_joint(6.0, 1.0)
    v, q = np.full(1, 1e200), np.zeros(1)
    assert march(plant, Box(q, q), Box(v, v), Stride(1e-3, 5), ALL_PARTS, energetic=True).end != OK


def test_the_fall_back_is_of_use_on_light_arms_with_their_payload() -> None:
    """UR10e-like with 12.5 kg, where a tube of joint speeds closes one stop in ten: the median of bound over worst sampled was 18, now 2.3."""
    model, ratios, helped = ur10e_like(), [], 0
    s, rng = StopBounds.of(model, (12.25, 12.5)).setting, np.random.default_rng(1)
    assert s is not None
    r, v, top = s.noise.radius[:6], s.noise.radius[6:], model.domain.dq.hi
    for k in range(5):
        q, dq = rng.uniform(-np.pi, np.pi, 6), rng.uniform(-1.0, 1.0, 6) * top
        tube = tubes_of(s, Start(q, dq, r, v), 1)[-1]
        assert tube.end == OK
        helped += tube.energetic
        x = sample_stops(s.plant, q, dq, r, v, s.payload_com, tube, 60, k)
        assert x.escaped == 0
        ratios.append(tightness(tube, np.inf, x, dq, top).angle)
    assert helped >= 3
    assert np.median(np.concatenate(ratios)) < 2.8


def test_largest_energy_is_the_largest_of_the_box() -> None:
    plant, rng = StopBounds.of(prbt_like()).setting.plant, np.random.default_rng(4)
    plant = plant._replace(rotor=np.ones(6), rotor_half=np.zeros(6), pi_half=0 * plant.pi_half)
    q0, lo, hi = rng.uniform(-2, 2, 6), rng.uniform(-1, 0, 6), rng.uniform(0, 1, 6)
    bound, found = largest_energy(plant, q0, np.full(6, -0.05), np.full(6, 0.05), lo, hi), 0.0
    for _ in range(4000):
        v = np.where(rng.random(6) < 0.5, lo, hi)
        M = mass_matrix(plant.chain, plant.pi, q0 + rng.choice([-0.05, 0.05], 6)) + np.eye(6)
        found = max(found, float(np.sqrt(v @ M @ v)))
    assert found <= bound <= 1.25 * found


def test_power_looks_at_the_directions_that_are_possible() -> None:
    (gravity, _g), (u, _u) = (
        range_struct(np.array(a), np.array(b)) for a, b in (([4.0, 4.0], [6.0, 6.0]), ([-1.0, -1.0], [1.0, 1.0]))
    )
    lo, hi, brake = np.zeros(2), np.zeros(2), np.array([10.0, 10.0])
    lib.stopset_power_excess(2, gravity, u, view(brake), view(lo), view(hi))
    # backward a joint may fall with gravity, 6 + 1 - 10; forward it only rises against it, 1 - 4 - 10
    assert lo.tolist() == [-3.0, -3.0] and hi.tolist() == [-13.0, -13.0]


def most_power(w: np.ndarray, v: np.ndarray, p: np.ndarray, z: float) -> float:
    """Largest power of speeds that hold the energy ``z``, (2, n) each: a linear program of every choice of directions; no such speeds:
    that of those which hold the most."""
    best, energy = -np.inf, -np.inf
    for signs in itertools.product((0, 1), repeat=w.shape[1]):
        at = signs, range(w.shape[1])
        cost, holds = w[at], np.maximum(np.where(signs, p[1], -p[0]), 0.0)
        lo, hi = np.where(signs, np.maximum(v[0], 0.0), np.maximum(-v[1], 0.0)), np.where(signs, v[1], -v[0])
        if np.any(hi < lo):
            continue  # a direction that this joint cannot take
        found = linprog(-cost, A_ub=-holds[None], b_ub=[-z], bounds=list(zip(lo, hi, strict=True)))
        if found.success:
            best, energy = max(best if energy == np.inf else -np.inf, float(-found.fun)), np.inf
        elif float(holds @ hi) > energy:
            best, energy = float(cost @ hi), float(holds @ hi)
    return best


def after(y: float, w: np.ndarray, v: np.ndarray, p: np.ndarray, h: float, later: np.ndarray | None = None) -> float:
    """What is left of the energy where ``w`` stays, or goes on a line to ``later``."""
    out, excess = np.empty(1), ffi.new("StopsetRange[2]")
    (first, _w), (last, _l), (speeds, _v), (momenta, _p) = (range_struct(*x) for x in (w, w if later is None else later, v, p))
    excess[0], excess[1] = first[0], last[0]
    check(lib.stopset_energy_after(w.shape[1], y, excess, speeds, momenta, h, view(out)))
    return float(out[0])


@pytest.mark.parametrize("seed", range(12))
def test_what_holds_much_energy_is_braked(seed: int) -> None:
    """Against the worst of all motions by linear programs at every moment: the bound is not below it, and not far above."""
    rng = np.random.default_rng(seed)
    w, y, h = rng.uniform(-100.0, 20.0 if seed % 2 else -1.0, (2, 4)), rng.uniform(2.0, 8.0), 1e-3
    p = np.array([-1.0, 1.0])[:, None] * rng.uniform(0.0, 8.0, (2, 4))
    p[:, seed % 4] *= float(seed > 3)  # a joint that holds nothing
    v = np.array([rng.uniform(-3.0, 1.0, 4), rng.uniform(1.0, 3.0, 4)])
    if seed % 3 == 1:
        v[:, 2] = -v[::-1, 2]
    if seed == 6:
        w, v = np.full((2, 4), -100.0), np.array([np.full(4, 2.9), np.full(4, 3.0)])
        p, y = np.array([-np.ones(4), np.ones(4)]), 0.3  # at rest within the step
    z, parts = y * y, 40
    for _ in range(parts):
        z = max(0.0, z + 2.0 * h / parts * most_power(w, v, p, z))
    # a joint's two directions are mixed where that allows more: no more than a little above
    assert np.sqrt(z) - 1e-6 <= after(y, w, v, p, h) <= 1.03 * np.sqrt(z) + 0.05


@pytest.mark.parametrize("seed", range(6))
def test_what_brakes_gain_on_a_step_counts(seed: int) -> None:
    """Brakes that close on the step, against linear programs at every moment of it: the bound is not below them and mostly half as far above as what
    counts with the brakes of its beginning; with the brakes of its end it would be below."""
    rng = np.random.default_rng(seed)
    w, y, h = rng.uniform(-20.0, 20.0, (2, 4)), rng.uniform(4.0, 8.0), 4e-3
    later = w - rng.uniform(50.0, 150.0, (1, 4))
    p = np.array([-1.0, 1.0])[:, None] * rng.uniform(2.0, 8.0, (2, 4))
    v = np.array([rng.uniform(-3.0, 1.0, 4), rng.uniform(1.0, 3.0, 4)])
    z, parts = y * y, 80
    for k in range(parts):
        t = (k + 0.5) / parts
        z = max(0.0, z + 2.0 * h / parts * most_power((1.0 - t) * w + t * later, v, p, z))
    found, bound, begin, end = np.sqrt(z), after(y, w, v, p, h, later), after(y, w, v, p, h), after(y, later, v, p, h)
    assert end < found - 1e-3 and found - 1e-6 <= bound < begin
    assert bound - found < 0.7 * (begin - found)


def test_a_joint_has_one_direction_at_a_time() -> None:
    """Forward a joint holds much and is braked hard, backward it holds little and is braked little: what it holds is held forward."""
    v, p = np.array([[-1.0], [1.0]]), np.array([[-1.0], [4.0]])
    y = after(2.0, np.array([[-1.0], [-50.0]]), v, p, 1e-4)
    assert y == pytest.approx(np.sqrt(4.0 - 2e-4 * 50.0), rel=1e-5)
    # half of the energy: half way between being as fast as it can be backward and forward
    y = after(np.sqrt(2.5), np.array([[-1.0], [-50.0]]), v, p, 1e-4)
    assert y == pytest.approx(np.sqrt(2.5 - 2e-4 * 25.5), rel=1e-4)
    assert after(2.0, np.array([[-50.0], [-1.0]]), v, p, 1e-4) == pytest.approx(np.sqrt(4.0 - 2e-4), rel=1e-5)


def test_torques_that_push_are_counted_once() -> None:
    w, v = np.array([[-90.0, -90.0], [50.0, 20.0]]), np.array([np.full(2, 1.0), np.full(2, 2.0)])
    assert after(3.0, w, v, np.array([-np.ones(2), np.ones(2)]), 0.01) == pytest.approx(np.sqrt(9.0 + 0.02 * 140.0), rel=1e-8)


@pytest.mark.parametrize("weak", [0.2, 0.02])
def test_no_holding_no_number_in_any_layer(weak: float) -> None:
    model = ur5_like()
    brakes = replace(model.brakes, torque=Box.of(weak * model.brakes.torque.lo, weak * model.brakes.torque.hi))
    q = np.zeros(6)  # stretched out, 5 kg at its end
    bound = StopBounds.of(replace(model, brakes=brakes), (4.75, 5.0), pieces=8).bound(q, np.full(6, 0.2))
    assert not bound.certified and bound.time is None and bound.motion is None and bound.capsules is None
    assert "no stop provable" in bound.why and "whole reach" in bound.why


def test_an_arm_that_falls_on_is_given_up_soon() -> None:
    """Brakes that hold nothing: no bound, known some steps after all have closed and not after thousands."""
    s = StopBounds.of(ur10e_like(), (0.0, 0.0)).setting
    assert s is not None
    weak = s.plant._replace(brake_lo=1e-3 * s.plant.brake_lo, brake_hi=1e-3 * s.plant.brake_hi)
    q, none = np.array([0.0, 0.3, 0.4, 0.2, 0.1, 0.0]), np.zeros(6)
    tube = march(weak, Box(q, q), Box(none, none), Stride(1e-3, 3000), ALL_PARTS, energetic=True)
    assert tube.end == ENDLESS and len(tube.t) < 200


def test_numbers_that_overflow_are_no_rest_and_end_a_tube_at_once() -> None:
    """Speeds and angles of a ramp that fails are a wide box: claims there grow beyond all numbers, and what is not a number holds no claim."""
    s = StopBounds.of(ur10e_like(), (0.0, 12.5)).setting
    assert s is not None
    q, v = np.array([0.0, 0.3, 0.4, 0.2, 0.1, 0.0]), np.full(6, 1.5)
    for wide in (0.3, 0.5, 0.8):
        tube = march(s.plant, Box(q - wide, q + wide), Box(-v, v), Stride(1e-3, 500), ALL_PARTS)
        assert tube.end == UNBOUNDED and len(tube.t) < 10
        assert np.isfinite([tube.v_lo, tube.v_hi]).all()


def march_by_energy() -> None:
    """Three tubes of an arm of strong coupling, joints moving at the cut; run by a process of its own, with the core that counts."""
    model, rng = random_arm(7, 1), np.random.default_rng(5)
    s, n = StopBounds.of(model, model.domain.payload).setting, model.n
    assert s is not None
    r, v = s.noise.radius[:n], s.noise.radius[n:]
    for _ in range(3):
        q, dq = rng.uniform(-np.pi, np.pi, n), rng.uniform(-1.0, 1.0, n) * model.domain.dq.hi
        stride = Stride(expected_stop(s.plant, q, np.abs(dq)) / 25, 10_000)
        assert len(march(s.plant, Box(q - r, q + r), Box(dq - v, dq + v), stride, ALL_PARTS, energetic=True).t) > 100


@pytest.mark.skipif(not (shutil.which("gcc") and shutil.which("gcov")), reason="no gcc with gcov here, which count")
def test_first_excursions_that_cut_nothing_are_asked_no_more(tmp_path: Path) -> None:
    """Subsets of the joints that may still be in their first excursion, 128 of seven joints, are visited only as long as that may cut a speed:
    on every step they would make a step twice as dear. Counted, as a processor's time says little on a busy machine."""
    here = "import sys; sys.path.insert(0, sys.argv[1]); from test_stops_energy import march_by_energy; march_by_energy()"
    command = [sys.executable, "-c", here, str(Path(__file__).parent)]
    calls = calls_in(tmp_path, compiled(tmp_path), command)
    steps, asked = calls["tube.c take_step"], calls["momentum.c stops_tighten"]
    assert 3 <= asked < 0.1 * steps and 0 < calls["momentum.c visit"] <= 128 * asked
