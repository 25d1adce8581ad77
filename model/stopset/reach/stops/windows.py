"""Brakes that one power stage cuts close together: the stop is bounded once for every window of their common delay.

A box of delays also holds stops in which one joint brakes early and another late, which the arm was never seen to do and
which are the worst for coupling.  With ``apart`` known these are left out: joint i's delay is ``delay_lo_i + s + e_i``
with one ``s`` for all joints and ``0 <= e_i <= apart``.
"""

from __future__ import annotations

import numpy as np

from stopset.reach.stops.tube import Plant

WIDTH = 5e-3  # [s] of the common delay per window, at least; half of what the joints differ by anyway, if that is more


def windows(plant: Plant, apart: float | None, most: int | None = None) -> list[Plant]:
    """The plant once for every window of the common delay, ``most`` at most; the plant itself where delays are independent."""
    if apart is None:
        return [plant]
    room = float(np.max(plant.delay_hi - plant.delay_lo)) - apart  # of the common part
    if room <= 0.0:
        return [plant]
    count = int(np.ceil(room / max(WIDTH, 0.5 * apart)))
    count = count if most is None else min(count, most)
    out = []
    for k in range(count):
        early, late = room * k / count, room * (k + 1) / count + apart
        lo = np.minimum(plant.delay_lo + early, plant.delay_hi)
        out.append(plant._replace(delay_lo=lo, delay_hi=np.minimum(plant.delay_lo + late, plant.delay_hi)))
    return out
