"""Laws at random over intervals: what the core bounds a law by holds it at every sample, or there is no bound."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stopset.artifact.taped import MEMORY, SIGNALS, TILT
from stopset.core.library import ffi, lib, view
from stopset.core.library import given as array
from stopset.effects.base import Fitted
from stopset.effects.registry import get
from stopset.fmu.stops import bounds_of
from stopset.reach.stops.laws import ActingLaw, BoundLaw, acting_law
from stopset.ring import tape as t
from stopset.types import Array
from test_fmu import friction
from test_fmu_stops import braked, core_stop, ramped

RANGES = {
    "q": (-0.6, 1.1),
    "load": (-12.0, 30.0),
    "temp": (0.0, 15.0),
    "stiff": (0.5, 9.0),
    "inertia": (0.2, 2.0),
    "coriolis": (-3.0, 3.0),
}
SEEN = [
    SIGNALS.index(k) for k in ("q", "dq", "given_direction", "load", "temp", "warm", "stiff", "inertia", "coriolis", "dq_other")
] + [
    TILT,
    TILT + 1,
]
SPEED, OTHER, GEAR, ROWS = 1.3, 0.8, 30.0, 96
EDGES = [0.0, 1.0, -1.0, 3.0, 1e-300, 1e300, -1e300, 800.0, 2e6, 1e-9]
seeds = st.integers(0, 2**32 - 1)


def sight(**more: Any) -> Any:
    fields = {"speed": SPEED, "past": SPEED, "other": OTHER, "gear": GEAR, "tilt": [(-4.0, 9.0), (0.0, 3.0)], **RANGES}
    return ffi.new("StopsetSight *", {**fields, **more})


def acted(law: ActingLaw, **more: Any) -> Array | None:
    """(3, 2) ends of dry, viscous |dq| and push; None: no bound."""
    keep: list[Any] = []
    out, struct = np.empty(6), ffi.new("StopsetActing *", law.struct(keep))
    code = lib.stopset_act(struct, sight(**more), view(out))
    assert code in (0, lib.STOPSET_NO_BOUND)
    return None if code else out.reshape(3, 2)


def drawn(rng: np.random.Generator) -> ActingLaw:
    """Steps of every kind that only look back; parameters and constants as intervals, wild ones among them."""
    length, numbers = (
        int(rng.integers(2, 16)),
        np.sort(
            np.where(rng.random((6, 1)) < 0.3, rng.choice(EDGES, (6, 1)), rng.normal(size=(6, 1)) + np.array([0.0, 0.1])), axis=1
        ),
    )
    steps = np.zeros((length, 3), np.int32)
    for k in range(length):
        what = int(rng.choice([0, 1, *range(2, 18)])) if k > 1 else k
        first, second = rng.integers(0, max(k, 1), 2)
        if what == t.CONSTANT:
            first = rng.integers(6)
        elif what == t.SIGNAL:
            first = rng.choice(SEEN if rng.random() < 0.97 else [SIGNALS.index("tau")])
        elif what == t.POWER:
            second = rng.integers(2, 6)
        steps[k] = what, first, second
    at = rng.integers(0, length, int(rng.integers(1, 4))).astype(np.int32)
    value = np.sort(rng.normal(size=(len(at), 1)) + 0.2 * rng.random((len(at), 2)), axis=1)
    columns = BoundLaw(steps, numbers, at, frozenset())
    role, straight = int(rng.choice([lib.STOPSET_RUBS, lib.STOPSET_PULLS, lib.STOPSET_ARM_OR_DRIVE])), bool(rng.integers(2))
    return ActingLaw("drawn", 0, -1, role, straight, True, 0, columns, value, np.zeros((0, 2)), None, 0.0, (0.0, 0.0))


def sampled(law: ActingLaw, rng: np.random.Generator, rest: bool) -> tuple[Array, Array, Array]:
    """Torques, directions and speeds of samples, and of their ends; ``rest``: standing, friction in any direction between."""
    s = np.zeros((lib.STOPSET_SIGNALS, ROWS))

    def some(lo: float, hi: float) -> Array:
        return np.where(rng.random(ROWS) < 0.4, rng.choice([lo, hi], ROWS), rng.uniform(lo, hi, ROWS))

    direction = rng.uniform(-1.0, 1.0, ROWS) if rest else rng.choice([-1.0, 1.0], ROWS)
    speed = np.zeros(ROWS) if rest else some(0.0, SPEED)
    for name, (lo, hi) in RANGES.items():
        s[SIGNALS.index(name)] = some(lo, hi) if name != "load" or law.role != lib.STOPSET_RUBS else some(-GEAR, GEAR)
    s[SIGNALS.index("dq")], s[SIGNALS.index("given_direction")] = direction * speed, direction
    s[SIGNALS.index("warm")], s[SIGNALS.index("dq_other")] = some(0.0, 1.0), some(-OTHER, OTHER)
    s[TILT], s[TILT + 1] = some(-4.0, 9.0), some(0.0, 3.0)
    numbers, torque = law.columns.numbers, np.zeros(ROWS)
    at = np.ascontiguousarray(numbers[:, 0] + rng.random(len(numbers)) * (numbers[:, 1] - numbers[:, 0]))
    for place, (lo, hi) in zip(law.columns.at, law.value, strict=True):
        steps, column = np.ascontiguousarray(law.columns.steps[: place + 1]), np.empty(ROWS)
        program = ffi.new("StopsetProgram *", (place + 1, ffi.cast("int32_t *", ffi.from_buffer(steps)), view(at)))
        lib.stopset_law(program, ROWS, view(s), view(column))
        torque += column * rng.choice([lo, hi])
    fine = ~np.isnan(torque)  # an angle beyond all is no number to a law, and any cosine to its bound
    return torque[fine], direction[fine], speed[fine]


@settings(max_examples=600, deadline=None)
@given(seeds)
def test_a_law_at_random_stays_within_its_bound_or_has_none(seed: int) -> None:
    rng = np.random.default_rng(seed)
    law = drawn(rng)
    got = acted(law)
    if got is None:
        return
    assert np.all(np.isfinite(got)) and np.all(got[:, 0] <= got[:, 1])
    for rest in (False, True):
        torque, direction, speed = sampled(law, rng, rest)
        if rest:  # friction at rest takes what it can, in either direction
            if law.straight or law.role == lib.STOPSET_RUBS:
                continue
            held = max(got[0, 1], 0.0)
            lo, hi = np.full(len(direction), got[2, 0] - held), np.full(len(direction), got[2, 1] + held)
        else:
            odd = np.sort(direction * (got[0, :, None] + got[1, :, None] * speed), axis=0)
            lo, hi = odd[0] + got[2, 0], odd[1] + got[2, 1]
        size = 1e-9 * (1.0 + np.abs(got).max() + np.abs(torque))
        assert np.all((torque >= lo - size) & (torque <= hi + size)), (law.columns.steps.tolist(), got, torque)


def one(
    *steps: tuple[int, int, int], numbers: Any = ((0.0, 0.0),), role: int | None = None, straight: bool = True, **more: Any
) -> ActingLaw:
    """A law of a single column, its last step, with the parameter 1."""
    columns = BoundLaw(np.array(steps, np.int32), np.array(numbers, float), np.array([len(steps) - 1], np.int32), frozenset())
    pulls = lib.STOPSET_PULLS if role is None else role
    law = ActingLaw("one", 0, -1, pulls, straight, True, 0, columns, np.ones((1, 2)), np.zeros((0, 2)), None, 0.0, (0.0, 0.0))
    return replace(law, **more)


SIGN, DQ, DIRECTION, Q = t.SIGN, SIGNALS.index("dq"), SIGNALS.index("given_direction"), SIGNALS.index("q")


def test_what_has_no_number_somewhere_in_its_intervals_has_no_bound() -> None:
    q, number = (t.SIGNAL, Q, 0), (t.CONSTANT, 0, 0)
    assert acted(one(q, (t.DIV, 0, 0))) is None  # divided by what passes zero
    assert acted(one(q, (t.SQRT, 0, 0))) is None  # a root of less than zero
    assert acted(one((t.SIGNAL, SIGNALS.index("tau"), 0))) is None  # a signal that nobody bounds
    assert acted(one(number, number, (t.MUL, 0, 1), numbers=((1e308, 1e308),))) is None  # beyond double precision
    lower = (number, (t.CONSTANT, 1, 0), (t.MUL, 0, 1))  # beyond it on the other side
    assert acted(one(*lower, numbers=((1e308, 1e308), (-1e308, -1e308)))) is None
    assert acted(one(number, (t.EXP, 0, 0), numbers=((800.0, 801.0),))) is None
    assert acted(one((t.SIGNAL, DQ, 0), (t.DIV, 0, 0))) is None  # at rest, or at once
    assert acted(one(q, numbers=((0.0, 0.0),)), q=(math.nan, math.nan)) is None
    # at rest alone: 1 / (1.5 - way) has a number in both directions, 1 / (0.5 - way) has none between them
    between = (number, (t.SIGNAL, DIRECTION, 0), (t.SUB, 0, 1), (t.DIV, 0, 2))
    assert acted(one(*between, numbers=((1.5, 1.5),), straight=False)) is not None
    assert acted(one(*between, numbers=((0.5, 0.5),), straight=False)) is None


@pytest.mark.parametrize(
    ("angle", "want"),
    [
        ((2e6, 2e6 + 0.1), (-1.0, 1.0)),
        ((-2e6, 0.0), (-1.0, 1.0)),
        ((-8.0, 8.0), (-1.0, 1.0)),
        ((0.1, 0.2), (math.cos(0.2), math.cos(0.1))),
        ((-0.1, 0.2), (math.cos(0.2), 1.0)),
    ],
)
def test_a_cosine_is_known_as_far_as_angles_are(angle: tuple[float, float], want: tuple[float, float]) -> None:
    got = acted(one((t.SIGNAL, Q, 0), (t.COS, 0, 0)), q=angle)
    assert got is not None and got[2] == pytest.approx(want, abs=1e-12) and got[2, 0] <= want[0] and got[2, 1] >= want[1]


def test_a_state_is_bounded_by_its_flow_at_speeds_it_was_not_seen_at() -> None:
    """Presliding friction driven faster than before: its state still is between -1 and 1; without a law of its flow there is no bound."""
    f = Fitted("hysteresis", "j", {"F_h": 12.0, "delta": 0.02}, {})
    law = acting_law(get("hysteresis"), f, 0, -1, 0.5, warm=True)
    seen, faster = acted(law, speed=0.5, past=0.5), acted(law, speed=2.0, past=0.5)
    assert seen is not None and faster is not None and np.abs(faster).max() == pytest.approx(2 * 12.0)
    assert law.flow is not None and MEMORY in law.columns.looks
    endless = replace(
        law,
        flow=BoundLaw(
            np.array([(t.SIGNAL, DQ, 0), (t.DIV, 0, 0)], np.int32), np.zeros((1, 2)), np.zeros(1, np.int32), frozenset()
        ),
    )
    assert acted(endless, speed=2.0, past=0.5) is None and acted(endless, speed=0.5, past=0.5) is not None


# ---- all effects of an arm in a region


def test_what_laws_see_of_the_rigid_body_holds_it_at_every_pose() -> None:
    """Gravity's stiffness and the inertia as such, as a law's torque: at poses of a region they lie between what it is bounded by."""
    model = braked(8.0, 3, effort="motor_torque", effects=[friction("spring", "axis_2", k=8.0, c=0.1)])
    s = bounds_of(model).setting
    assert s is not None
    n, rng = 3, np.random.default_rng(3)
    q, wide, fast = np.array([0.2, 0.7, -0.4]), np.full(3, 0.15), np.array([0.5, 1.0, 0.8])
    seen = {"stiff": "STIFF", "inertia": "INERTIA", "load": "LOAD", "coriolis": "LINK"}
    for name, bit in seen.items():
        needs = getattr(lib, f"STOPSET_NEEDS_{bit}")
        laws = [replace(one((t.SIGNAL, SIGNALS.index(name), 0)), joint=i, needs=needs) for i in range(n)]
        lo, hi = over(s, laws, needs, q - wide, q + wide, fast)
        worst = np.zeros(n)
        for _ in range(100):
            x, dq = q + rng.uniform(-wide, wide), rng.choice([-1.0, 1.0], n) * fast
            value = truth(s.plant, x, dq, name)
            assert np.all(lo - 1e-9 <= -value) and np.all(-value <= hi + 1e-9)
            worst = np.maximum(worst, np.abs(value))
        if name == "coriolis":  # of what stands still there is none
            lo, hi = over(s, laws, needs, q - wide, q + wide, np.zeros(n))
        assert np.all(hi - lo < (1e-9 if name == "coriolis" else 1.5 * (1.0 + worst)))


def test_a_law_of_the_sign_of_what_never_is_zero_is_a_constant() -> None:
    """Of speed less (more) than what the joint ever has: it pushes one way, and opposes nothing."""
    for off, want in ((2.0, -1.0), (-2.0, 1.0)):
        got = acted(one((t.SIGNAL, DQ, 0), (t.CONSTANT, 0, 0), (t.SUB, 0, 1), (SIGN, 2, 0), numbers=((off, off),)))
        assert got is not None and np.allclose(got, [[0.0, 0.0], [0.0, 0.0], [want, want]], rtol=0.0, atol=1e-12)


def test_what_is_made_of_constants_alone_is_one() -> None:
    """A sign that never changes, times itself, is the number one; times the speed it is the speed, or its opposite."""
    speed, off = (t.SIGNAL, DQ, 0), (t.CONSTANT, 0, 0)
    sign = (speed, off, (t.SUB, 0, 1), (SIGN, 2, 0))
    squared = acted(one(*sign, (t.MUL, 3, 3), numbers=((2.0, 2.0),)))
    assert squared is not None and np.allclose(squared, [[0.0, 0.0], [0.0, 0.0], [1.0, 1.0]], rtol=0.0, atol=1e-12)
    for off_at, other in ((2.0, -1.0), (-2.0, 1.0)):
        got = acted(one(*sign, (t.MUL, 3, 0), numbers=((off_at, off_at),)))
        want = acted(one(speed, off, (t.MUL, 1, 0), numbers=((other, other),)))
        assert got is not None and want is not None and np.allclose(got, want, rtol=0.0, atol=1e-12)


def test_a_product_is_the_same_in_either_order_where_a_factor_jumps() -> None:
    speed, off = (t.SIGNAL, DQ, 0), (t.CONSTANT, 0, 0)
    jumps = (speed, off, (t.SUB, 0, 1), (SIGN, 2, 0))  # at a speed that the joint has
    one_way, other = (acted(one(*jumps, (t.MUL, *at), numbers=((0.5, 0.5),))) for at in ((3, 0), (0, 3)))
    assert one_way is not None and other is not None and np.allclose(one_way, other, rtol=0.0, atol=1e-12)
    far = np.abs(one_way).max(axis=1) @ [1.0, SPEED, 1.0]
    assert far >= SPEED, "sign(v - 0.5) v at the largest speed"


def truth(plant: Any, q: Array, dq: Array, name: str) -> Array:
    from stopset.robot.rigid import gravity_torque, mass_matrix, torque

    if name == "inertia":
        return np.diag(mass_matrix(plant.chain, plant.pi, q))
    if name == "load":
        return gravity_torque(plant.chain, plant.pi, q)
    if name == "coriolis":
        return torque(plant.chain, plant.pi, q, dq, np.zeros(len(q))) - gravity_torque(plant.chain, plant.pi, q)
    d = 1e-5
    ahead, back = (
        np.array([gravity_torque(plant.chain, plant.pi, q + side * e)[i] for i, e in enumerate(d * np.eye(len(q)))])
        for side in (1, -1)
    )
    return (ahead - back) / (2 * d)


def over(s: Any, laws: list[ActingLaw], needs: int, q_lo: Array, q_hi: Array, speed: Array) -> tuple[Array, Array]:
    """What laws push the joints by, (n,) each, in a region; raises where there is no bound."""
    from stopset.reach.stops.tube import plant_struct

    n = len(speed)
    keep: list[Any] = []
    table = ffi.new("StopsetActing[]", [law.struct(keep) for law in laws])
    none, far, gear = np.zeros(10 * n), np.full(n, 1e3), np.full(n, 30.0)
    zero, turn = np.zeros(n), array(s.torques.body.K.Gamma)
    torques = ffi.new("StopsetTorques *", {
        "laws": len(laws), "needs": needs, "law": table, "base": view(none), "fixed": view(none), "gear": view(gear),
        "speed": view(far), "fastest": view(far), "free_lo": view(zero), "free_hi": view(zero), "turn": view(turn),
    })  # fmt: skip
    struct, held = plant_struct(s.plant)
    out = np.empty(6 * n)
    code = lib.stopset_friction_over(struct, torques, *(view(x) for x in (q_lo, q_hi, speed)), view(out))
    assert held
    if code:
        raise ValueError(code)
    return out[4 * n : 5 * n], out[5 * n :]


@pytest.mark.parametrize("category", ["0", "1", "1 guaranteed", "2"])
def test_where_a_law_has_no_bound_no_stop_is_provable(category: str) -> None:
    """A spring becomes a law that has none at the angles of the stop, or where the arm comes to stand."""
    model = braked(8.0, 3, effort="motor_torque", effects=[friction("spring", "axis_2", k=8.0, c=0.1)])
    bounds = replace(bounds_of(model), ramp=ramped(3))
    core = core_stop(bounds)
    q, dq = np.array([0.2, 0.7, -0.4]), np.array([0.1, 0.2, -0.1])
    assert core(q, dq, category) is not None
    struct = core.__self__.struct  # type: ignore[attr-defined]
    law = struct.torques.law[0]
    steps = ffi.cast("int32_t *", law.law.steps)
    before = [steps[k] for k in range(3 * law.law.length)]
    place = next(k for k in range(law.law.length) if steps[3 * k] == t.SIGNAL)
    steps[3 * place + 1] = SIGNALS.index("tau")
    assert core(q, dq, category) is None
    for k, x in enumerate(before):
        steps[k] = x
    assert core(q, dq, category) is not None
