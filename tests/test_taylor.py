"""Taylor forms against independent derivatives: Cauchy's integral on a circle in the complex plane, and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stopset import ring
from stopset.errors import StopsetError
from stopset.ring.taylor import Algebra, Taylor, TaylorError, monomials

CIRCLE = 64  # samples on the circle: exact up to terms of degree 64, which decay as RADIUS^64
RADIUS = 0.2
# a coefficient of degree k comes out of values of order 1 with rounding 1e-16 divided by RADIUS^k, times some
# operations
ROUNDING = 1e-14


def line_coefficients(f, degree: int) -> np.ndarray:
    """Taylor coefficients of ``lambda -> f(lambda)`` at 0 by the discrete Cauchy integral; no differences anywhere."""
    z = RADIUS * np.exp(2j * np.pi * np.arange(CIRCLE) / CIRCLE)
    values = np.array([f(x) for x in z])
    return (np.fft.fft(values, axis=0) / CIRCLE)[: degree + 1].real / RADIUS ** np.arange(degree + 1)


def on_line(form: Taylor, direction: np.ndarray) -> np.ndarray:
    """Coefficients of the form along ``z = lambda * direction``, by degree."""
    terms = form.value * np.prod(direction**form.exponents, axis=1)
    return np.bincount(form.degrees, weights=terms, minlength=form.algebra.order + 1)


def law(x, y, z):
    """Everything a smooth law may use, over any number kind."""
    a = ring.sin(x * y) + ring.cos(z) * ring.exp(y * 0.5)
    return a / (2.0 + ring.square(x)) + ring.sqrt(3.0 + z) * ring.tanh(x - y) - 1.0 / (1.5 - y) + (x + 2.0 * z) ** 3


@pytest.mark.parametrize("order", [1, 3, 5, 7])
def test_every_operation_gives_the_true_derivatives(order: int) -> None:
    at = np.array([0.3, -0.4, 0.2])
    algebra = Algebra(3, order)
    form = law(*(algebra.variable(i, at[i]) for i in range(3)))
    rng = np.random.default_rng(order)
    for _ in range(10):
        direction = rng.uniform(-1, 1, 3)
        want = line_coefficients(lambda x, d=direction: law(*(at + x * d)), order)
        assert np.abs(on_line(form, direction) - want).max() < ROUNDING / RADIUS**order * 100


def test_the_remainder_is_of_one_order_more() -> None:
    at, direction = np.array([0.3, -0.4, 0.2]), np.array([0.6, -0.5, 0.7])
    for order in (1, 3, 5):
        algebra = Algebra(3, order)
        form = law(*(algebra.variable(i, at[i]) for i in range(3)))
        error = [abs(form((h * direction)[None])[0] - law(*(at + h * direction))) for h in (0.1, 0.05)]
        assert 2 ** (order + 0.5) < error[0] / error[1] < 2 ** (order + 1.5)


polynomials = st.lists(st.tuples(st.integers(0, 2), st.integers(0, 2), st.floats(-2, 2)), min_size=1, max_size=6)


def as_form(algebra: Algebra, terms: list[tuple[int, int, float]]) -> Taylor:
    x, y = algebra.variable(0), algebra.variable(1)
    total = algebra.constant(0.0)
    for i, j, c in terms:
        total = total + c * x**i * y**j
    return total


@settings(max_examples=60, deadline=None)
@given(polynomials, polynomials, polynomials)
def test_it_is_a_commutative_ring(a: list, b: list, c: list) -> None:
    algebra = Algebra(2, 12)  # no product of three is cut
    f, g, h = (as_form(algebra, t) for t in (a, b, c))
    z = np.random.default_rng(0).uniform(-1, 1, (5, 2))
    size = 1.0 + sum(abs(t[2]) for t in a) * sum(abs(t[2]) for t in b) * (1 + sum(abs(t[2]) for t in c))
    for left, right in ((f * g, g * f), ((f * g) * h, f * (g * h)), (f * (g + h), f * g + f * h), (f - f, 0.0 * f)):
        assert np.abs(left(z) - right(z)).max() < 1e-13 * size
    assert np.abs((f * g)(z) - f(z) * g(z)).max() < 1e-13 * size


def test_derivative_and_cut() -> None:
    algebra = Algebra(2, 5)
    x, y = algebra.variable(0, 0.5), algebra.variable(1, -0.2)
    form = ring.sin(x) * ring.exp(y)
    lower = Algebra(2, 4)
    want = ring.cos(lower.variable(0, 0.5)) * ring.exp(lower.variable(1, -0.2))
    z = np.array([[0.1, 0.2], [-0.3, 0.1]])
    # the same polynomial of degree 4
    assert np.abs(form.derivative(0)(z) - want(z)).max() < 1e-14
    assert form.cut(2).degrees.max() == 2
    assert np.abs(form.cut(4)(z) - (form(z) - (form - form.cut(4))(z))).max() < 1e-14


def test_a_jump_is_refused_with_a_sentence() -> None:
    x = Algebra(1, 3).variable(0, 1.0)
    for function in (ring.sign, ring.absolute):
        with pytest.raises(TaylorError, match="keep it inside the input u"):
            function(x)
    with pytest.raises(TaylorError, match="kink"):
        ring.maximum(x, 0.0)
    with pytest.raises(TaylorError, match="0 at the expansion point"):
        1.0 / (x - 1.0)
    with pytest.raises(TaylorError, match="expected a positive number"):
        ring.sqrt(x - 2.0)


def test_memory_is_guarded_before_the_work() -> None:
    with pytest.raises(StopsetError, match=r"GiB.*lower the order"):
        Algebra(24, 9, live=36)
    with pytest.raises(StopsetError, match="bits per monomial"):
        Algebra(30, 5)
    assert Algebra(10, 6, live=216).predicted_bytes < 2**30
    assert monomials(24, 5) == 118755
