"""Turns of the stop proofs' C that ordinary arms rarely take, each with what must hold there: sampled stops inside, or no number at all."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from core_calls import inertia_box
from core_plants import LYING, UPRIGHT, bodies, chain_of, planar, plant_of, power_off
from stop_sampling import sample_stops
from stopset.core.library import lib
from stopset.fmu.stops import bounds_of
from stopset.reach.stops import StopBounds
from stopset.reach.stops.cartesian import SLICES, reached, slices
from stopset.reach.stops.compiled import CompiledStops, Stopped
from stopset.reach.stops.parts import ALL_PARTS
from stopset.reach.stops.ramp import Ramp
from stopset.reach.stops.split import _blurred
from stopset.reach.stops.start import Start
from stopset.reach.stops.swiftness import swiftness
from stopset.reach.stops.tube import ENDLESS, OK, UNBOUNDED, Plant, Stride, Tube, march
from stopset.reach.stops.tubes import FAST_KNOTS, march_box, tubes_of
from stopset.robot.rigid import mass_matrix
from stopset.sets import Box
from stopset.types import Array
from test_fmu import friction
from test_fmu_stops import braked, core_stop, cut_together, ramped, states

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from stop_arms import prbt_like
from stop_arms_wide import cobot7_like, random_arm


def marched(plant: Plant, q: Array, dq: Array, radius: float, h: float, energetic: bool = False, lasts: float = 1.5) -> Tube:
    return march(
        plant, Box(q, q), Box(dq - radius, dq + radius), Stride(h, int(min(600, lasts / h))), ALL_PARTS, energetic=energetic
    )


# ---- tubes


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("seed", [33, 338, 1980, 2219])
def test_light_rotors_on_heavy_links_stay_inside(seed: int, side: float) -> None:
    """Joints that rest at a knot though they may move before it (33, 338), or that their momenta show to be moving still though their
    accelerations could have stopped them (1980, 2219): sampled stops are inside the tube, and inside the whole stop's bound."""
    plant, q, dq, radius, h = planar(seed)
    q, dq = side * q, side * dq
    tube, none = marched(plant, q, dq, radius, h), np.zeros_like(q)
    assert tube.end == OK
    x = sample_stops(plant, q, dq, none, none + radius, np.zeros(3), tube, 200, seed)
    assert x.escaped == 0
    bound = power_off(plant, q, dq, radius)
    assert np.all(bound[0] + 2e-3 >= x.time) and np.all(bound[1] + 2e-6 >= x.forward) and np.all(bound[2] + 2e-6 >= x.back)


def test_an_impulse_that_was_taken_too_large_twice_is_not_taken_at_all() -> None:
    """What a brake must have given to end an excursion within a step is known after it: the step is repeated with less, then with none."""
    s = StopBounds.of(cobot7_like(), (2.9, 3.0)).setting
    assert s is not None
    rng, n = np.random.default_rng(51), 7
    q, dq = rng.uniform(-np.pi, np.pi, n), rng.uniform(-1.0, 1.0, n) * s.model.domain.dq.hi
    r, v = s.noise.radius[:n], s.noise.radius[n:]
    tube = march_box(s, s.plant, Start(q, dq, r, v), energetic=True)
    assert tube.end == OK and sample_stops(s.plant, q, dq, r, v, s.payload_com, tube, 100, 2).escaped == 0


def test_the_inertia_of_a_box_holds_that_of_its_poses() -> None:
    plant, q, _, _, _ = planar(338)
    wide = np.full(len(q), 0.2)
    M, spread, _ = inertia_box(plant, q, -wide, wide, ALL_PARTS)
    rotor, rng = np.diag(plant.rotor), np.random.default_rng(1)
    for _ in range(100):
        away = np.abs(mass_matrix(plant.chain, plant.pi, q + rng.uniform(-wide, wide)) + rotor - M)
        assert np.all(away <= spread + 1e-12)


def pendulum(brake: float) -> tuple[Plant, Array, Array]:
    """It hangs, 1 kg m^2 with its rotor, at rest and free until its brake closes after 0.6 s."""
    chain, body = chain_of(np.zeros(0), LYING), bodies(np.ones(1), np.full(1, 0.5), np.full(1, 0.3))
    return plant_of(chain, body, np.full(1, 0.7), np.full(1, brake), 0.6, 0.1, 0.0, 1e-9), np.full(1, 0.5 * np.pi), np.zeros(1)


