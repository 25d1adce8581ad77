"""Fewer points for a picture, with every extreme kept: what a drawing leaves out must not be what matters."""

from __future__ import annotations

import numpy as np

from stopset.types import Array, Index


def extremes(y: Array, points: int) -> Index:
    """Indices in order, at most ``points``: of every stretch of ``y`` (N,) its least and its largest value, and both ends."""
    n = len(y)
    if n <= max(points, 4):
        return np.arange(n)
    edges = np.linspace(0, n, max(1, (points - 2) // 2) + 1).astype(int)
    longest = np.diff(edges).max()
    rows = np.minimum(edges[:-1, None] + np.arange(longest), edges[1:, None] - 1)  # a shorter stretch repeats its last
    values, each = y[rows], np.arange(len(rows))
    return np.unique([0, n - 1, *rows[each, values.argmin(axis=1)], *rows[each, values.argmax(axis=1)]])


def hulls(lo: Array, hi: Array, points: int) -> tuple[Index, Array, Array]:
    """A band (N,) of at most ``points`` places that contains the whole band: indices, lower and upper edge there.

    Between two kept places a straight line is drawn, so each takes the extremes of its stretches on both sides.
    """
    n = len(lo)
    if n <= max(points, 2):
        return np.arange(n), lo, hi
    at = np.linspace(0, n - 1, points).astype(int)

    def within(edge: Array, most: np.ufunc) -> Array:
        stretches = most(most.reduceat(edge, at[:-1]), edge[at[1:]])  # both of its ends belong to a stretch
        return np.asarray(most(stretches[[0, *range(points - 1)]], stretches[[*range(points - 1), -1]]))

    return at, within(lo, np.minimum), within(hi, np.maximum)


def spread(x: Array, y: Array, points: int) -> Index:
    """Indices of at most ``points`` dots of a cloud (N,): evenly taken, the extremes in both directions among them."""
    n = len(x)
    if n <= points:
        return np.arange(n)
    ends = [f(v) for v in (x, y) for f in (np.argmin, np.argmax)]
    return np.unique([*ends, *np.linspace(0, n - 1, points - len(ends)).astype(int)])
