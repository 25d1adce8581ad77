"""Boxes (multidimensional intervals): the sets the paper identifies, with outward rounding where numbers are made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from stopset.types import Array


@dataclass(frozen=True, slots=True)
class Box:
    """The set ``{x : lo <= x <= hi}``; ``lo``, ``hi``: (d,). The origin need not be inside (trap P7)."""

    lo: Array
    hi: Array

    def __post_init__(self) -> None:
        if self.lo.shape != self.hi.shape or self.lo.ndim != 1:
            raise ValueError(f"box bounds have shapes {self.lo.shape} and {self.hi.shape}; expected one (d,) each")
        if not np.all(self.lo <= self.hi):
            k = int(np.argmax(~(self.lo <= self.hi)))
            raise ValueError(f"box is empty or not a number in dimension {k}: [{self.lo[k]}, {self.hi[k]}]")

    @classmethod
    def of(cls, lo: ArrayLike, hi: ArrayLike) -> Box:
        return cls(np.array(lo, float), np.array(hi, float))

    @classmethod
    def point(cls, x: ArrayLike) -> Box:
        return cls.of(x, x)

    @classmethod
    def symmetric(cls, radius: ArrayLike) -> Box:
        r = np.abs(np.array(radius, float))
        return cls(-r, r)

    @classmethod
    def hull(cls, points: ArrayLike) -> Box:
        """Smallest box around ``points`` (N, d)."""
        x = np.asarray(points, float)
        return cls(x.min(axis=0), x.max(axis=0))

    @property
    def dim(self) -> int:
        return int(self.lo.shape[0])

    @property
    def width(self) -> Array:
        return self.hi - self.lo

    @property
    def centre(self) -> Array:
        return 0.5 * (self.lo + self.hi)

    @property
    def radius(self) -> Array:
        return 0.5 * (self.hi - self.lo)

    def encloses(self, other: Box) -> bool:
        return bool(np.all(self.lo <= other.lo) and np.all(other.hi <= self.hi))

    def __or__(self, other: Box) -> Box:
        """Hull of the union."""
        return Box(np.minimum(self.lo, other.lo), np.maximum(self.hi, other.hi))

    def __add__(self, other: Box) -> Box:
        """Minkowski sum, rounded outward."""
        return Box(np.nextafter(self.lo + other.lo, -np.inf), np.nextafter(self.hi + other.hi, np.inf))

    def inflated(self, factor: float | Array) -> Box:
        """Grown about its centre by ``factor`` (>= 1; one or one per dimension), never smaller than before."""
        c, r = self.centre, self.radius
        return Box(np.minimum(self.lo, c - factor * r), np.maximum(self.hi, c + factor * r))

    def take(self, index: Sequence[int] | slice) -> Box:
        """The box in some of its dimensions."""
        return Box(self.lo[index], self.hi[index])

    def mapped(self, E: Array) -> Box:
        """Box hull of ``{E x}`` for a matrix ``E`` (m, d), rounded outward (trap P1: signs of ``E`` decide the corner)."""
        pos, neg = np.maximum(E, 0.0), np.minimum(E, 0.0)
        lo, hi = pos @ self.lo + neg @ self.hi, pos @ self.hi + neg @ self.lo
        # d products and sums of rounding 2^-53 each, and products that vanish below the smallest normal number
        slack = 2.0**-52 * (self.dim + 1) * (np.abs(E) @ np.maximum(np.abs(self.lo), np.abs(self.hi)))
        slack += (self.dim + 1) * np.finfo(np.float64).tiny
        return Box(lo - slack, hi + slack)
