"""The functions a law may call; each asks the number for its own version and falls back to numpy."""

from __future__ import annotations

from typing import Any

import numpy as np

Number = Any  # float, array, Interval, Tape, Taylor form


def _apply(name: str, x: Number) -> Number:
    own = getattr(x, name, None)
    return own() if own is not None else getattr(np, name)(x)


def sin(x: Number) -> Number:
    """Sine of ``x`` [rad]."""
    return _apply("sin", x)


def cos(x: Number) -> Number:
    """Cosine of ``x`` [rad]."""
    return _apply("cos", x)


def exp(x: Number) -> Number:
    """Exponential."""
    return _apply("exp", x)


def tanh(x: Number) -> Number:
    """Hyperbolic tangent."""
    return _apply("tanh", x)


def sqrt(x: Number) -> Number:
    """Square root."""
    return _apply("sqrt", x)


def absolute(x: Number) -> Number:
    """Magnitude."""
    return _apply("absolute", x)


def sign(x: Number) -> Number:
    """-1, 0 or 1; over an interval through zero: all of [-1, 1]."""
    return _apply("sign", x)


def square(x: Number) -> Number:
    """``x * x``, tighter than the product where the number kind forgets that both factors are the same."""
    return _apply("square", x)


def minimum(x: Number, y: Number) -> Number:
    """The smaller of two numbers."""
    if hasattr(x, "minimum"):
        return x.minimum(y)
    return y.minimum(x) if hasattr(y, "minimum") else np.minimum(x, y)


def maximum(x: Number, y: Number) -> Number:
    """The larger of two numbers."""
    if hasattr(x, "maximum"):
        return x.maximum(y)
    return y.maximum(x) if hasattr(y, "maximum") else np.maximum(x, y)
