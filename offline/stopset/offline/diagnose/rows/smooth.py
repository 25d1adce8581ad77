"""Row signals smoothed and shifted in time, compiled."""

from __future__ import annotations

import numpy as np
from numba import njit

from stopset.offline.diagnose.rows.prepare import Array, Mask


@njit(cache=True, nogil=True)
def calm(x: Array, first: Mask) -> Array:
    """A row signal smoothed over about +-3 rows within its trial; ``first``: the first row of each.

    The link torque holds the position's noise in its second derivative, and the swing differentiates it twice more: without
    this, noise common to the column and the torque would pass for elasticity.
    """
    weights = np.array([0.2, 0.18, 0.13, 0.07, 0.02])
    out = np.empty_like(x)
    lo = 0
    for k in range(x.shape[0]):
        if first[k]:
            lo = k
        total, norm = weights[0] * x[k], weights[0]
        for s in range(1, 5):
            hi = k + s
            if k - s < lo or hi >= x.shape[0] or first[hi]:
                break
            total += weights[s] * (x[k - s] + x[hi])
            norm += 2 * weights[s]
        out[k] = total / norm
    return out


@njit(cache=True, nogil=True)
def shifted(x: Array, rows: float) -> Array:
    """``x`` late by so many rows (a fraction too), by cubic interpolation; held at the ends."""
    whole = int(np.floor(rows))
    u = rows - whole
    before, here = -u * (1 - u) * (2 - u) / 6, (1 + u) * (1 - u) * (2 - u) / 2
    after, beyond = (1 + u) * u * (2 - u) / 2, -(1 + u) * u * (1 - u) / 6
    last = x.shape[0] - 1
    out = np.empty_like(x)
    for k in range(x.shape[0]):
        at = k - whole
        out[k] = (
            before * x[min(max(at + 1, 0), last)]
            + here * x[min(max(at, 0), last)]
            + after * x[min(max(at - 1, 0), last)]
            + beyond * x[min(max(at - 2, 0), last)]
        )
    return out
