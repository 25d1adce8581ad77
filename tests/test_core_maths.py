"""The core's elementary functions against 70-digit arithmetic, in units in the last place, and their edges."""

from __future__ import annotations

import math
from collections.abc import Callable
from decimal import Decimal, localcontext

import numpy as np
import pytest

from core_calls import maths
from stopset.types import Array

PI = Decimal("3.14159265358979323846264338327950288419716939937510582097494459230781640628620899862803482534211706798214808651")
DIGITS = 70
RNG = np.random.default_rng(7)


def _series(x: Decimal, first: int) -> Decimal:
    """``x^first/first! - x^(first+2)/(first+2)! + ...``"""
    term = x**first / math.factorial(first)
    total, k = term, first
    while abs(term) > Decimal(10) ** -(DIGITS + 5):
        k += 2
        term = -term * x * x / (k * (k - 1))
        total += term
    return total


def _sin(x: Decimal) -> Decimal:
    return _series(x - (x / (2 * PI)).to_integral_value() * 2 * PI, 1)


def _cos(x: Decimal) -> Decimal:
    return _series(x - (x / (2 * PI)).to_integral_value() * 2 * PI, 0)


def _expm1(x: Decimal) -> Decimal:
    return x.exp() - 1


def _tanh(x: Decimal) -> Decimal:
    return 1 - 2 / ((2 * x).exp() + 1)


def spread(lo: float, hi: float) -> Array:
    """Numbers of both signs whose sizes are spread over many decades."""
    x = np.exp(RNG.uniform(math.log(lo), math.log(hi), 1500))
    return np.concatenate([x, -x])


near_quarter_turns = np.array([float(int(k) * PI / 2) for k in RNG.integers(-600_000, 600_000, 1500)])
CASES: list[tuple[str, Callable[[Decimal], Decimal], Array, float]] = [
    ("sin", _sin, np.concatenate([spread(1e-9, 1e6), spread(0.1, 10.0), near_quarter_turns]), 0.75),
    ("cos", _cos, np.concatenate([spread(1e-9, 1e6), spread(0.1, 10.0), near_quarter_turns]), 0.75),
    ("exp", Decimal.exp, np.concatenate([spread(1e-9, 700.0), spread(0.05, 5.0)]), 0.8),
    ("expm1", _expm1, np.concatenate([spread(1e-9, 700.0), spread(0.05, 5.0)]), 1.5),
    ("tanh", _tanh, np.concatenate([spread(1e-9, 30.0), spread(0.05, 5.0)]), 2.0),
    ("log", Decimal.ln, np.concatenate([np.abs(spread(1e-300, 1e300)), np.abs(spread(0.5, 2.0))]), 1.0),
]  # fmt: skip


@pytest.mark.parametrize(("name", "exact", "x", "ulp"), CASES, ids=[c[0] for c in CASES])
def test_error_is_what_the_header_says(name: str, exact: Callable[[Decimal], Decimal], x: Array, ulp: float) -> None:
    got = maths(name, x)
    with localcontext() as context:
        context.prec = DIGITS + 30
        errors = [
            float(abs(Decimal(y) - (true := exact(Decimal(v)))) / Decimal(math.ulp(float(true))))
            for v, y in zip(x.tolist(), got.tolist(), strict=True)
        ]
    assert max(errors) <= ulp, (name, max(errors), x[int(np.argmax(errors))])


def test_edges() -> None:
    inf, nan = math.inf, math.nan
    for name, x, want in (
        ("sin", [0.0, -0.0, 1e-300], [0.0, -0.0, 1e-300]), ("cos", [0.0, -0.0], [1.0, 1.0]),
        ("sin", [1.1e6, inf, nan], [nan, nan, nan]), ("cos", [-1.1e6, -inf, nan], [nan, nan, nan]),
        ("exp", [0.0, 710.0, inf, -746.0, -inf, nan], [1.0, inf, inf, 0.0, 0.0, nan]),
        ("exp", [-745.0, -740.0, 709.7], [math.exp(-745.0), math.exp(-740.0), math.exp(709.7)]),
        ("expm1", [0.0, -0.0, 1e-300, 710.0, inf, -50.0, -inf, nan], [0.0, -0.0, 1e-300, inf, inf, -1.0, -1.0, nan]),
        ("tanh", [0.0, -0.0, 1e-300, 50.0, -50.0, inf, -inf, nan], [0.0, -0.0, 1e-300, 1.0, -1.0, 1.0, -1.0, nan]),
        ("log", [1.0, 0.0, -1.0, inf, nan, 5e-324], [0.0, -inf, nan, inf, nan, math.log(5e-324)]),
    ):  # fmt: skip
        got = maths(name, np.array(x))
        for g, w in zip(got.tolist(), want, strict=True):
            assert (math.isnan(g) and math.isnan(w)) or (
                g == pytest.approx(w, rel=1e-15) and math.copysign(1, g) == math.copysign(1, w)
            ), (name, x)


def test_odd_functions_are_odd_to_the_last_bit() -> None:
    x = np.abs(spread(1e-9, 1e3))
    for name in ("sin", "tanh"):
        assert np.array_equal(maths(name, -x), -maths(name, x))
    assert np.array_equal(maths("cos", -x), maths("cos", x))


def test_the_bits_are_the_same_on_every_machine() -> None:
    """A hash of many results, made once: a compiler, a flag or a platform that changes one bit changes it."""
    import hashlib

    x = np.random.default_rng(1).uniform(-20.0, 20.0, 20000)
    h = hashlib.sha256()
    for name in ("sin", "cos", "exp", "expm1", "tanh"):
        h.update(maths(name, x).tobytes())
    h.update(maths("log", np.abs(x)).tobytes())
    assert h.hexdigest()[:16] == "086b907bd9270716"
