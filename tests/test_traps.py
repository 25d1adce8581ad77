"""One test per trap: the naive formula fails on a counterexample, ours holds. Numbers as in docs/requirements.md.

Traps of other parts are held where their code is tested: see the table of traps in docs/requirements.md.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import scipy.optimize
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.optimize import linprog
from scipy.stats import binom

import stopset.offline.conform.linear_program as linear
import stopset.offline.conform.program as program
from set_problems import problem
from stopset.artifact import Abstraction, Domain, UncertaintySets, load_model, save_model
from stopset.errors import RecordingError
from stopset.offline.abstraction.metrics import STOP_TIME
from stopset.offline.campaign.independence import independent_motions
from stopset.offline.campaign.reading_error import ReadingError
from stopset.offline.campaign.survey import on_grid
from stopset.offline.compare.compare import compare
from stopset.offline.conform.envelope import Deviations, Envelope, step_residual
from stopset.offline.conform.guarantee import clopper_pearson
from stopset.offline.conform.linear_program import FittedSets, fit_sets
from stopset.offline.identify.constants import settings_sha256
from stopset.offline.identify.pipeline import Settings, identify
from stopset.reach.flowpipe import Responses, deviation_tube, discretise, responses
from stopset.reach.predict import predict
from stopset.recording import Recording, read_meta, read_recordings, stream_recordings
from stopset.sets import Box
from synthetic import DT, arm, columns, lag, meta, names, recordings, save, save_trials, torques

# two joints that push each other: the off-diagonal of M^-1 is negative
COUPLED = Abstraction(1, 1, np.linalg.inv(np.array([[2.0, 0.8], [0.8, 1.0]])), np.array([[3.0], [8.0]]))
SINGLE = Abstraction(1, 1, np.array([[0.5]]), np.array([[4.0]]))
# sums of some hundred products of numbers near one
ROUNDING = 1e-12
NO_NOISE = 1e-9  # half-width that stands for "no noise"


def simulate(a: Abstraction, dt: float, x0: np.ndarray, u: np.ndarray) -> np.ndarray:
    """States (N+1, 2n) under inputs held over each step, by scipy's matrix exponential."""
    m, n = a.B.shape
    block = expm(np.block([[a.A, a.B], [np.zeros((n, m + n))]]) * dt)
    x = [np.array(x0, float)]
    for force in u:
        x.append(block[:m, :m] @ x[-1] + block[:m, m:] @ force)
    return np.array(x)


def envelope(a: Abstraction, trials: list[Recording], windows: str = "start", dt: float = DT) -> Envelope:
    d = Deviations(a, dt, len(trials[0].t) - 1, windows)
    env = d.empty()
    for r in trials:
        d.add(env, r, r.tau)
    return env


def leaves(fit: FittedSets, R: Responses, env: Envelope) -> float:
    """How far the envelope is outside the tube of the fit, worst over ages and promised states."""
    lo, hi = R.hull(fit.X0.lo, fit.X0.hi, fit.U.lo, fit.U.hi)
    rows, states = slice(1, env.steps + 1), slice(0, lo.shape[1] if fit.conform == "all" else lo.shape[1] // 2)
    above = (env.hi - hi - fit.V.hi)[rows, states].max()
    return float(max(above, (lo + fit.V.lo - env.lo)[rows, states].max()))


def recording(x: np.ndarray, u: np.ndarray, dt: float = DT, trial: int = 0) -> Recording:
    n = u.shape[1]
    return Recording("open_loop", 0, trial, trial, dt * np.arange(len(x)), x[:, :n].copy(), x[:, n:].copy(), u)


# ---- P1: signs of the response


def paper_hull(R: Responses, X0: Box, U: Box) -> tuple[np.ndarray, np.ndarray]:
    """Equations (19) and (20) as printed: sup <= |E| sup(X0, U), inf >= |E| inf(X0, U)."""
    E = np.abs(R.E1), R.plus - R.minus
    return E[0] @ X0.lo + E[1] @ U.lo, E[0] @ X0.hi + E[1] @ U.hi


def test_p1_printed_hull_misses_a_motion_when_a_response_is_negative() -> None:
    steps = 100
    R = responses(COUPLED, DT, steps)
    X0, U = Box.point(np.zeros(4)), Box.of([0.0, 1.0], [0.0, 2.0])  # joint 2 pushes, joint 1 gives way
    x = simulate(COUPLED, DT, np.zeros(4), np.tile([0.0, 2.0], (steps, 1)))
    lo, hi = paper_hull(R, X0, U)
    assert (lo - x).max() > 0.01
    lo, hi = R.hull(X0.lo, X0.hi, U.lo, U.hi)
    assert np.all(lo - ROUNDING <= x)
    assert np.all(x <= hi + ROUNDING)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 3))
