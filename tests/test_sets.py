"""Boxes: every sample of a set stays in what is computed from the set."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from plain_sets import contains
from stopset.sets import Box

NUMBERS = st.floats(-1e6, 1e6, allow_subnormal=False)


@st.composite
def boxes(draw: st.DrawFn, d: int = 3) -> Box:
    a, b = draw(arrays(float, d, elements=NUMBERS)), draw(arrays(float, d, elements=NUMBERS))
    return Box(np.minimum(a, b), np.maximum(a, b))


def samples(box: Box, seed: int, count: int = 20) -> np.ndarray:
    rng = np.random.default_rng(seed)
    w = rng.uniform(size=(count, box.dim))
    w[: count // 2] = np.round(w[: count // 2])  # corners too
    return np.clip(box.lo + w * (box.hi - box.lo), box.lo, box.hi)


@settings(max_examples=100, deadline=None)
@given(boxes(), boxes(), st.integers(0, 99))
def test_samples_of_the_parts_are_inside_sum_and_union(a: Box, b: Box, seed: int) -> None:
    x, y = samples(a, seed), samples(b, seed + 1)
    assert contains(a, x)
    assert contains(a + b, x + y)
    assert contains(a | b, np.vstack([x, y]))
    assert (a | b).encloses(a)
    assert Box.hull(x).encloses(Box.hull(x[:3]))
    assert a.encloses(Box.hull(x))


@settings(max_examples=100, deadline=None)
@given(boxes(), arrays(float, (2, 3), elements=NUMBERS), st.integers(0, 99))
def test_the_mapped_box_holds_the_exact_images_of_samples(a: Box, E: np.ndarray, seed: int) -> None:
    """Exact in rational numbers: the outward rounding leaves nothing outside."""
    image = a.mapped(E)
    for x in samples(a, seed, 6):
        for i in range(2):
            exact = sum((Fraction(float(E[i, k])) * Fraction(float(x[k])) for k in range(3)), Fraction(0))
            assert Fraction(float(image.lo[i])) <= exact <= Fraction(float(image.hi[i]))


@settings(max_examples=60, deadline=None)
@given(boxes(), st.floats(1.0, 10.0))
def test_growing_never_shrinks(a: Box, factor: float) -> None:
    assert a.inflated(factor).encloses(a)


def test_signs_decide_the_corner() -> None:
    image = Box.of([0.0, 0.0], [1.0, 2.0]).mapped(np.array([[1.0, -1.0]]))
    assert image.lo[0] == pytest.approx(-2.0)
    assert image.hi[0] == pytest.approx(1.0)  # |E| would say 3


@pytest.mark.parametrize(
    "lo, hi", [([1.0], [0.0]), ([np.nan], [1.0]), ([0.0], [np.nan]), ([0.0, 1.0], [1.0]), ([[0.0]], [[1.0]])]
)
def test_no_empty_box_and_no_nan(lo: list[float], hi: list[float]) -> None:
    with pytest.raises(ValueError, match="box"):
        Box.of(lo, hi)


def test_shape_and_parts() -> None:
    b = Box.of([-1.0, 2.0, 0.0], [1.0, 6.0, 0.0])
    assert b.dim == 3
    np.testing.assert_array_equal(b.centre, [0.0, 4.0, 0.0])
    np.testing.assert_array_equal(b.radius, [1.0, 2.0, 0.0])
    np.testing.assert_array_equal(b.take([1]).hi, [6.0])
    np.testing.assert_array_equal(Box.symmetric([-3.0]).lo, [-3.0])
    assert not contains(b, [0.0, 1.9, 0.0])
    assert not contains(b, [0.0, np.nan, 0.0])
    assert Box.point([1.0]).width[0] == 0.0