def test_a_step_in_which_gravity_outgrows_every_claim_is_not_provable() -> None:
    """Its swing doubles in half a second: whatever caps are claimed for such a step, more is possible."""
    plant, q, dq = pendulum(20.0)
    assert marched(plant, q, dq, 0.0, 0.5, True, 300.0).end == UNBOUNDED
    tube = marched(plant, q, dq, 0.0, 0.01, True)
    assert tube.end == OK and tube.d_hi.max() < 1e-3


def test_ways_that_outgrow_every_claim_are_not_told() -> None:
    """Gravity grows with the way, and the way with gravity, for as often as is tried: there the ways are unknown, the tube is a bound."""
    s = StopBounds.of(prbt_like(), (2.75, 3.0)).setting
    assert s is not None
    rng, n = np.random.default_rng(140), 6
    q, dq = rng.uniform(-np.pi, np.pi, n), rng.uniform(-1.0, 1.0, n) * s.model.domain.dq.hi
    r, v = s.noise.radius[:n], s.noise.radius[n:]
    tube = march_box(s, s.plant, Start(q, dq, r, v), energetic=True)
    known = np.isfinite(tube.travel_left).all(axis=1)
    assert tube.end == OK and known.any() and np.all(np.isinf(tube.travel_left[~known]))
    assert sample_stops(s.plant, q, dq, r, v, s.payload_com, tube, 100, 1).escaped == 0


def test_joints_whose_inertia_has_no_inverse_prove_nothing_or_hold() -> None:
    """Two joints about one axis behind a third, rotors of milligrams: their speeds are not known one by one from their momenta."""
    body = bodies(np.array([0.0, 0.55, 0.0]), np.array([0.0, 0.3, 0.0]), np.array([0.0, 0.0, 0.034]))
    rotor, brake = np.array([6e-6, 1.3e-5, 1.2e-8]), np.array([0.2, 0.1, 6.0])
    plant = plant_of(chain_of(np.array([0.3, 0.0]), UPRIGHT), body, rotor, brake, 0.01, 0.01, 1e-3, 1e-3)
    fast, still, none = np.array([0.5, -0.3, 0.2]), np.array([1.7e-4, -3e-5, -6e-5]), np.zeros(3)
    assert marched(plant, none, fast, 1e-6, 2e-3, True).end in (ENDLESS, UNBOUNDED)
    tube = marched(plant, none, still, 1e-6, 7.7e-3, True)
    assert tube.end == OK and np.all(tube.margin >= 0.0) and np.all(np.abs(still) <= np.maximum(tube.v_hi[0], -tube.v_lo[0]))
    assert marched(plant._replace(rotor=np.full(3, 0.5)), none, 0.1 * fast, 1e-6, 2e-3, True).end == OK


def test_a_momentum_beyond_double_precision_is_not_provable() -> None:
    """The momentum overflows: nothing is known of what the brake must have given to end it, and no stop is provable."""
    chain, body = chain_of(np.zeros(0), UPRIGHT), bodies(np.ones(1), np.zeros(1), np.ones(1))
    plant = plant_of(chain, body, np.full(1, 1e150), np.full(1, 1e308), 0.1, 0.1, u=1e300)
    speed = np.full(1, 2e160)
    tube = march(plant, Box(0.0 * speed, 0.0 * speed), Box(speed, speed), Stride(1.0, 590), ALL_PARTS)
    assert tube.end == UNBOUNDED


# ---- whole stops: the brakes' windows


@pytest.mark.parametrize("delay_spread", [0.0, 0.05])
def test_brakes_that_close_together_are_one_window_or_two(delay_spread: float) -> None:
    """Delays farther apart than they are long say nothing (0.05 s); all at once (0 s) is tighter; both as Python has them."""
    bounds, any_ = bounds_of(cut_together(delay_spread)), core_stop(bounds_of(with_delay_spread(None)))
    core, n = core_stop(bounds), 4
    for q, dq in states(bounds.model, 4, 3):
        want, got, free = bounds.bound(q, dq, "0", np.zeros(n), np.zeros(n)), core(q, dq), any_(q, dq)
        assert got is not None and free is not None and want.forward is not None
        assert np.array_equal(got.forward, want.forward) and np.array_equal(got.back, want.back)
        assert np.all(got.forward <= free.forward) and (delay_spread == 0.0 or np.array_equal(got.forward, free.forward))


def with_delay_spread(delay_spread: float | None) -> Any:
    model = cut_together(0.0)
    assert model.brakes is not None
    return replace(model, brakes=replace(model.brakes, delay_spread=delay_spread))


