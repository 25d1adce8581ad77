"""What holds what, by all facets or by sampling: slow answers that the product's are held against."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike

from stopset.artifact import Abstraction, UncertaintySets
from stopset.offline.conform.nonlinear import along, nominal
from stopset.sets import Box, Zonotope
from stopset.types import Array


def contains(it: Box | Zonotope, x: ArrayLike) -> bool:
    """Whether every row of ``x`` (d,) or (N, d) lies inside; of a zonotope without interior: False."""
    if isinstance(it, Box):
        y = np.asarray(x, float)
        return bool(np.all((it.lo <= y) & (y <= it.hi)))
    y = np.atleast_2d(np.asarray(x, float)) - it.centre
    if np.linalg.matrix_rank(it.generators) < it.dim:
        return False
    normals = np.array(list(facets(it)))
    return bool(np.all(np.abs(y @ normals.T) <= it.width(normals) / 2.0 + 2.0**-45 * np.abs(it.generators).sum()))


def facets(it: Zonotope) -> Iterator[Array]:
    """Unit normals (d,) of all facets (both signs follow by symmetry); d - 1 generators span each."""
    d, m = it.generators.shape
    if d == 1:
        yield np.ones(1)
        return
    for k in combinations(range(m), d - 1):
        spanned = it.generators[:, k]
        normal = np.array([(-1.0) ** i * np.linalg.det(np.delete(spanned, i, axis=0)) for i in range(d)])
        length = float(np.linalg.norm(normal))
        if length > 1e-12 * float(np.prod(np.linalg.norm(spanned, axis=0))) and length > 0.0:
            yield normal / length


def of_box(box: Box) -> Zonotope:
    """A box as a zonotope, one generator per axis."""
    return Zonotope(box.centre, np.diag(box.radius))


def volume(it: Zonotope) -> float:
    """Volume; one determinant per choice of d generators.."""
    d, m = it.generators.shape
    return float(2.0**d * sum(abs(np.linalg.det(it.generators[:, k])) for k in map(list, combinations(range(m), d))))


def boxed(sets: UncertaintySets) -> UncertaintySets:
    """The same with the box around the torque set: coarser, never narrower."""
    return sets if sets.zonotope is None else replace(sets, zonotope=None)


def leak(abstraction: Abstraction, sets: UncertaintySets, x0: Array, u: Array, samples: int = 64, seed: int = 0) -> float:
    """How far solutions of the *nonlinear* model leave the linearised hull, relative to its half-width: 0 if none does.

    Solutions start at corners of ``x0 + X0`` and are driven by ``u + U`` at random corners of U, held for random times;
    ``u``: (N, n).  What the linearisation neglects, in numbers; a lower bound of the worst case, as all sampling.
    """
    n = abstraction.n
    rng = np.random.default_rng(seed)
    path = nominal(abstraction, x0[None], u[None], sets.dt)[0]
    lo, hi = along(abstraction, path, u, sets.dt).hull(sets.X0.lo, sets.X0.hi, sets.U.lo, sets.U.hi)
    pick = rng.integers(0, 2, (samples, 2 * n))
    begin = x0 + np.where(pick, sets.X0.hi, sets.X0.lo)
    hold = rng.integers(1, len(u) + 1, samples)
    torque = np.empty((samples, len(u), n))
    for k in range(samples):
        corners = rng.integers(0, 2, (len(u) // hold[k] + 1, n))
        torque[k] = u + np.where(corners, sets.U.hi, sets.U.lo).repeat(hold[k], axis=0)[: len(u)]
    d = nominal(abstraction, begin, torque, sets.dt) - path
    half = np.maximum(0.5 * (hi - lo), 1e-12)[1:]
    beyond = np.maximum(d[:, 1:] - hi[1:], lo[1:] - d[:, 1:]) / half
    return float(max(0.0, beyond.max()))
