"""Slopes: what a law can give while one variable grows from zero, and how fast it gives more.

A number ``f(x)`` with ``0 <= x <= X`` and everything else in intervals: all its values lie in ``all``, at ``x = 0`` in
``start``, and ``f(x) - f(0)`` in ``rate * x``.  So viscous friction keeps its coefficient, where an interval of its torque
would forget that it is small at small speeds.

Source: Moore, Kearfott & Cloud, Introduction to Interval Analysis (2009), ch. 6 (slopes and the mean value form).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from stopset.ring.interval import Interval


def _interval(x: Any) -> Interval:
    return x if isinstance(x, Interval) else Interval(np.asarray(x, float), np.asarray(x, float))


ZERO = _interval(0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Slope:
    """See the module; ``rate`` is None where the number may jump or no bound of its slope is known."""

    all: Interval
    start: Interval
    rate: Interval | None
    __array_ufunc__ = None  # numpy arrays hand over to the operators below

    @classmethod
    def constant(cls, x: Any) -> Slope:
        """A number (or an interval of one) that does not depend on the variable."""
        return cls(_interval(x), _interval(x), ZERO)

    @classmethod
    def variable(cls, most: Any, sign: Any = 1.0) -> Slope:
        """``sign * x`` itself, ``x`` from 0 to ``most`` (arrays, for several at once)."""
        end = np.asarray(sign * most, float)
        return cls(Interval(np.minimum(end, 0.0), np.maximum(end, 0.0)), ZERO, _interval(sign + 0.0 * end))

    def __neg__(self) -> Slope:
        return Slope(-self.all, -self.start, None if self.rate is None else -self.rate)

    def __add__(self, other: Any) -> Slope:
        o = _slope(other)
        if o is None:
            return NotImplemented
        return Slope(self.all + o.all, self.start + o.start, _both(self, o, lambda a, b: a + b))

    def __sub__(self, other: Any) -> Slope:
        o = _slope(other)
        return NotImplemented if o is None else self + (-o)

    def __rsub__(self, other: Any) -> Slope:
        o = _slope(other)
        return NotImplemented if o is None else o + (-self)

    def __mul__(self, other: Any) -> Slope:
        o = _slope(other)
        if o is None:
            return NotImplemented
        # f g - f0 g0 = f (g - g0) + (f - f0) g0
        return Slope(self.all * o.all, self.start * o.start, _both(self, o, lambda a, b: self.all * b + a * o.start))

    __radd__ = __add__
    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Slope:
        o = _slope(other)
        if o is None:
            return NotImplemented
        start = self.start / o.start
        return Slope(self.all / o.all, start, _both(self, o, lambda a, b: (a - start * b) / o.all))

    def __rtruediv__(self, other: Any) -> Slope:
        o = _slope(other)
        return NotImplemented if o is None else o / self

    def __pow__(self, n: int) -> Slope:
        if not isinstance(n, int) or n < 0:
            raise ValueError(f"power {n!r} of a slope; expected an integer >= 0")
        out = Slope.constant(1.0)
        for _ in range(n):
            out = out * self
        return Slope(self.all**n, self.start**n, out.rate)

    def _by(self, f: Callable[[Interval], Interval], derivative: Callable[[Interval], Interval]) -> Slope:
        """A smooth function of it: mean value theorem."""
        rate = None if self.rate is None else derivative(self.all) * self.rate
        return Slope(f(self.all), f(self.start), rate)

    def square(self) -> Slope:
        """Of one and the same number, so never negative."""
        rate = None if self.rate is None else (self.all + self.start) * self.rate
        return Slope(self.all.square(), self.start.square(), rate)

    def exp(self) -> Slope:
        """Exponential."""
        return self._by(Interval.exp, Interval.exp)

    def sin(self) -> Slope:
        """Sine."""
        return self._by(Interval.sin, Interval.cos)

    def cos(self) -> Slope:
        """Cosine."""
        return self._by(Interval.cos, lambda x: -x.sin())

    def tanh(self) -> Slope:
        """Hyperbolic tangent."""
        return self._by(Interval.tanh, lambda x: 1.0 - x.tanh().square())

    def sqrt(self) -> Slope:
        """Square root; it has no slope where it starts from zero."""
        if np.any(self.all.lo <= 0.0):
            return Slope(self.all.sqrt(), self.start.sqrt(), ZERO if self._constant else None)
        return self._by(Interval.sqrt, lambda x: 0.5 / x.sqrt())

    def absolute(self) -> Slope:
        """Magnitude: it changes no faster than the number itself."""
        rate = self.rate
        if rate is not None:
            size = np.maximum(np.abs(rate.lo), np.abs(rate.hi))
            up, down = self.all.lo >= 0.0, self.all.hi <= 0.0
            lo = np.where(up, rate.lo, np.where(down, -rate.hi, -size))
            rate = Interval(lo, np.where(up, rate.hi, np.where(down, -rate.lo, size)))
        return Slope(self.all.absolute(), self.start.absolute(), rate)

    def sign(self) -> Slope:
        """Direction; it has no slope where the number can pass zero."""
        steady = self._constant or bool(np.all((self.all.lo > 0.0) | (self.all.hi < 0.0)))
        return Slope(self.all.sign(), self.start.sign(), ZERO if steady else None)

    @property
    def _constant(self) -> bool:
        return self.rate is not None and not np.any(self.rate.lo) and not np.any(self.rate.hi)

    def minimum(self, other: Any) -> Slope:
        """The smaller of two."""
        o = _slope(other)
        if o is None:
            raise TypeError(f"the smaller of a slope and a {type(other).__name__}; expected a number")
        return Slope(self.all.minimum(o.all), self.start.minimum(o.start), _both(self, o, _hull))

    def maximum(self, other: Any) -> Slope:
        """The larger of two."""
        o = _slope(other)
        if o is None:
            raise TypeError(f"the larger of a slope and a {type(other).__name__}; expected a number")
        return Slope(self.all.maximum(o.all), self.start.maximum(o.start), _both(self, o, _hull))


def _slope(x: Any) -> Slope | None:
    """Any number as a `Slope`; None for what is no number of this kind."""
    if isinstance(x, Slope):
        return x
    return Slope.constant(x) if isinstance(x, (Interval, int, float, np.ndarray, np.number)) else None


def _both(a: Slope, b: Slope, f: Callable[[Interval, Interval], Interval]) -> Interval | None:
    return None if a.rate is None or b.rate is None else f(a.rate, b.rate)


def _hull(a: Interval, b: Interval) -> Interval:
    return Interval(np.minimum(a.lo, b.lo), np.maximum(a.hi, b.hi))