@pytest.mark.parametrize("rotor", [8.0, 0.3])
@pytest.mark.parametrize("stiff", [-60.0, -300.0, -1000.0])
def test_a_spring_that_pushes_away_is_bounded_where_its_stop_stays_or_not_at_all(stiff: float, rotor: float) -> None:
    """The farther the joint gets the harder it is pushed: some stops stay in the region that their effects were evaluated for, some outgrow
    every one. At rest, and at speed."""
    bounds = bounds_of(braked(rotor, 3, effort="motor_torque", effects=[friction("spring", "axis_2", k=stiff, c=0.0)]))
    core, found = core_stop(bounds), set()
    for q, dq in states(bounds.model, 6, 4, 1.0):
        found |= {same(bounds, core, q, share * dq, "0") for share in (0.0, 1.0)}
    assert False in found and (True in found or stiff == -1000.0)


def test_faster_than_ever_seen_an_effect_is_bounded_for_that_speed() -> None:
    bounds = bounds_of(braked(8.0, 3, effort="motor_torque", effects=[friction("stribeck", "axis_2", F_s=6.0, v_s=0.06)]))
    core, q = core_stop(bounds), np.array([0.2, 0.7, -0.4])
    assert bounds.setting is not None
    far = [core(q, share * bounds.setting.torques.fastest, "0") for share in (0.5, 0.99, 2.0)]
    assert all(x is not None for x in far) and far[0].forward.max() < far[1].forward.max() < far[2].forward.max()


# ---- ramps


def same(bounds: StopBounds, core: Any, q: Array, dq: Array, category: str, radius: float = 0.0) -> bool:
    """Whether there is a bound: the core's and Python's are one to the last bit, or both refuse."""
    r = np.full(len(q), radius)
    want, got = bounds.bound(q, dq, category, r, r), core(q, dq, category, r, r)  # type: ignore[arg-type]
    assert want.certified == (got is not None), want.why
    if got is not None:
        pairs = ((got.time, want.time), (got.forward, want.forward), (got.back, want.back), (got.speed, want.speed))
        assert all(np.array_equal(a, b) for a, b in pairs) and got.tool.tolist() == [want.tcp, want.tcp_speed]
    return got is not None


def with_ramp(model: Any, **changes: Any) -> tuple[StopBounds, Any]:
    ramp: Ramp = ramped(model.n, **changes)
    bounds = replace(bounds_of(model), ramp=ramp)
    return bounds, core_stop(bounds)


def test_joints_that_do_not_move_ask_nothing_of_the_ramp() -> None:
    for kind in ({}, {"kind": "deceleration", "value": Box.of(np.full(4, 3.0), np.full(4, 3.6))}):
        bounds, core = with_ramp(braked(8.0), **kind)
        for q, dq in states(bounds.model, 4, 5):
            for still in ([0], [1, 2], [0, 1, 2, 3]):
                dq[still] = 0.0
                assert same(bounds, core, q, dq, "1") and same(bounds, core, q, dq, "1", 1e-3)


def test_a_programmed_motion_that_turns_round_within_the_ramp_is_left_there() -> None:
    """Along a motion that itself slows by 8 / s the speed is gone before the ramp is."""
    bounds, core = with_ramp(braked(8.0), pace=(-8.0, 0.7))
    for q, dq in states(bounds.model, 4, 5, 0.2):
        assert same(bounds, core, q, dq, "1")


def test_a_joint_that_may_go_either_way_has_the_ramps_of_every_speed_between() -> None:
    """Of a fixed deceleration the slowest speed is braked first, whatever its direction, and has most left of its pace."""
    bounds, core = with_ramp(braked(8.0), kind="deceleration", value=Box.of(np.full(4, 3.0), np.full(4, 3.6)), pace=(-8.0, 0.7))
    for q, dq in states(bounds.model, 4, 5, 0.2):
        dq[:2] *= 1e-3
        assert same(bounds, core, q, dq, "1", 1e-3)


def test_brakes_that_cannot_hold_the_arm_where_it_is_or_comes_to_prove_nothing() -> None:
    model, held = braked(8.0, effort="motor_torque"), set()
    assert model.brakes is not None
    for q, dq in states(model, 12, 21, 1.0):
        weak, strong, found = 0.02, 0.6, {}
        while strong - weak > 1e-3:  # at the least that holds it the start, or the end, asks for more
            share = 0.5 * (weak + strong)
            brakes = replace(model.brakes, torque=Box.of(share * model.brakes.torque.lo, model.brakes.torque.hi))
            found[share] = same(*with_ramp(replace(model, brakes=brakes)), q, dq, "1")
            weak, strong = (weak, share) if found[share] else (share, strong)
        held |= {frozenset(found.values())}
    assert frozenset({True, False}) in held