def test_p1_tube_contains_every_simulation_with_a_changing_torque(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    L = rng.normal(size=(n, n))
    a = Abstraction(1, 1, np.linalg.inv(L @ L.T + 0.3 * np.eye(n)), rng.uniform(0.1, 20.0, (n, 1)))
    centre, radius = rng.normal(size=3 * n), rng.uniform(0, 1, 3 * n)
    both = Box(centre - radius, centre + radius)
    X0, U = both.take(slice(0, 2 * n)), both.take(slice(2 * n, 3 * n))
    R = responses(a, 0.02, 60)
    lo, hi = R.hull(X0.lo, X0.hi, U.lo, U.hi)
    for _ in range(4):
        corner = rng.uniform(size=(60, n)) < rng.uniform(0.1, 0.9)
        u = np.where(corner, U.lo, U.hi)
        x0 = np.where(rng.uniform(size=2 * n) < 0.5, X0.lo, X0.hi)
        x = simulate(a, 0.02, x0, u)
        room = ROUNDING * (1 + np.abs(x).max())
        assert np.all(x >= lo - room)
        assert np.all(x <= hi + room)


def test_p1_shrinking_the_torque_set_breaks_the_tube() -> None:
    """The tube is tight: the worst torque, on a set one percent too small, leaves it."""
    steps = 80
    R = responses(COUPLED, DT, steps)
    U = Box.of([-1.0, 0.5], [1.0, 2.0])
    ends = responses(COUPLED, DT, steps)
    for state in range(4):
        # the torque that pushes this state highest at the last age: the sign of the response, run backwards
        K = np.array([ends.E1[steps - k - 1][state] @ COUPLED.B for k in range(steps)])
        u = np.where(K > 0, U.hi, U.lo)
        x = simulate(COUPLED, DT, np.zeros(4), u)[-1, state]
        _, hi = R.hull(np.zeros(4), np.zeros(4), U.lo, U.hi)
        small = Box(U.centre - 0.99 * U.radius, U.centre + 0.99 * U.radius)
        _, less = R.hull(np.zeros(4), np.zeros(4), small.lo, small.hi)
        assert x <= hi[-1, state] + ROUNDING
        assert x > less[-1, state]


# ---- P2: measurement noise


def standing(noise: float, seed: int = 3, seconds: float = 3.0) -> list[Recording]:
    """A joint at rest whose position reading flickers by ``noise``, velocity by fifty times as much."""
    rng = np.random.default_rng(seed)
    N = round(seconds / DT) + 1
    return [
        recording(np.column_stack([rng.uniform(-noise, noise, N), 50 * rng.uniform(-noise, noise, N)]), np.zeros((N, 1)), DT, k)
        for k in range(4)
    ]


def test_p2_noise_without_a_set_of_its_own_becomes_torque_and_is_integrated() -> None:
    trials, noise = standing(1e-5), ReadingError.exact(Box.symmetric([1.01e-5, 5.05e-4]))
    env = envelope(SINGLE, trials, "sliding")
    R = responses(SINGLE, DT, env.steps)
    ours = fit_sets(env, R, problem(SINGLE, noise, DT, env.steps))
    naive = fit_sets(env, R, problem(SINGLE, ReadingError.exact(Box.symmetric([NO_NOISE] * 2)), DT, env.steps), capped=False)
    assert leaves(ours, R, env) <= 0.0

    def width(fit: FittedSets) -> float:
        lo, hi = R.hull(fit.X0.lo, fit.X0.hi, fit.U.lo, fit.U.hi)
        return float((hi - lo + fit.V.width)[-1, 0])

    # the truth never leaves +-1e-5 rad
    assert width(naive) > 5 * width(ours)


# ---- P3: between samples


def test_p3_a_motion_leaves_its_samples_hull_between_them_and_the_curvature_bounds_by_how_much() -> None:
    """A fine grid sees what a coarse one misses; the widening a_max h^2 / 8 covers it (used wherever a limit is at stake)."""
    h, fine = 0.05, 50
    a_max = 3.0
    t = np.linspace(0, h, fine)
    q = 0.5 * a_max * t * (h - t)  # rises and falls between two equal samples
    assert q.max() > max(q[0], q[-1])
    assert q.max() <= max(q[0], q[-1]) + a_max * h**2 / 8 * (1 + 1e-12)
    assert q.max() >= max(q[0], q[-1]) + 0.99 * a_max * h**2 / 8  # and no smaller widening would do


def test_p3_resampling_an_irregular_clock_errs_by_no_more_than_the_curvature_allows() -> None:
    rng = np.random.default_rng(0)
    t = np.cumsum(np.concatenate([[0.0], rng.uniform(0.006, 0.014, 400)]))
    q = np.sin(3.0 * t)[:, None]
    r = Recording("open_loop", 0, 0, 0, t, q, 3.0 * np.cos(3.0 * t)[:, None], np.zeros_like(q))
    g = on_grid(r, 0.01)
    widest = np.diff(t).max()
    error = np.abs(g.q[:, 0] - np.sin(3.0 * g.t))
    assert error.max() <= 9.0 * widest**2 / 8  # |q''| <= 9
    assert error.max() > 0.1 * 9.0 * widest**2 / 8


# ---- P4: time-varying inputs


def test_p4_a_constant_disturbance_does_not_predict_a_changing_one() -> None:
    """A push on joint 2 first moves joint 1, then lets it come back: constant pushes hide what alternating ones do."""
    steps = 500
    R = responses(COUPLED, DT, steps)
    U = Box.of([0.0, -1.0], [0.0, 1.0])
    integral = R.plus + R.minus
    constant_hi = np.abs(integral) @ U.hi
    K = np.array([R.E1[steps - k - 1][0] @ COUPLED.B for k in range(steps)])[:, 1]
    x = simulate(COUPLED, DT, np.zeros(4), np.column_stack([np.zeros(steps), np.sign(K)]))
    R_lo, R_hi = R.hull(np.zeros(4), np.zeros(4), U.lo, U.hi)
    velocity = 2
    Kv = np.array([R.E1[steps - k - 1][velocity] @ COUPLED.B for k in range(steps)])[:, 1]
    y = simulate(COUPLED, DT, np.zeros(4), np.column_stack([np.zeros(steps), np.sign(Kv)]))
    assert y[-1, velocity] > 2 * constant_hi[-1, velocity]  # the constant-v set of Proposition 1 loses it
    for z in (x, y):
        assert np.all(z >= R_lo - ROUNDING)
        assert np.all(z <= R_hi + ROUNDING)


def test_p4_the_time_varying_tube_is_a_semigroup_and_the_constant_one_is_not() -> None:
    """Twice half the age, restarted from the box in between, must cover the whole age."""
    steps = 500
    R = responses(COUPLED, DT, steps)
    U = Box.of([0.0, -1.0], [0.0, 1.0])
    zero = np.zeros(4)
    lo, hi = R.hull(zero, zero, U.lo, U.hi)
    half = steps // 2
    lo2, hi2 = R.hull(lo[half], hi[half], U.lo, U.hi)
    assert np.all(lo2[half] <= lo[steps] + ROUNDING)
    assert np.all(hi2[half] >= hi[steps] - ROUNDING)
    # constant pushes, switched once at half time: the set of constant pushes over the whole age does not hold it
    whole = np.abs((R.plus + R.minus) @ U.hi)
    after = R.E1[half] @ ((R.plus + R.minus)[half] @ -U.hi) + (R.plus + R.minus)[half] @ U.hi
    assert np.abs(after[2]) > whole[steps][2] + 1e-3


# ---- P5: what is identified is the box hull


def test_p5_data_may_sit_in_a_corner_of_the_box_that_the_exact_reachable_set_lacks() -> None:
    steps, age = 50, 50
    U = Box.of([-1.0], [1.0])
    R = responses(SINGLE, DT, steps)
    lo, hi = R.hull(np.zeros(2), np.zeros(2), U.lo, U.hi)
    corner = np.array([hi[age, 0], lo[age, 1]])  # far ahead and at the same time slowest
    direction = np.array([1.0, -0.1])
    K = np.array([direction @ (R.E1[steps - k - 1] @ SINGLE.B) for k in range(steps)])[:, 0]
    exact = float(DT * np.abs(K).sum() * 1.05)  # support of the exact reachable set, generously
    assert direction @ corner > exact
    env = Envelope.empty(DT, steps, 2)
    env.count[:] = 1
    env.labels.append("corner")
    for a in range(steps + 1):
        env.hi[a], env.lo[a] = hi[a], lo[a]
    fit = fit_sets(env, R, problem(SINGLE, ReadingError.exact(Box.symmetric([NO_NOISE] * 2)), DT, env.steps), capped=False)
    assert leaves(fit, R, env) <= 0.0  # conformance accepts it, so nothing smaller than the box may predict


# ---- P6: the torque set directly


def test_p6_going_through_a_state_space_set_and_the_pseudo_inverse_widens_the_torque_set() -> None:
    rng = np.random.default_rng(5)
    steps = 200
    u = np.repeat(rng.uniform(-1, 1, (20, steps // 20, 2)), 20, axis=1)
    trials = []
    for k, w in enumerate(u):
        w = np.repeat(rng.uniform(-1, 1, (10, 2)), 20, axis=0)
        x = simulate(COUPLED, DT, np.zeros(4), w)
        trials.append(recording(x, np.zeros((steps + 1, 2)), DT, k))
    env = envelope(COUPLED, trials)
    R = responses(COUPLED, DT, env.steps)
    direct = fit_sets(
        env, R, problem(COUPLED, ReadingError.exact(Box.symmetric([NO_NOISE] * 4)), DT, env.steps), capped=False
    ).U.width.sum()
    detour = _through_state_space(env, R)
    assert direct <= 4.0 * 1.01  # the truth is [-1, 1] for both
    assert detour > 1.2 * direct


def _through_state_space(env: Envelope, R: Responses) -> float:
    """Equations (19)-(21) and U = B# V, with a state-space set V around zero: the widths of U, summed."""
    ages = slice(1, env.steps + 1)
    m = R.E1.shape[1]
    E1, E2 = np.abs(R.E1[ages]), np.zeros_like(R.E1[ages])
    fine = np.cumsum(np.abs(R.E1), axis=0) * R.dt
    E2[:] = fine[ages]
    rows = np.concatenate([np.concatenate([E1, E2], axis=2)[:, i] for i in range(m)])
    sides = []
    for seen in (env.hi, -env.lo):
        need = np.concatenate([np.maximum(seen[ages, i], 0.0) for i in range(m)])
        sides.append(linprog(rows.sum(axis=0), A_ub=-rows, b_ub=-need, bounds=[(0, None)] * 2 * m).x[m:])
    V = Box(-sides[1], sides[0])
    return float(V.mapped(np.linalg.pinv(COUPLED.B)).width.sum())


# ---- P7: the centre is a finding


def test_p7_a_constant_bias_stays_out_of_the_width() -> None:
    trials = recordings((2.0,), (4.0,), suites=2, trials=6, bias=2.0, spread=0.1, noise=(1e-9, 1e-9))
    env = envelope(SINGLE, trials)
    R = responses(SINGLE, DT, env.steps)
    fit = fit_sets(env, R, problem(SINGLE, ReadingError(Box.symmetric([1e-8] * 2), Box.symmetric([1e-6] * 2)), DT, env.steps))
    assert leaves(fit, R, env) <= 0.0
    assert 1.85 < fit.U.lo[0] < fit.U.hi[0] < 2.15  # zero is not inside
    forced = max(fit.U.hi[0], 0.0) - min(fit.U.lo[0], 0.0)
    assert forced > 10 * fit.U.width[0]


# ---- P8: the motion is the independent unit


def motion(seed: int, N: int = 900) -> np.ndarray:
    return torques(np.random.default_rng(seed), N, 3, 8.0)


def test_p8_repetitions_and_later_starts_of_one_motion_count_once() -> None:
    u = motion(1)
    suites = {("open_loop", 0): u, ("open_loop", 1): u[200:], ("open_loop", 2): u[397:]}
    assert set(independent_motions(suites).values()) == {0}
    assert len(set(independent_motions(suites | {("open_loop", 3): motion(2)}).values())) == 2
    # counting 100 repetitions would promise 3 %; two motions promise nothing
    assert clopper_pearson(0, 100) < 0.03
    assert clopper_pearson(0, 0) == 1.0


@pytest.mark.parametrize("noise", [0.0, 0.1, 0.5])
def test_p8_noise_and_cut_ends_do_not_make_one_motion_several(noise: float) -> None:
    """Measured torques of four starts, each cut at both ends, against twelve motions that really differ."""
    rng = np.random.default_rng(3)

    def measured(u: np.ndarray) -> np.ndarray:
        return u + noise * rng.normal(size=u.shape)

    starts = {("open_loop", k): measured(motion(1)[130 * k : 480 + 137 * k]) for k in range(4)}
    assert set(independent_motions(starts).values()) == {0}
    others = {("open_loop", 10 + k): measured(motion(20 + k, 600)) for k in range(12)}
    found = independent_motions(starts | others)
    assert len(set(found.values())) == 13
    assert list(found.values()) == [0] * 4 + list(range(1, 13))  # numbered as they come
    assert independent_motions({s: u[:, :1] * 0.0 for s, u in starts.items()}) == dict.fromkeys(starts, 0)


@pytest.mark.shared
def test_p8_four_starts_of_two_motions_are_two_motions(shared_data) -> None:
    """Eight suites; all that fits in noise is one motion. Starts of different motions are never taken for one."""
    folder = shared_data("hidden_effect")
    several = 0
    for path in sorted(folder.glob("*/recording.parquet")):
        first: dict[tuple[str, int], np.ndarray] = {}
        for r in stream_recordings(path):
            if r.phase == "open_loop":
                first.setdefault(r.suite_key, r.tau)
        found = independent_motions(first)
        quads = [{found[k] for k in list(found)[i : i + 4]} for i in range(0, len(found), 4)]
        assert not set.intersection(quads[0], quads[1])
        several += len(set(found.values())) > len(quads)
    assert several <= 3  # of 28


def test_p8_the_bound_is_the_one_of_the_textbook() -> None:
    assert clopper_pearson(0, 38) == pytest.approx(0.076, abs=5e-4)
    assert clopper_pearson(0, 299) <= 0.01 < clopper_pearson(0, 298)
    for violated, tried in ((0, 20), (2, 30)):
        p = clopper_pearson(violated, tried)
        assert binom.cdf(violated, tried, p) == pytest.approx(0.05, abs=1e-9)


# ---- P11: units of the cost


def test_p11_radians_and_radians_per_second_are_weighted_not_added() -> None:
    """An hour-based clock must not change what is optimal: a plain sum of rad and rad/s depends on the unit of time."""
    trials = recordings((2.0,), (4.0,), suites=1, trials=5, bias=0.0, spread=0.5)
    env = envelope(SINGLE, trials)
    R = responses(SINGLE, DT, env.steps)
    noise = ReadingError.exact(Box.symmetric([2e-5, 2e-3]))
    block = linear._block(env, R, [0, 1], [0, 1], [0], program.Bounds(noise, 1), dense=True)
    naive = linear._block(env, R, [0, 1], [0, 1], [0], program.Bounds(noise, 1, capped=False), dense=True)
    # columns: X0 lo (q, dq), X0 hi (q, dq), V lo, V hi, U lo, U hi; a velocity counts as its way within a stop
    assert block.cost[7] / block.cost[6] == pytest.approx(STOP_TIME)
    assert naive.cost[7] / naive.cost[6] == pytest.approx(1.0)  # a rad/s as dear as a rad


def test_p11_the_weights_are_in_the_model_file(planar) -> None:
    _, _, found = planar
    cost = found.model.provenance["cost"]
    assert cost["velocity_counts_for_s"] == STOP_TIME


# ---- P12: stiction must not hide in X0


def test_p12_stiction_cannot_hide_in_the_start_speed() -> None:
    """A joint that stays put against a torque of 3 N m before it breaks away."""
    J, v, N = 2.0, 4.0, 300
    trials = []
    for k, hold in enumerate((60, 80, 100)):
        u = np.full((N, 1), 3.0)
        q, dq = np.zeros(N), np.zeros(N)
        q[hold:], dq[hold:] = lag(J, v, DT, 0.0, 0.0, u[hold:, 0])
        trials.append(recording(np.column_stack([q, dq]), u, DT, k))
    noise = ReadingError.exact(Box.symmetric([1e-4, 1e-3]))
    start, sliding = envelope(SINGLE, trials), envelope(SINGLE, trials, "sliding")
    R = responses(SINGLE, DT, sliding.steps)
    for case in ("all", "position"):
        free = fit_sets(start, R, problem(SINGLE, noise, DT, start.steps, case), capped=False)
        assert np.abs([free.X0.lo[1], free.X0.hi[1]]).max() > 0.3  # rad/s at the start of a joint that stood still
        assert free.U.lo[0] > -0.5  # and hardly a trace of the 3 N m that held it
    ours = fit_sets(sliding, R, problem(SINGLE, noise, DT, sliding.steps))
    assert leaves(ours, R, sliding) <= 0.0
    assert ours.U.lo[0] <= -2.9  # the holding torque is where it belongs
    assert np.abs([ours.X0.lo[1], ours.X0.hi[1]]).max() < 0.003
    for fit in (ours, fit_sets(start, R, problem(SINGLE, noise, DT, start.steps))):
        assert fit.V.encloses(Box(-fit.X0.hi, -fit.X0.lo))


# ---- P15: restarts


def alternating() -> list[Recording]:
    """A hidden torque that pushes and then pulls by as much: from the start its effect is soon undone."""
    N = 501
    w = np.where((np.arange(N) // 50) % 2 == 0, 1.0, -1.0)
    w[:25] = 0.0
    q, dq = lag(2.0, 4.0, DT, 0.0, 0.0, w)
    return [recording(np.column_stack([q, dq]), np.zeros((N, 1)))]


def test_p15_conformance_from_the_start_does_not_survive_a_restart() -> None:
    trials = alternating()
    noise = ReadingError.exact(Box.symmetric([1e-7, 1e-6]))
    start, sliding = envelope(SINGLE, trials), envelope(SINGLE, trials, "sliding")
    R = responses(SINGLE, DT, sliding.steps)
    naive = fit_sets(start, R, problem(SINGLE, noise, DT, start.steps))
    ours = fit_sets(sliding, R, problem(SINGLE, noise, DT, sliding.steps))
    assert leaves(naive, R, start) <= 0.0
    assert leaves(naive, R, sliding) > 1e-3
    assert leaves(ours, R, sliding) <= 0.0


def test_p15_the_sliding_envelope_is_the_brute_force_one() -> None:
    """Every start and every age simulated one by one; coupled and decoupled kernels alike."""
    rng = np.random.default_rng(4)
    x, u = rng.normal(size=(40, 4)), rng.normal(size=(40, 2))
    decoupled = Abstraction(1, 1, np.diag([0.5, 1.4]), np.array([[3.0], [8.0]]))
    for a in (COUPLED, decoupled):
        env = envelope(a, [recording(x, u)], "sliding")
        hi, lo = np.full((40, 4), -np.inf), np.full((40, 4), np.inf)
        for s in range(39):
            d = x[s:] - predict(a, DT, x[s], u[s:])
            hi[: len(d)], lo[: len(d)] = np.maximum(hi[: len(d)], d), np.minimum(lo[: len(d)], d)
        assert np.allclose(env.hi[1:], hi[1:], atol=1e-10)
        assert np.allclose(env.lo[1:], lo[1:], atol=1e-10)
        assert env.steps == 39
        assert list(env.count[1:]) == list(range(39, 0, -1))


# ---- P16: what fixes a bound


def test_p16_each_bound_names_the_trial_that_fixes_it_and_moves_without_it() -> None:
    trials = recordings((2.0,), (4.0,), suites=1, trials=5, bias=0.0, spread=0.3, noise=(1e-6, 1e-5))
    q, dq = lag(2.0, 4.0, DT, float(trials[2].q[0, 0]), 0.0, trials[2].tau[:, 0] + 1.5)
    trials[2] = dataclasses.replace(trials[2], q=q[:, None], dq=dq[:, None])
    noise = ReadingError.exact(Box.symmetric([1e-5, 1e-4]))

    def fitted(chosen: list[Recording]) -> FittedSets:
        env = envelope(SINGLE, chosen)
        return fit_sets(env, responses(SINGLE, DT, env.steps), problem(SINGLE, noise, DT, env.steps))

    fit = fitted(trials)
    (upper,) = [a for a in fit.active if a.bound == "U[a].hi"]
    assert upper.recording == "open_loop suite 0 trial 2"
    rest = fitted([r for r in trials if r.trial != 2])
    assert rest.U.hi[0] < fit.U.hi[0] - 0.5
    for k in (0, 1, 3, 4):  # those that are not named may go without a change of this side's push
        assert fitted([r for r in trials if r.trial != k]).U.hi[0] == pytest.approx(fit.U.hi[0], abs=0.2)


# ---- P17: solvers


def test_p17_a_solver_that_calls_a_violation_solved_is_repaired_outward(monkeypatch: pytest.MonkeyPatch) -> None:
    trials = recordings((2.0,), (4.0,), suites=1, trials=4)
    env = envelope(SINGLE, trials)
    R = responses(SINGLE, DT, env.steps)
    exact = linprog

    class Sloppy:
        status, message = 0, "solved"

        def __init__(self, x: np.ndarray) -> None:
            self.x = x

    def sloppy(*args: object, **kwargs: object) -> Sloppy:
        x = np.array(exact(*args, **kwargs).x)
        x[8], x[9] = x[8] + 4e-4, x[9] - 4e-4  # U too small by what a first-order solver was seen to leave
        x[0], x[2] = x[2] + 1e-9, x[0] - 1e-9  # and X0's interval inverted
        return Sloppy(x)

    monkeypatch.setattr("scipy.optimize.linprog", sloppy)
    monkeypatch.setattr(program, "ROUNDS", 3)
    noise = ReadingError.exact(Box.symmetric([2e-5, 2e-3]))
    fit = fit_sets(env, R, problem(SINGLE, noise, DT, env.steps))
    assert leaves(fit, R, env) <= 0.0
    assert _raw(env, R, noise) > 1e-6  # what believing the solver would have left outside


def _raw(env: Envelope, R: Responses, noise: ReadingError) -> float:
    """Worst unmet row of the solver's own answer."""
    bounds = program.Bounds(noise, 1)
    block = linear._block(env, R, [0, 1], [0, 1], [0], bounds, dense=True)
    limits = bounds.rows()
    need = np.concatenate([-block.h, np.zeros(len(limits))])
    z = scipy.optimize.linprog(block.cost, A_ub=np.vstack([-block.G, limits]), b_ub=need, bounds=bounds.limits()).x
    return float((block.h - block.G @ z).max())


# ---- P18: the runtime does what the identification did


def test_p18_the_loaded_model_gives_the_identified_tube_to_the_last_bit(planar, tmp_path) -> None:
    _, _, found = planar
    save_model(found.model, tmp_path / "m.json")
    loaded = load_model(tmp_path / "m.json")
    for name, sets in found.model.sets.items():
        a, b = deviation_tube(found.model.abstraction, sets), deviation_tube(loaded.abstraction, loaded.sets[name])
        assert np.array_equal(a.lo, b.lo)
        assert np.array_equal(a.hi, b.hi)


def test_p18_another_grid_is_another_tube_so_the_grid_is_in_the_file(planar) -> None:
    _, _, found = planar
    sets = found.model.powered
    coarse = dataclasses.replace(sets, dt=2 * sets.dt)
    Ad, _ = discretise(found.model.abstraction, sets.dt)
    Ad2, _ = discretise(found.model.abstraction, coarse.dt)
    assert not np.allclose(Ad, Ad2)
    assert found.model.provenance["settings_sha256"] == settings_sha256(found.settings)
    assert settings_sha256(Settings(windows="start")) != settings_sha256(Settings())


# ---- P24: kind and unit of the effort


def test_p24_current_needs_its_torque_constants(tmp_path) -> None:
    trials, joints = recordings((2.0,), (4.0,), suites=1, trials=2), names(1)
    table = columns(trials, joints)
    table[f"i_{joints[0]}"] = table.pop(f"tau_{joints[0]}") / 2.5
    with pytest.raises(RecordingError, match="torque_constant"):
        read_meta(save(tmp_path / "a.parquet", table, meta(joints, "motor_current")))
    r = read_recordings(save(tmp_path / "b.parquet", table, meta(joints, "motor_current", torque_constant=[2.5])))
    assert np.allclose(r.trials[0].tau, trials[0].tau)  # as amperes they would be 2.5 times too small


def test_p24_an_unstated_effort_is_refused(tmp_path) -> None:
    joints = names(1)
    table = columns(recordings((2.0,), (4.0,), suites=1, trials=1), joints)
    head = meta(joints)
    del head["effort"]
    with pytest.raises(RecordingError, match="effort"):
        read_meta(save(tmp_path / "a.parquet", table, head))
    with pytest.raises(RecordingError, match="effort is 'percent'"):
        read_meta(save(tmp_path / "b.parquet", table, meta(joints, "percent")))
    del table["phase"]
    # columns of torque are in N m by the format's own word; that they are the motors' is assumed, and said
    assert any("taken as motor torque" in w for w in read_meta(save(tmp_path / "c.parquet", table, None)).warnings)
    bare = {k: v for k, v in table.items() if not k.startswith("tau_")}
    with pytest.raises(RecordingError, match=r"no tau_axis_1, and no metadata .*effort"):
        read_meta(save(tmp_path / "d.parquet", bare, None))


def test_p24_compensated_and_motor_torque_are_not_mixed(planar, tmp_path) -> None:
    folder, trials, found = planar
    motor = save_trials(tmp_path / "motor.parquet", trials, names(2), effort="motor_torque")
    with pytest.raises(RecordingError, match="same kind of torque"):
        compare(found.model, [motor])
    with pytest.raises(RecordingError, match="one kind of torque"):
        identify(arm(names(2)), [folder / "rec.parquet", motor])


# ---- P25: domain


def test_p25_outside_what_was_seen_the_answer_is_not_covered(planar, tmp_path) -> None:
    folder, trials, found = planar
    assert compare(found.model, [folder / "rec.parquet"]).outside_domain == 0
    beyond = [dataclasses.replace(r, q=r.q + 2.0) for r in trials]  # another place in the cell: same deviations
    away = compare(found.model, [save_trials(tmp_path / "away.parquet", beyond, names(2))])
    assert not away.violations
    assert away.outside_domain == len(trials)


def test_p25_each_quantity_guards_the_domain() -> None:
    d = Domain(Box.symmetric([1.0]), Box.symmetric([1.0]), Box.symmetric([1.0]), Box.of([20.0], [40.0]))
    inside = np.zeros((1, 1))
    assert d.covers(inside, inside, inside, inside + 30).all()
    for k in range(4):
        x = [inside, inside, inside, inside + 30]
        x[k] = x[k] + 50.0
        assert not d.covers(*x).any()


# ---- P26: derived velocities


def test_p26_a_differentiated_velocity_is_told_apart_and_recorded(tmp_path) -> None:
    joints = names(1)
    trials = recordings((2.0,), (4.0,), suites=2, trials=3, noise=(0.0, 0.0), bias=0.0, spread=0.0)
    derived = [
        dataclasses.replace(r, dq=np.vstack([r.dq[:1], np.diff(r.q, axis=0) / DT])) for r in trials
    ]  # backward difference: half a sample late
    Ad, Bd = discretise(SINGLE, DT)

    def broken(r: Recording) -> float:
        return float(np.abs(step_residual(Ad, Bd, np.hstack([r.q, r.dq]), r.tau)[:, 0]).max())

    assert broken(trials[0]) < 1e-12
    assert broken(derived[0]) > 1e-6
    path = save_trials(tmp_path / "d.parquet", derived, joints, velocity="derived")
    assert read_meta(path).velocity == "derived"
    assert identify(arm(joints), [path]).model.provenance["velocity"] == "derived"


def test_sets_of_another_case_promise_only_what_they_were_fitted_to() -> None:
    """Position-only sets say nothing of velocities: their tube is unbounded there."""
    sets = UncertaintySets(Box.symmetric([1e-4] * 2), Box.symmetric([1.0]), Box.symmetric([1e-4] * 2), DT, 0.4, "position")
    tube = deviation_tube(SINGLE, sets)
    assert np.all(np.isinf(tube.hi[:, 1]))
    assert np.all(np.isfinite(tube.hi[:, 0]))
