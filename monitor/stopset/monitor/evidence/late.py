"""Torque that is told later than it acts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stopset.monitor.evidence.case import BACK, Case
from stopset.monitor.evidence.cause import Cause, Kind
from stopset.monitor.evidence.dynamics import Readings
from stopset.monitor.evidence.pushes import Pushes
from stopset.types import Array

LATEST = 12  # cycles that torque is tried late by
TRIED = 12  # of the most promising ways of being late, held against the model


def late_torque(c: Case, pushes: Pushes) -> Cause | None:
    """Torque that was told later than it acted: moved back in time it agrees, and no law explains the ``pushes`` far better.

    In wide sets a motion back and forth lets a little delay pass for a weak spring; and what is outside by a hair agrees after any
    change, so the pushes are asked where none is more than the model may lack, too.
    """
    tau, y = c.w.tau, c.model.pushes(c.readings)
    width, rows = c.model.U_hi - c.model.U_lo, np.arange(len(c.w))
    tried: list[tuple[float, int, int, int | None]] = []
    for late in range(1, min(LATEST, len(c.w) - c.at - 2) + 1):
        for since in {0, *range(max(0, c.at - 2 * BACK), c.at + 1, 2)}:
            earlier = _earlier(tau, late, np.flatnonzero(rows >= since))
            over = np.square(c.model.beyond(y - c.model.averaged(earlier)) / width).sum(axis=0)
            as_is = np.square(c.model.beyond(y) / width).sum(axis=0)
            tried.append((float(over.sum()), late, since, None))
            tried.append((float(over[c.joint] + np.delete(as_is, c.joint).sum()), late, since, c.joint))
        c.pause()
    for _, late, since, joint in sorted(tried, key=lambda x: (x[0], x[1]))[:TRIED]:
        more = _earlier(tau, late, np.flatnonzero(rows >= since), joint)
        if pushes.lawful_beside(pushes.left_by(c, more)):
            continue
        u = c.readings.u + more
        if c.holds(Readings(c.readings.x[:-late], u[:-late], c.readings.good[:-late])):
            where = "of all joints" if joint is None else f"of {c.model.joints[joint]}"
            return c.cause(
                Kind.LATE_TORQUE, f"the torque {where} is told about {1e3 * late * c.model.dt:.0f} ms later than it acts", joint,
                max(since, 0), signal="tau", size=late * c.model.dt, unit="s",
            )  # fmt: skip
    return None


def _earlier(tau: Array, late: int, rows: NDArray[np.int64], joint: int | None = None) -> Array:
    """(N, n) what moving the torque of ``rows`` ``late`` cycles back in time adds to it."""
    out = np.zeros_like(tau)
    rows = rows[rows < len(tau) - late]
    columns = slice(None) if joint is None else [joint]
    moved = np.zeros_like(tau)
    moved[rows] = tau[rows + late] - tau[rows]
    out[:, columns] = moved[:, columns]
    return out