# ---- sets of points


def test_a_point_whose_ways_are_not_known_has_the_sets_of_its_box() -> None:
    s = StopBounds.of(prbt_like(), (0.0, 0.25)).setting
    assert s is not None
    q, dq, r = np.full(6, 0.3), np.full(6, 0.5), s.noise.radius[:6]
    cut = slices(march_box(s, s.plant, Start(q, dq, r, s.noise.radius[6:]), energetic=True), SLICES)
    assert cut.left is not None
    none = reached(s.plant.chain, q, r, cut._replace(near_lo=None, near_hi=None, left=None), [5], [s.payload_com])[0]
    unknown = reached(s.plant.chain, q, r, cut._replace(left=np.full_like(cut.left, np.inf)), [5], [s.payload_com])[0]
    for a, b in zip(none, unknown, strict=True):
        assert np.array_equal(a, b)
    swift = np.array([swiftness(s.plant, len(q) - 1, s.payload_com)])
    slow = reached(s.plant.chain, q, r, cut, [5], [s.payload_com], swift)[0]
    unpaid = reached(s.plant.chain, q, r, cut._replace(path=None), [5], [s.payload_com], swift)[0]
    assert slow.far <= unpaid.far == reached(s.plant.chain, q, r, cut, [5], [s.payload_com])[0].far


# ---- payloads


def looped(loop: StopBounds, q: Array, dq: Array) -> Stopped:
    """A bound of Python's loop, in the core's words."""
    b = loop.bound(q, dq)
    assert b.time is not None and b.forward is not None and b.back is not None and b.speed is not None
    return Stopped(b.time, b.forward, b.back, b.speed, np.array([b.tcp, b.tcp_speed]))


def test_a_range_of_payloads_has_the_bound_of_its_parts_or_of_all_of_it_where_the_tool_gets_less_far() -> None:
    """Beside all of the range at once and each part, bounded by themselves; neither is the better in every state."""
    model = random_arm(4, 0)
    rated = model.domain.payload[1]
    bounds, rng, n = StopBounds.of(model, (0.9 * rated, rated), fast=True), np.random.default_rng(5), model.n
    assert bounds.setting is not None
    either, asked, by_parts = CompiledStops.of(bounds.setting), 0, 0
    whole, *parts = (replace(bounds, setting=s, parts=()) for s in (bounds.setting, *bounds.parts))
    for k in range(27):
        q, dq = rng.uniform(-np.pi, np.pi, n), rng.uniform(-1.0, 1.0, n) * model.domain.dq.hi
        if k < 18 or whole.bound(q, dq).layer != "energy":
            continue
        a, b, heavier, lighter = either.bound(q, dq), *(looped(loop, q, dq) for loop in (whole, *parts))
        assert a is not None
        worst = Stopped(*(np.maximum(getattr(heavier, x), getattr(lighter, x)) for x in Stopped.__slots__))
        less = bool(worst.tool[0] < b.tool[0])
        asked, by_parts = asked + 1, by_parts + less
        for name in Stopped.__slots__:
            assert np.array_equal(getattr(a, name), getattr(worst if less else b, name))
    assert 4 <= by_parts < asked


def test_payloads_that_are_alike_are_bounded_by_one_tube_of_finer_steps() -> None:
    """Of a load known to 2 % the core and Python's loop say the same, parts or not; all of the range in steps as coarse as elsewhere lets the arm go
    farther in most states."""
    model = random_arm(5, 0)
    rated, rng, n = model.domain.payload[1], np.random.default_rng(5), model.n
    alike, some = (StopBounds.of(model, (share * rated, rated), fast=True) for share in (0.98, 0.97))
    assert alike.setting is not None and some.setting is not None
    assert (alike.setting.payloads, some.setting.payloads) == (lib.STOPSET_ALIKE_PAYLOADS, lib.STOPSET_SOME_PAYLOADS)
    core, coarse = (
        CompiledStops.of(alike.setting),
        replace(alike, setting=replace(alike.setting, payload=(0.97 * rated, rated)), parts=()),
    )
    nearer = 0
    for _ in range(8):
        q, dq = rng.uniform(-np.pi, np.pi, n), rng.uniform(-1.0, 1.0, n) * model.domain.dq.hi
        a, b, loop = core.bound(q, dq), looped(coarse, q, dq), alike.bound(q, dq)
        assert a is not None and loop.forward is not None and loop.back is not None
        assert np.array_equal(a.forward, loop.forward) and np.array_equal(a.back, loop.back) and np.array_equal(a.time, loop.time)
        nearer += bool(max(a.forward.max(), a.back.max()) < max(b.forward.max(), b.back.max()))
    assert nearer >= 6
    weak = replace(alike.setting, plant=alike.setting.plant._replace(brake_lo=0.01 * alike.setting.plant.brake_lo))
    assert CompiledStops.of(weak).bound(q, dq) is None  # nor have its parts a bound


