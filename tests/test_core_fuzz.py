"""The C core fed with anything: wild numbers, every size, laws at random. Nothing may crash, and what is not a number stays visible.

`.ci/sanitize` runs this file under the address and undefined-behaviour sanitizers.
"""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from core_calls import maths, point_jacobian, solve_inclusion
from stop_certificate import follow
from stop_sampling import point_motion
from stopset.core.library import ffi, integers, lib, view
from stopset.reach.stops.cartesian import slices, swept_capsules
from stopset.reach.stops.expansion import Curvature
from stopset.reach.stops.parts import ALL_PARTS
from stopset.reach.stops.tube import OK, Plant, Stride, march
from stopset.ring.tape import STEPS, TANH, Tape
from stopset.robot.rigid import (
    Chain,
    gravity_torques,
    link_frames,
    mass_matrices,
    moment_arms,
    regressors,
    torques,
)
from stopset.simulation.stop import StoppingArm, simulate_stop
from stopset.types import Array

WILD = np.array([0.0, -0.0, 1.0, -1.0, 1e-320, 1e-8, 3.14159, 1e6, 1.1e6, 1e17, 1e308, -1e308, math.inf, -math.inf, math.nan])
seeds = st.integers(0, 2**32 - 1)


def drawn(rng: np.random.Generator, *shape: int) -> Array:
    """Ordinary numbers, with wild ones among them half of the time."""
    x = rng.normal(size=shape)
    return np.where(rng.random(shape) < 0.1, rng.choice(WILD, shape), x) if rng.random() < 0.5 else x


@settings(max_examples=150, deadline=None)
@given(seeds)
def test_rigid_body(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, N = int(rng.integers(1, 33)), int(rng.integers(1, 5))
    chain = Chain(drawn(rng, n, 3, 3), drawn(rng, n, 3), drawn(rng, n, 3), drawn(rng, 3))
    pi, q, dq, ddq = drawn(rng, n, 10), drawn(rng, N, n), drawn(rng, N, n), drawn(rng, N, n)
    tau = torques(chain, pi, q, dq, ddq)
    (
        gravity_torques(chain, pi, q),
        mass_matrices(chain, pi, q),
        regressors(chain, q, dq, ddq),
        moment_arms(chain, pi, q),
        link_frames(chain, q),
    )
    point_jacobian(chain, q[0], int(rng.integers(n)), drawn(rng, 3))
    assert np.all(np.isnan(tau[np.isnan(q[:, -1]) | np.isnan(ddq[:, -1])][:, -1]))  # the last joint's own


@settings(max_examples=100, deadline=None)
@given(seeds)
def test_maths(seed: int) -> None:
    x = drawn(np.random.default_rng(seed), 200)
    for name in ("sin", "cos", "exp", "expm1", "tanh", "log"):
        y = maths(name, x)
        assert np.all(np.isnan(y[np.isnan(x)]))
    assert np.all(np.abs(maths("sin", x)[np.abs(x) <= 1e6]) <= 1.0)


@settings(max_examples=150, deadline=None)
@given(seeds)
def test_laws(seed: int) -> None:
    """Steps that only look back, of every kind, up to the longest law."""
    rng = np.random.default_rng(seed)
    length, N = int(rng.integers(1, STEPS + 1)), int(rng.integers(0, 40))
    numbers, steps = drawn(rng, 5), np.zeros((length, 3), np.int32)
    for k in range(length):
        what = int(rng.integers(0, TANH + 3)) if k else int(rng.integers(0, 2))
        steps[k] = (what, *rng.integers(0, (5 if what == 0 else lib.STOPSET_SIGNALS if what == 1 else k), 2))
    law = ffi.new("StopsetProgram *", (length, ffi.cast("int32_t *", ffi.from_buffer(steps)), view(numbers)))
    signals, out = drawn(rng, lib.STOPSET_SIGNALS, N), np.empty(N)
    assert lib.stopset_law(law, N, view(signals), view(out)) == 0


@settings(max_examples=100, deadline=None)
@given(seeds)
def test_predictions(seed: int) -> None:
    """Ages in any order, rows dead and alive, tubes of any width: a reading that is not a number is never inside."""
    rng = np.random.default_rng(seed)
    n, rows, ages = int(rng.integers(1, 9)), int(rng.integers(1, 30)), int(rng.integers(1, 30))
    m = 2 * n
    e, w, Ad, Bd = drawn(rng, rows, m), np.abs(drawn(rng, rows, m)), drawn(rng, m, m), drawn(rng, m, n)
    if rng.random() < 0.5:  # joints on their own
        Ad = np.where(np.kron(np.ones((2, 2)), np.eye(n)) != 0.0, Ad, 0.0)
    age, foreign, row = rng.integers(-1, ages, rows), np.zeros(rows, np.uint8), np.zeros((2, m), np.int64)
    lo, hi, room, seen = -np.abs(drawn(rng, ages, m)), np.abs(drawn(rng, ages, m)), np.empty(m), ffi.new("int64_t[2]")
    middle, reach, nearest = np.empty((ages, m)), np.empty((ages, m)), rng.integers(-2, rows + 2, m)
    struct = ffi.new("StopsetPredictions *", (
        m, rows, ages, view(e), view(w), integers(age), ffi.from_buffer("uint8_t[]", foreign), view(Ad), view(Bd), view(lo), view(hi),
        view(middle), view(reach), view(room), integers(nearest), integers(row),
    ))  # fmt: skip
    lib.stopset_centre(struct)
    x, before, u, du = drawn(rng, m), drawn(rng, m), drawn(rng, n), np.abs(drawn(rng, n))
    reading = ffi.new("StopsetReading *", (view(x), view(before), view(u), view(du)))
    live = lib.stopset_advance(struct, reading, int(rng.integers(2)), int(rng.integers(2)), seen)
    assert (
        live == np.count_nonzero(age >= 0) and seen[1] == np.count_nonzero(row >= 0) and np.all(row >= -1) and np.all(row < rows)
    )
    bounded = np.isfinite(lo).all(axis=0) & np.isfinite(hi).all(axis=0) & np.isfinite(w).all(axis=0)
    if live:
        assert np.all(row[:, np.isnan(x) & bounded] >= 0)


@settings(max_examples=60, deadline=None)
@given(seeds)
def test_simulated_friction_and_stops(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 9))
    B = rng.normal(size=(n, n))
    plus, minus, mode, w = np.abs(rng.normal(size=(2, n))), np.abs(rng.normal(size=n)), rng.integers(-1, 2, n), np.empty(n)
    solve_inclusion(B @ B.T + 0.1 * np.eye(n), drawn(rng, n), plus[0], minus, mode, w)
    chain = Chain(np.tile(np.eye(3), (n, 1, 1)), drawn(rng, n, 3), np.tile([0.0, 1.0, 0.0], (n, 1)), np.array([0.0, 0.0, -9.81]))
    pi = np.tile([1.0, 0, 0, 0, 0.1, 0, 0.1, 0, 0, 0.1], (n, 1))
    one = np.ones(n)
    simulate_stop(
        StoppingArm(chain, pi, one, one, one, one, 0.01 * one, 0.01 * one),
        drawn(rng, n),
        drawn(rng, n),
        1e-3,
        20,
        drawn(rng, 2, n),
    )


