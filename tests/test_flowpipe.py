"""The linear flowpipe: exact where it says so, an upper bound elsewhere, and tight enough to be of use."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad_vec
from scipy.linalg import expm as scipy_expm

from stopset.artifact import Abstraction, UncertaintySets
from stopset.errors import NotCovered
from stopset.reach.flowpipe import along_joints, between_samples, deviation_tube, discretise, expm, responses
from stopset.reach.predict import predict
from stopset.sets import Box
from synthetic import lag


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(1e-3, 30.0))
def test_matrix_exponential(seed: int, size: float) -> None:
    X = size * np.random.default_rng(seed).normal(size=(4, 4)) / 2
    exact = scipy_expm(X)
    # squaring k times amplifies rounding by about 2^k, k = log2 |X|
    assert np.abs(expm(X) - exact).max() <= 1e-12 * (1 + size) * max(1.0, np.abs(scipy_expm(np.abs(X))).max())


def test_exponential_of_zero() -> None:
    np.testing.assert_array_equal(expm(np.zeros((3, 3))), np.eye(3))


DIAGONAL = Abstraction(1, 1, np.diag([0.5, 2.0]), np.array([[4.0], [9.0]]))
COUPLED = Abstraction(1, 1, np.linalg.inv(np.array([[2.0, 0.8], [0.8, 1.0]])), np.array([[3.0], [8.0]]))
FREE = Abstraction(1, 1, np.diag([0.5]), np.array([[0.0]]))  # no damping at all


def test_discretisation_is_the_lags_own_solution() -> None:
    dt = 0.004
    rng = np.random.default_rng(0)
    u = rng.normal(size=(200, 2))
    x = predict(DIAGONAL, dt, np.array([0.1, -0.2, 0.3, 0.4]), u)
    for j, (J, v) in enumerate(((2.0, 4.0), (0.5, 9.0))):
        q, dq = lag(J, v, dt, (0.1, -0.2)[j], (0.3, 0.4)[j], u[:, j])
        np.testing.assert_allclose(x[:, j], q, atol=1e-13)
        np.testing.assert_allclose(x[:, 2 + j], dq, atol=1e-13)


def test_without_damping_it_is_a_double_integrator() -> None:
    Ad, Bd = discretise(FREE, 0.1)
    np.testing.assert_allclose(Ad, [[1.0, 0.1], [0.0, 1.0]], atol=1e-15)
    np.testing.assert_allclose(Bd[:, 0], [0.0025, 0.05], atol=1e-15)


@pytest.mark.parametrize("a", [DIAGONAL, COUPLED, FREE])
def test_integrals_of_both_signs_are_bounded_from_the_safe_side(a: Abstraction) -> None:
    dt, steps = 0.02, 80
    R = responses(a, dt, steps)

    def K(s: float) -> np.ndarray:
        return scipy_expm(a.A * s) @ a.B

    for k in (1, 7, steps):
        plus = sum(quad_vec(lambda s: np.maximum(K(s), 0.0), i * dt, (i + 1) * dt, epsabs=1e-12)[0] for i in range(k))
        minus = sum(quad_vec(lambda s: np.minimum(K(s), 0.0), i * dt, (i + 1) * dt, epsabs=1e-12)[0] for i in range(k))
        room = 1e-10
        assert np.all(R.plus[k] >= plus - room)
        assert np.all(R.minus[k] <= minus + room)
        # exact for decoupled joints; else wider only by what happens within the steps where the sign changes
        loose = room if a.decoupled else 0.05 * (np.abs(plus) + np.abs(minus)).max()
        assert np.all(R.plus[k] <= plus + loose)
        np.testing.assert_allclose(R.plus[k] + R.minus[k], plus + minus, atol=1e-10)
        np.testing.assert_allclose(R.E1[k], scipy_expm(a.A * dt * k), atol=1e-12)


def test_a_finer_grid_tightens_the_bound_and_never_crosses_the_truth() -> None:
    ends = []
    for dt in (0.04, 0.02, 0.01, 0.005):
        R = responses(COUPLED, dt, round(1.6 / dt))
        ends.append((R.plus[-1] - R.minus[-1]).sum())
    assert all(b <= a + 1e-12 for a, b in pairwise(ends))


def test_the_tube_starts_at_the_noise_of_two_readings() -> None:
    sets = UncertaintySets(Box.symmetric([1e-3] * 4), Box.symmetric([1.0] * 2), Box.symmetric([2e-3] * 4), 0.01, 0.5)
    tube = deviation_tube(DIAGONAL, sets)
    assert len(tube.ages) == 51
    assert tube.ages[-1] == pytest.approx(0.5)
    np.testing.assert_allclose(tube.hi[0], 3e-3, rtol=1e-12)
    assert np.all(np.diff(tube.hi[:, :2], axis=0) > 0)  # positions drift apart
    assert np.all(tube.hi >= -tube.lo - 1e-15)


def test_predictions_advance_one_sample_at_a_time() -> None:
    """Off by one here would shift every measurement against its prediction: u[k] acts from sample k to k + 1."""
    dt = 0.01
    u = np.zeros((4, 2))
    u[2, 0] = 1.0
    x = predict(DIAGONAL, dt, np.zeros(4), u)
    assert not x[:3].any()
    assert x[3, 2] > 0


def test_nonlinear_models_are_refused() -> None:
    cubic = Abstraction(1, 3, np.diag([0.5]), np.array([[4.0, 0.0, 0.1]]))
    with pytest.raises(NotCovered, match="order 3"):
        responses(cubic, 0.01, 10)


def between(a: Abstraction, dt: float, x0: np.ndarray, u: np.ndarray, parts: int = 40) -> np.ndarray:
    """States at ``parts`` instants within each step, (N, parts, 2n), by a fine simulation of the same held inputs."""
    fine = predict(a, dt / parts, x0, np.vstack([np.repeat(u, parts, axis=0), u[-1:]]))
    return np.stack([fine[k * parts : (k + 1) * parts + 1] for k in range(len(u))])


@pytest.mark.parametrize("a", [DIAGONAL, COUPLED, FREE])
def test_p3_states_between_samples_leave_the_samples_hull_but_not_the_widened_one(a: Abstraction) -> None:
    """Trap P3: motions turn round between samples; torques may change there too, as fast as they like."""
    dt, n, rng = 0.05, a.n, np.random.default_rng(3)
    escaped = False
    for _ in range(30):
        # torques that jump five times as often as samples are taken
        u = rng.uniform(-20.0, 20.0, (100, n))
        inside = between(a, dt / 5, rng.normal(size=2 * n), u, 8)
        x = np.vstack([inside[::5, 0], inside[-1:, -1]])  # every fifth instant is a sample
        inside = inside.reshape(20, -1, 2 * n)
        lo, hi = between_samples(a, dt, x, x, Box.symmetric([20.0] * n))
        assert np.all(inside >= lo[:, None]) and np.all(inside <= hi[:, None])
        naive_hi = np.maximum(x[:-1], x[1:])
        escaped |= bool(np.any(inside[:, :, :n] > naive_hi[:, None, :n] + 1e-4))
    assert escaped, "the hull of both samples would have done"


def test_p3_the_widening_is_no_larger_than_it_must_be() -> None:
    """Without damping a throw up and down within one step goes up by exactly ``a h^2 / 8``."""
    h, push = 0.1, 3.0  # FREE: 0.5 / kg, so 1.5 rad/s^2
    x0 = np.array([0.0, 0.5 * 0.5 * push * h])
    inside = between(FREE, h, x0, np.array([[-push]]))[0]
    x = inside[[0, -1]]
    _, hi = between_samples(FREE, h, x, x, Box.symmetric([push]))
    assert x[1, 0] == pytest.approx(0.0, abs=1e-12)
    assert inside[:, 0].max() == pytest.approx(0.5 * push * h**2 / 8, rel=1e-9)
    assert inside[:, 0].max() <= hi[0, 0] <= inside[:, 0].max() * (1 + 1e-9)


def test_tubes_across_joints_are_those_of_the_same_inputs() -> None:
    """Along a direction, and with inputs along other torques: brute force over corners that change at every step."""
    L, G, steps, dt = np.array([[0.6, -0.8]]), np.array([[1.0, 0.3], [0.5, -0.2]]), 30, 0.01
    R = responses(COUPLED, dt, steps, G, along_joints(L))
    U = Box.of([-1.0, -0.5], [2.0, 0.5])
    lo, hi = R.tube(Box.point(np.zeros(4)), U, Box.point(np.zeros(4)))
    Ad, Bd = discretise(COUPLED, dt)
    best = np.zeros((2, 2))  # greatest and least position and speed along L after all steps, input by input and step by step
    for row in range(2):
        l = along_joints(L)[row]  # noqa: E741
        for k in range(steps):
            gain = l @ np.linalg.matrix_power(Ad, steps - 1 - k) @ Bd @ G
            best[0, row] += np.maximum(gain * U.lo, gain * U.hi).sum()
            best[1, row] += np.minimum(gain * U.lo, gain * U.hi).sum()
    assert np.all(hi[-1] >= best[0] - 1e-12) and np.all(lo[-1] <= best[1] + 1e-12)
    # torques may change within a step too: a little wider, not much
    np.testing.assert_allclose(hi[-1] - lo[-1], best[0] - best[1], rtol=0.05)
