"""From a few observed values to an interval for the next ones, stated as a rule and not by feeling.

Every rule answers one question: by how much must what was seen be widened so that the next stop leaves it with probability
`RISK`, if values spread evenly over a band that nobody knows?  Few values ask for much; that is what a few stops are worth.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from stopset.recording import SuiteKey
from stopset.types import Array

RISK = 0.005  # that the next stop's value lies outside, on either side
TIMES = (0.0, 1.5)  # no delay or ramp is taken to last longer than this times the longest seen, however few the stops
WIDEN, WIDENINGS = 1.15, 6  # of the sets per round, and rounds at most, until the training stops are enclosed
DOUBLINGS = 14  # of what these did not do for: in the end brakes surely hold nothing, and no stop has a bound to leave
TORQUES = (0.8, 1.25)  # no brake to press less or more than this times the least and the most seen: wear, heat, oil


def beyond(count: int) -> float:
    """By how much of its width the range of ``count`` values is widened on each side.

    Of ``count`` values spread evenly over an unknown band the next one lies more than ``a`` widths above the largest with
    probability ``(1 + a)^(1 - count) / (count + 1)``, as the ``count`` gaps share the width alike; half of `RISK` gives ``a``.
    """
    if count < 2:
        return np.inf
    return float(max((0.5 * (count + 1) * RISK) ** (-1.0 / (count - 1)) - 1.0, 0.0))


def farther(count: int) -> float:
    """Times the largest of ``count`` distances from a known middle that the next one exceeds with probability `RISK`.

    Of distances spread evenly from zero to an unknown end the next one exceeds ``c`` times the largest with probability
    ``c^-count / (count + 1)``.
    """
    return float(max(((count + 1) * RISK) ** (-1.0 / max(count, 1)), 1.0))


def band(values: Sequence[float] | Array, count: int | None = None) -> tuple[float, float]:
    """Interval for the next value; ``count``: how many independent observations these are, default all."""
    lo, hi = float(np.min(values)), float(np.max(values))
    more = beyond(len(values) if count is None else count) * (hi - lo) if hi > lo else 0.0
    return lo - more, hi + more


def around(values: Sequence[float] | Array, middle: float, count: int) -> tuple[float, float]:
    """Interval for the next value of what was varied around ``middle``, upwards and downwards alike."""
    more = farther(count) * float(np.max(np.abs(np.asarray(values) - middle)))
    return middle - more, middle + more


def hull(groups: Mapping[SuiteKey, tuple[list[float], int]], reach: tuple[float, float] = TIMES) -> tuple[float, float]:
    """Interval of a positive quantity over groups of (values, independent observations), within ``reach`` of those seen.

    The group seen most is what the arm regularly does, and gets the band of its own range.  The others were varied on
    purpose or by chance around it: they are judged by their distance from its middle, which takes fewer of them.
    """
    known = [(values, count) for values, count in groups.values() if values]
    known.sort(key=lambda g: -g[1])
    regular, count = known[0]
    middle = float(np.median(regular))
    bands = [band(regular, count), *(around(values, middle, count) for values, count in known[1:])]
    seen = np.concatenate([values for values, _ in known])
    lo, hi = min(b[0] for b in bands), max(b[1] for b in bands)
    return max(lo, reach[0] * float(seen.min())), min(hi, reach[1] * float(seen.max()))
