"""Fewer points in a picture hide no extreme: what is drawn contains what was there."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from stopset.offline.report.thin import extremes, hulls, spread

SIZES = st.integers(1, 700)
POINTS = st.integers(4, 90)


@settings(max_examples=60, deadline=None)
@given(SIZES, POINTS, st.integers(0, 2**32 - 1))
def test_the_greatest_and_the_least_are_drawn(n: int, points: int, seed: int) -> None:
    y = np.random.default_rng(seed).standard_cauchy(n)  # spikes
    rows = extremes(y, points)
    assert len(rows) <= max(points, 4) and np.all(np.diff(rows) > 0)
    assert {0, n - 1, int(np.argmax(y)), int(np.argmin(y))} <= set(rows.tolist())


@settings(max_examples=60, deadline=None)
@given(SIZES, POINTS, st.integers(0, 2**32 - 1))
def test_a_thinned_band_contains_the_whole_band(n: int, points: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    middle = np.cumsum(rng.normal(size=n))
    lo, hi = middle - rng.exponential(size=n), middle + rng.exponential(size=n)
    at, low, high = hulls(lo, hi, points)
    assert len(at) <= max(points, 2)
    everywhere = np.arange(n)
    assert np.all(np.interp(everywhere, at, low) <= lo + 1e-9) and np.all(np.interp(everywhere, at, high) >= hi - 1e-9)


@settings(max_examples=40, deadline=None)
@given(SIZES, st.integers(8, 90), st.integers(0, 2**32 - 1))
def test_a_thinned_cloud_keeps_its_corners(n: int, points: int, seed: int) -> None:
    x, y = np.random.default_rng(seed).normal(size=(2, n))
    rows = spread(x, y, points)
    assert len(rows) <= max(points, 1)
    for v in (x, y):
        assert v[rows].min() == v.min() and v[rows].max() == v.max()
