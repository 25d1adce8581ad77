"""Brakes that one power stage cuts close together: the stop is bounded once for every window of their common delay.

A box of delays also holds stops in which one joint brakes early and another late, which the arm was never seen to do and
which are the worst for coupling.  With ``delay_spread`` known these are left out: the times at which the brakes of one stop engage,
each less its joint's ``lag``, differ by ``delay_spread`` at most.  Let ``c`` be the least of them.  Then joint i's delay lies in
``[c, c + delay_spread] + lag_i``, and in its own interval.  ``c`` is no larger than any of the joints' largest values and no less than
``delay_spread`` before any of their least, so it lies in an interval, which the windows cut; and where ``c + delay_spread`` would reach
beyond every joint's largest value, a smaller c tells the same.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from stopset.reach.stops.tube import Plant
from stopset.types import Array

WIDTH = 5e-3  # [s] of the common delay per window, at least; half of what the joints differ by anyway, if that is more
TINY = 1e-12  # [s] an interval is not empty for rounding alone


def windows(plant: Plant, delay_spread: float | None, lag: Array | None = None, most: int | None = None) -> list[Plant]:
    """The plant once for every window of the common delay, ``most`` at most; the plant itself where delays are independent.

    ``delay_spread`` [s], ``lag`` (n,) [s], none where None: see `stopset.artifact.Brakes`, and Lemma 0 of docs/stops.md.
    """
    if delay_spread is None:
        return [plant]
    own = np.zeros_like(plant.delay_lo) if lag is None else lag
    lo, hi = plant.delay_lo - own, plant.delay_hi - own
    begin = max(float(lo.min()), float(lo.max()) - delay_spread)
    end = min(float(hi.min()), max(float(hi.max()) - delay_spread, begin))
    if end - begin <= TINY:  # one window, or intervals that no such stop fits into
        return [plant] if end < begin - TINY else [_window(plant, own, begin, end + delay_spread) or plant]
    count = int(np.ceil((end - begin) / max(WIDTH, 0.5 * delay_spread)))
    borders = np.linspace(begin, end, 1 + (count if most is None else min(count, most)))
    parts = [_window(plant, own, a, b + delay_spread) for a, b in pairwise(borders)]
    return [p for p in parts if p is not None] or [plant]


def _window(plant: Plant, own: Array, early: float, late: float) -> Plant | None:
    """The plant with the delays between ``early`` and ``late`` [s] plus each joint's own; None where one has none there."""
    lo, hi = np.maximum(plant.delay_lo, early + own), np.minimum(plant.delay_hi, late + own)
    if np.any(lo > hi + TINY):
        return None
    if np.array_equal(lo, plant.delay_lo) and np.array_equal(hi, plant.delay_hi):
        return plant
    return plant._replace(delay_lo=lo, delay_hi=np.maximum(hi, lo))