@settings(max_examples=40, deadline=None)
@given(seeds)
@example(791)  # ended in not a number and was told to hold the arm
@example(300)  # at rest by its speeds, held by nothing
@example(573)  # energy that outgrows every claim
def test_stop_tubes(seed: int) -> None:
    """Plants out of their senses: a tube ends, and one that comes to rest holds the arm."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 8))
    chain = Chain(np.tile(np.eye(3), (n, 1, 1)), drawn(rng, n, 3), np.tile([0.0, 1.0, 0.0], (n, 1)), np.array([0.0, 0.0, -9.81]))
    pi, half = np.tile([1.0, 0, 0, 0.05, 0.1, 0, 0.1, 0, 0, 0.1], (n, 1)), np.zeros((n, 10))
    half[-1] = drawn(rng, 10)

    def between() -> list[Array]:
        return list(np.sort(np.abs(drawn(rng, 2, n)), axis=0))

    curved = [np.abs(drawn(rng, *shape)) for shape in ((n,) * 4, (n,) * 3, (n,) * 3 + (n,), (n,), (n,))]
    rotor, u = np.abs(drawn(rng, n)) + 0.1, np.abs(drawn(rng, n))
    plant = Plant(
        chain, pi, half, rotor, 0.01 * np.ones(n), *between(), *between(), -u, u, *between(), *between(), *between(), Curvature(*curved)
    )  # fmt: skip
    q, (v_lo, v_hi) = drawn(rng, n), np.sort(drawn(rng, 2, n), axis=0)
    angles, speeds = (
        SimpleNamespace(lo=q - 1e-3, hi=q + 1e-3),
        SimpleNamespace(lo=v_lo, hi=v_hi),
    )  # a `Box` refuses what is no number
    tube = march(plant, angles, speeds, Stride(0.01, 30), ALL_PARTS, energetic=bool(rng.integers(2)))  # type: ignore[arg-type]
    assert tube.end in (OK, 1, 2) and 1 <= len(tube.t) <= 31
    if tube.end == OK:
        assert not tube.v_lo[-1].any() and not tube.v_hi[-1].any() and np.all(tube.margin >= 0.0)
        cut = slices(tube, 5)
        point_motion(chain, q, np.full(n, 1e-3), cut, n - 1, np.zeros(3))
        swept_capsules(chain, q, np.full(n, 1e-3), tube, np.zeros((n, 7)))
        follow(tube, v_lo, v_hi)


def test_a_tape_never_looks_ahead() -> None:
    """What the fuzzer above relies on, and the core too: the arguments of a step are earlier steps."""
    tape = Tape()
    x, y = tape.signal(0), tape.signal(1)
    steps, _ = tape.finished((x * y + x.sin()) / (y - 2.0).exp())
    for k, (what, a, b) in enumerate(steps.tolist()):
        assert what < 2 or (a < k and b < k)