# ---- what is known better, and bands that have fed on each other


@pytest.mark.parametrize("arm", [(4, 0), (5, 0), (6, 0)])
def test_who_knows_the_load_exactly_gets_no_farther_angle_than_who_knows_it_to_2_percent(arm: tuple[int, int]) -> None:
    """Where the kinetic energy has to bound it: one payload had coarser steps, and angles up to 3 times as far."""
    model = random_arm(*arm)
    rated, rng, n = model.domain.payload[1], np.random.default_rng(7), model.n
    exact, about = (StopBounds.of(model, (lo * rated, hi * rated), fast=True) for lo, hi in ((0.99, 0.99), (0.98, 1.0)))
    assert exact.setting is not None and exact.setting.payloads == lib.STOPSET_ONE_PAYLOAD
    core, ratios = CompiledStops.of(exact.setting), []
    for k in range(12):
        q, dq = rng.uniform(-3.0, 3.0, n), rng.uniform(-1.0, 1.0, n) * model.domain.dq.hi
        radii = np.full((2, n), 0.01 * (k % 2))
        a, b, same = exact.bound(q, dq, "0", *radii), about.bound(q, dq, "0", *radii), core.bound(q, dq, "0", *radii)
        assert a.angle is not None and b.angle is not None and a.tcp is not None and b.tcp is not None and same is not None
        assert np.array_equal(a.time, same.time) and np.array_equal(a.forward, same.forward)  # type: ignore[arg-type]
        if a.layer == b.layer == "energy":
            ratios.append([a.angle.max() / b.angle.max(), a.tcp / b.tcp])
    assert len(ratios) >= 6 and np.max(ratios, axis=0)[0] <= 1.001 and np.median(ratios, axis=0)[1] < 1.0


@pytest.mark.parametrize(("arm", "share", "energetic"), [((7, 1), 0.0, True), ((5, 0), 0.0, True), ((2, 0), 0.99, False)])
def test_in_a_loop_too_the_nearer_proof_counts_where_bands_have_fed_on_each_other(
    arm: tuple[int, int], share: float, energetic: bool
) -> None:
    """As in tables; core and Python take the same of the two, and no sampled stop goes beyond it."""
    model = random_arm(*arm)
    load, rng, n = share * model.domain.payload[1], np.random.default_rng(9), model.n
    loop = StopBounds.of(model, (load, load), fast=True)
    s, nearer = loop.setting, []
    assert s is not None
    core, r, v = CompiledStops.of(s), s.noise.radius[:n], s.noise.radius[n:]
    for k in range(16):
        q, dq = rng.uniform(-3.0, 3.0, n), rng.uniform(-1.0, 1.0, n) * model.domain.dq.hi
        start = Start(q, dq, r, v)
        plain = march_box(s, s.plant, start, energetic=False, knots=FAST_KNOTS)
        if plain.end != OK or not _blurred(plain):
            continue
        b, same = loop.bound(q, dq), core.bound(q, dq)
        assert b.time is not None and b.tcp is not None and same is not None
        for name in ("time", "forward", "back", "speed"):
            assert np.array_equal(getattr(b, name), getattr(same, name))
        assert b.tcp == same.tool[0] and (b.layer == "energy") == energetic
        (tube,) = tubes_of(s, start, 1, fast=True)
        assert sample_stops(s.plant, q, dq, r, v, s.payload_com, tube, 30, k).escaped == 0
        nearer.append(float(np.max(b.angle) / max(plain.d_hi.max(), -plain.d_lo.min())))  # type: ignore[arg-type]
    assert len(nearer) >= 3 and (np.median(nearer) < 0.9) == energetic
