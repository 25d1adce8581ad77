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
from stopset.reach.flowpipe import deviation_tube, discretise, expm, predict, responses
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
