"""From a few observed values to an interval for the next ones, stated as a rule and not by feeling."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
RISK = 0.025  # that the next value of a group lies beyond one end of its interval
MOST = 0.5  # times the width of what was seen is the farthest an interval is carried beyond it


def beyond(count: int) -> float:
    """By how much of its width a hull of ``count`` values is widened on each side.

    Values spread evenly over an unknown band: the next one lies more than ``a`` widths above the largest of ``count`` with
    probability ``(1 + a)^(1 - count) / (count + 1)``, as the ``count`` gaps share the width alike; `RISK` gives ``a``.
    With fewer than six values `MOST` is reached and the risk is larger.
    """
    if count < 2:
        return MOST
    return float(np.clip(((count + 1) * RISK) ** (-1.0 / (count - 1)) - 1.0, 0.0, MOST))


def band(values: Sequence[float] | Array, count: int | None = None, most: float = MOST) -> tuple[float, float]:
    """Interval for the next value; ``count``: how many independent observations these are, default all."""
    lo, hi = float(np.min(values)), float(np.max(values))
    more = min(beyond(len(values) if count is None else count), most) * (hi - lo)
    return lo - more, hi + more


def hull(groups: Mapping[int, tuple[list[float], int]], most: float = MOST) -> tuple[float, float]:
    """Hull of the bands of several groups of (values, independent observations), each judged by its own spread."""
    bands = [band(values, count, most) for values, count in groups.values() if values]
    return min(b[0] for b in bands), max(b[1] for b in bands)
