"""Numbers and words as C text, exact to the last bit."""

from __future__ import annotations

import math
from typing import Any

import numpy as np


def number(x: float) -> str:
    """A double."""
    if math.isnan(x):
        return "(double)NAN"
    if math.isinf(x):
        return "HUGE_VAL" if x > 0 else "-HUGE_VAL"
    return repr(float(x))


def array(x: Any) -> str:
    """An initializer, nested as ``x`` is."""
    a = np.asarray(x, float)
    if a.ndim == 0:
        return number(float(a))
    return "{" + ", ".join(array(v) for v in a) + "}"


def quoted(text: str) -> str:
    """A C string of printable ASCII."""
    plain = text.encode("ascii", "replace").decode().replace("\\", "\\\\").replace('"', '\\"')
    return f'"{"".join(c if c.isprintable() else "?" for c in plain)}"'
