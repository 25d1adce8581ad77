"""The grid that nonlinear abstractions predict on: coarser than the recordings, for their hull costs the square of its steps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stopset.types import Array

GRID = 0.02  # [s] finest step of the time-varying hull, whose cost is quadratic in the number of steps
Trial = tuple[Array, Array]  # states (N, 2n) on the grid, inputs (N, n)


def coarser(trials: Sequence[Trial], every: int) -> list[Trial]:
    """Every so-many-th state, and the mean of the inputs in between."""
    out = []
    for x, u in trials:
        steps = (len(x) - 1) // every
        mean = u[: steps * every].reshape(steps, every, -1).mean(axis=1)
        out.append((np.ascontiguousarray(x[: steps * every + 1 : every]), np.vstack([mean, mean[-1:]])))
    return out
