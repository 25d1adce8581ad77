"""Zonotopes: centre plus generators, each in [-1, 1]; slanted sets for disturbances that come together.

A box says what each joint may suffer; a zonotope also says what the joints do not suffer at once.  Linear maps and
Minkowski sums of zonotopes are zonotopes, exactly, which is why reachable sets of linear systems are made of them.

Source: Kuehn (1998), Rigorously computed orbits of dynamical systems without the wrapping effect.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from stopset.sets.box import Box
from stopset.types import Array


@dataclass(frozen=True, slots=True)
class Zonotope:
    """The set ``{centre + generators @ b : -1 <= b <= 1}``; ``centre``: (d,), ``generators``: (d, m)."""

    centre: Array
    generators: Array

    def __post_init__(self) -> None:
        if self.centre.ndim != 1 or self.generators.ndim != 2 or len(self.generators) != len(self.centre):
            raise ValueError(
                f"zonotope of centre {self.centre.shape} and generators {self.generators.shape}; expected (d,) and (d, m)"
            )
        if not (np.all(np.isfinite(self.centre)) and np.all(np.isfinite(self.generators))):
            raise ValueError("zonotope with a centre or generator that is not finite; expected numbers")

    @property
    def dim(self) -> int:
        return int(self.centre.shape[0])

    def support(self, direction: ArrayLike) -> Array:
        """``max l'x`` over the set for each row ``l`` of ``direction`` (..., d), rounded outward."""
        L = np.asarray(direction, float)
        size = np.abs(L @ self.generators).sum(axis=-1)
        reach = np.abs(L) @ np.abs(self.centre) + np.abs(L) @ np.abs(self.generators).sum(axis=1)
        # d products and d + m sums of rounding 2^-53 each
        return np.asarray(L @ self.centre + size + 2.0**-52 * (2 * self.dim + self.generators.shape[1]) * reach)

    def width(self, direction: ArrayLike) -> Array:
        """``max l'x - min l'x`` for each row ``l`` of ``direction`` (..., d)."""
        return np.asarray(2.0 * np.abs(np.asarray(direction, float) @ self.generators).sum(axis=-1))

    @property
    def box(self) -> Box:
        """Smallest box around it, rounded outward."""
        axes = np.eye(self.dim)
        return Box(-self.support(-axes), self.support(axes))

    def mapped(self, E: Array) -> Zonotope:
        """``{E x}`` for a matrix ``E`` (k, d)."""
        return Zonotope(E @ self.centre, E @ self.generators)

    def __add__(self, other: Zonotope) -> Zonotope:
        """Minkowski sum."""
        return Zonotope(self.centre + other.centre, np.hstack([self.generators, other.generators]))

    def inflated(self, factor: float) -> Zonotope:
        """Grown about its centre by ``factor`` (>= 1)."""
        return Zonotope(self.centre, max(1.0, factor) * self.generators)
