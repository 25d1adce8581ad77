"""What friction does to the torque where a joint turns round: the sign of a torque, told with no model of the arm.

Across a reversal angles, the other joints' speeds and all accelerations go on as they were, so that gravity and inertia do, too; only
dry friction changes sides.  The torque rises with the direction, or its sign is turned.  A joint's energy does not tell: gravity
hands it from one joint to the other, and one of two that move together may take it out for ever.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from stopset.recording.types import Recording
from stopset.types import Array

MOVING = 0.02  # [rad/s]
BESIDE = 0.15  # [s] to each side of a reversal: gravity and inertia change by a straight line there
RESTS = 0.5  # [s] that a joint may stand between its two directions
FEWEST = 4  # samples on each side


def add_reversals(turns: Array, r: Recording) -> None:
    """Add a trial's reversals to ``turns`` (3, n): how many each joint has, and sums of the torque's half steps [N m] there and of their squares."""
    for j, rise in steps(r):
        turns[:, j] += 1.0, rise, rise**2


def steps(r: Recording) -> Iterator[tuple[int, float]]:
    """Joint and half the step of its torque [N m] along its new direction, of each reversal of a trial."""
    for j in range(r.q.shape[1]):
        side = np.where(np.abs(r.dq[:, j]) > MOVING, np.sign(r.dq[:, j]), 0.0)
        at = np.flatnonzero(side)
        for k in np.flatnonzero(np.diff(side[at])):
            step = _step(r.t, side, r.tau[:, j], int(at[k]), int(at[k + 1]))
            if step is not None:
                yield j, step


def _step(t: Array, side: Array, tau: Array, last: int, first: int) -> float | None:
    """Of the reversal between the ``last`` sample of one direction and the ``first`` of the other; none where there are too few."""
    if t[first] - t[last] > RESTS:
        return None
    begin, end = np.searchsorted(t, t[last] - BESIDE), np.searchsorted(t, t[first] + BESIDE, side="right")
    near = np.r_[begin : last + 1, first:end]
    near = near[side[near] == np.where(near <= last, side[last], side[first])]
    if min((near <= last).sum(), (near >= first).sum()) < FEWEST:
        return None
    X = np.column_stack([side[near], np.ones(len(near)), t[near] - t[last]])
    return float(np.linalg.lstsq(X, tau[near], rcond=None)[0][0])
