"""Readings that a logger wrote more often than the robot gave them: every row of a faster table holds the last one.

Between two readings such a table says that the arm stands, and at the next one that it leaps; a speed that was taken from its rows is zero
in most of them and many times too large in the others.  Rows at which all joints' readings change together, at an even pace, tell the
robot's own rate: of every reading one row is kept.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from stopset.recording.types import Recording
from stopset.types import Array

FEWEST_READINGS = 50  # of a trial whose pace is looked at
TWICE = 1.5  # rows per reading from which on a table is one of held readings; now and then one again is `polled`'s
EVENLY = 0.95  # share of readings that stand for the same number of rows, give or take what a pace of its own makes
TOGETHER = 0.9  # share of readings with which a signal that moves changes
SIGNALS = 3  # that must: one joint that turns evenly passes the marks of a coarse encoder at an even pace, too
MOST = 50  # rows per reading; beyond, it is rests that are seen
LATE = 1.5  # rows by which a reading may be written later than an even clock gave it
OF_ROWS = 0.2  # relative: speeds that are as many times too large as a reading has rows were taken from rows
FOLLOWS = 0.9  # correlation of speeds with the slope of angles, from which on that is asked


def each_once(r: Recording, *, derived: bool = False) -> Recording:
    """A trial with one row of every reading; ``held``: in how many rows each stood, on average.

    ``derived``: its speeds were made from angles and these stamps.  They are made anew, as are those that were taken from rows.
    """
    fresh = _fresh(r)
    rows = pace(r, fresh)
    if not rows:
        return r
    at, count = _retained(fresh, rows)
    t = _clock(r.t[at], count, float(np.median(np.diff(r.t))))
    # a stop may be asked for between two readings
    trigger = None if r.stop_trigger is None else np.logical_or.reduceat(r.stop_trigger, at)
    out = replace(r.rows(at), t=t, stop_trigger=trigger, held=rows)
    slope = np.gradient(out.q, t, axis=0)
    return replace(out, dq=slope) if derived or _of_rows(out.dq, slope, rows) else out


def _fresh(r: Recording) -> NDArray[np.bool_]:
    """(N - 1, 2 n) where angles and torques differ from the row before."""
    return np.asarray(np.diff(np.column_stack([r.q, r.tau]), axis=0) != 0.0)


def pace(r: Recording, fresh: NDArray[np.bool_]) -> float:
    """Rows per reading; 0.0 where every row may be one of its own."""
    change: NDArray[np.bool_] = np.asarray(fresh.any(axis=1))
    where = np.flatnonzero(change)
    if len(where) < FEWEST_READINGS or len(where) * TWICE > len(change):
        return 0.0
    distance = np.diff(where)
    usual = float(np.median(distance))
    runs = distance[distance <= 2.0 * usual]  # longer ones are rests
    rows = float(runs.mean())
    even = np.abs(runs - rows) < 1.0 + 1e-9
    shared = (fresh[where].mean(axis=0) >= TOGETHER).sum()
    if not TWICE <= rows <= MOST or even.mean() < EVENLY or len(runs) < EVENLY * len(distance) or shared < SIGNALS:
        return 0.0
    return rows


def _retained(fresh: NDArray[np.bool_], rows: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows that are kept, from the first change on, a rest at the pace of the rest; and the number of each on the robot's clock."""
    where = np.flatnonzero(fresh.any(axis=1)) + 1
    at, count = [int(where[0])], [0]
    for k in where[1:]:
        periods = max(1, round((k - at[-1]) / rows))
        begin, first = at[-1], count[-1]
        for p in range(1, periods):  # the arm rests: the same reading again
            at.append(begin + round(p * (k - begin) / periods))
            count.append(first + p)
        at.append(int(k))
        count.append(first + periods)
    return np.array(at), np.array(count)


def _clock(t: Array, count: NDArray[np.intp], row: float) -> Array:
    """Stamps of the readings: those of an even clock where the logger was late by no more than its own ``row`` [s], else as they are."""
    line = np.polyfit(count, t, 1)
    even: Array = np.asarray(np.polyval(line, count), np.float64)
    return even if np.abs(t - even).max() < LATE * row else t


def _of_rows(dq: Array, slope: Array, rows: float) -> bool:
    """Whether speeds (N, n) are as many times the ``slope`` of the angles as each reading has ``rows``."""
    moves = slope.std(axis=0) > 1e-3
    if not moves.any():
        return False
    size = (dq * slope).sum(axis=0)[moves] / (slope**2).sum(axis=0)[moves]
    alike = [np.corrcoef(dq[:, j], slope[:, j])[0, 1] if dq[:, j].std() > 0 else 0.0 for j in np.flatnonzero(moves)]
    return bool(np.abs(np.median(size) / rows - 1.0) < OF_ROWS and np.median(alike) > FOLLOWS)
