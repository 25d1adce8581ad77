"""Intervals: what a law can give while its arguments move in a box.

Every operation rounds outward by one unit in the last place (elementary functions by four, numpy's stated accuracy),
so the
true range over real numbers is inside.  Arrays of intervals are one Interval with array bounds.

Source: Moore, Kearfott & Cloud, Introduction to Interval Analysis (2009), ch. 2-5.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from stopset.types import Array

_ULPS = 4  # numpy documents <= 4 ulp for exp, sin, cos, tanh in double precision
_TWO_PI = 2 * np.pi


def _out(lo: Any, hi: Any, ulps: int = 1) -> Interval:
    for _ in range(ulps):
        lo, hi = np.nextafter(lo, -np.inf), np.nextafter(hi, np.inf)
    return Interval(lo, hi)


def _pair(x: Any) -> tuple[Array, Array]:
    if isinstance(x, Interval):
        return x.lo, x.hi
    v = np.asarray(x, float)
    return v, v


@dataclass(frozen=True, slots=True, eq=False)
class Interval:
    """All numbers from ``lo`` to ``hi`` (arrays of one shape)."""

    lo: Array
    hi: Array
    __array_ufunc__ = None  # numpy arrays hand over to the operators below

    def __post_init__(self) -> None:
        lo, hi = np.asarray(self.lo, float), np.asarray(self.hi, float)
        if not (lo <= hi).all():
            raise ValueError(f"interval with lower bound {lo} above upper bound {hi}; expected lo <= hi")
        object.__setattr__(self, "lo", lo)
        object.__setattr__(self, "hi", hi)

    def __contains__(self, x: Any) -> bool:
        return bool(np.all((self.lo <= x) & (x <= self.hi)))

    @property
    def mid(self) -> Array:
        """Centre."""
        return 0.5 * (self.lo + self.hi)

    @property
    def width(self) -> Array:
        """``hi - lo``."""
        return self.hi - self.lo

    def __neg__(self) -> Interval:
        return Interval(-self.hi, -self.lo)

    def __add__(self, other: Any) -> Interval:
        lo, hi = _pair(other)
        return _out(self.lo + lo, self.hi + hi)

    def __sub__(self, other: Any) -> Interval:
        lo, hi = _pair(other)
        return _out(self.lo - hi, self.hi - lo)

    def __rsub__(self, other: Any) -> Interval:
        lo, hi = _pair(other)
        return _out(lo - self.hi, hi - self.lo)

    def __mul__(self, other: Any) -> Interval:
        lo, hi = _pair(other)
        a, b, c, d = self.lo * lo, self.lo * hi, self.hi * lo, self.hi * hi
        return _out(np.minimum(np.minimum(a, b), np.minimum(c, d)), np.maximum(np.maximum(a, b), np.maximum(c, d)))

    __radd__ = __add__
    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Interval:
        lo, hi = _pair(other)
        if np.any((lo <= 0) & (hi >= 0)):
            raise ZeroDivisionError(f"division by the interval [{lo}, {hi}], which holds 0; bound it away from 0")
        return self * _out(1.0 / hi, 1.0 / lo)

    def __rtruediv__(self, other: Any) -> Interval:
        lo, hi = _pair(other)
        return Interval(lo, hi) / self

    def __pow__(self, n: int) -> Interval:
        if not isinstance(n, int) or n < 0:
            raise ValueError(f"power {n!r} of an interval; expected an integer >= 0")
        if n == 0:
            return Interval(np.ones_like(self.lo), np.ones_like(self.hi))
        if n % 2:
            return _out(self.lo**n, self.hi**n, n)
        a, b = np.abs(self.lo), np.abs(self.hi)
        low = np.where((self.lo <= 0) & (self.hi >= 0), 0.0, np.minimum(a, b) ** n)
        out = _out(low, np.maximum(a, b) ** n, n)
        return Interval(np.maximum(out.lo, 0.0), out.hi)

    def square(self) -> Interval:
        """Of one and the same number, so never negative."""
        return self**2

    def absolute(self) -> Interval:
        """Magnitude."""
        a, b = np.abs(self.lo), np.abs(self.hi)
        return Interval(np.where((self.lo <= 0) & (self.hi >= 0), 0.0, np.minimum(a, b)), np.maximum(a, b))

    def sign(self) -> Interval:
        """Direction; an interval that reaches 0 takes in all friction directions, [-1, 1] (Filippov)."""
        return Interval(np.where(self.lo > 0, 1.0, -1.0), np.where(self.hi < 0, -1.0, 1.0))

    def exp(self) -> Interval:
        """Exponential (monotone)."""
        out = _out(np.exp(self.lo), np.exp(self.hi), _ULPS)
        return Interval(np.maximum(out.lo, 0.0), out.hi)

    def tanh(self) -> Interval:
        """Hyperbolic tangent (monotone)."""
        out = _out(np.tanh(self.lo), np.tanh(self.hi), _ULPS)
        return Interval(np.clip(out.lo, -1.0, 1.0), np.clip(out.hi, -1.0, 1.0))

    def sqrt(self) -> Interval:
        """Square root (monotone)."""
        if np.any(self.lo < 0):
            raise ValueError(f"square root of an interval that starts at {self.lo.min()}; expected >= 0")
        out = _out(np.sqrt(self.lo), np.sqrt(self.hi))
        return Interval(np.maximum(out.lo, 0.0), out.hi)

    def cos(self) -> Interval:
        """Cosine: the ends, and 1 or -1 where a crest lies between (crests found outward by 1e-9 rad)."""
        ends = np.stack([np.cos(self.lo), np.cos(self.hi)])
        slack = 1e-9
        crest = np.floor((self.hi + slack) / _TWO_PI) >= np.ceil((self.lo - slack) / _TWO_PI)
        trough = np.floor((self.hi + slack - np.pi) / _TWO_PI) >= np.ceil((self.lo - slack - np.pi) / _TWO_PI)
        out = _out(np.where(trough, -1.0, ends.min(axis=0)), np.where(crest, 1.0, ends.max(axis=0)), _ULPS)
        return Interval(np.clip(out.lo, -1.0, 1.0), np.clip(out.hi, -1.0, 1.0))

    def sin(self) -> Interval:
        """Sine, as the cosine a quarter turn earlier."""
        return (self - np.pi / 2).cos()

    def minimum(self, other: Any) -> Interval:
        """The smaller of two."""
        lo, hi = _pair(other)
        return Interval(np.minimum(self.lo, lo), np.minimum(self.hi, hi))

    def maximum(self, other: Any) -> Interval:
        """The larger of two."""
        lo, hi = _pair(other)
        return Interval(np.maximum(self.lo, lo), np.maximum(self.hi, hi))
