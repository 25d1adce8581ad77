"""Fewer points for a picture, with every extreme kept: what a drawing leaves out must not be what matters."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from stopset.types import Array, Index


def extremes(y: Array, points: int) -> Index:
    """Indices in order, at most ``points``: of every stretch of ``y`` (N,) its least and its largest value, and both ends."""
    n = len(y)
    if n <= max(points, 4):
        return np.arange(n)
    edges = np.linspace(0, n, max(1, (points - 2) // 2) + 1).astype(int)
    stretches = [(a, b) for a, b in pairwise(edges) if b > a]
    rows = [a + f(y[a:b]) for a, b in stretches for f in (np.argmin, np.argmax)]
    return np.unique([0, n - 1, *rows])


def hulls(lo: Array, hi: Array, points: int) -> tuple[Index, Array, Array]:
    """A band (N,) of at most ``points`` places that contains the whole band: indices, lower and upper edge there.

    Between two kept places a straight line is drawn, so each takes the extremes of its stretches on both sides.
    """
    n = len(lo)
    if n <= max(points, 2):
        return np.arange(n), lo, hi
    at = np.linspace(0, n - 1, points).astype(int)
    spans = [slice(at[max(k - 1, 0)], at[min(k + 1, points - 1)] + 1) for k in range(points)]
    return at, np.array([lo[s].min() for s in spans]), np.array([hi[s].max() for s in spans])


def spread(x: Array, y: Array, points: int) -> Index:
    """Indices of at most ``points`` dots of a cloud (N,): evenly taken, the extremes in both directions among them."""
    n = len(x)
    if n <= points:
        return np.arange(n)
    ends = [f(v) for v in (x, y) for f in (np.argmin, np.argmax)]
    return np.unique([*ends, *np.linspace(0, n - 1, points - len(ends)).astype(int)])
