"""Rows that a logger wrote twice or could not fill: no samples of the arm.

A message that is logged twice stands twice, with one stamp and one set of readings; a message that was lost may leave a row without
numbers.  Either is as good as no row.  Rows with one stamp and other readings, and many without numbers, are left to be refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stopset.types import Array

UNREAD = 0.01  # share of a trial's rows that may lack numbers; where more do, a channel is broken


@dataclass(frozen=True, slots=True)
class SoundRows:
    """``rows`` (N,) of a trial that count; how many were left out as written ``twice``, and as ``unread``: without a number."""

    rows: NDArray[np.bool_]
    twice: int
    unread: int


def sound_rows(t: Array, signals: Sequence[Array]) -> SoundRows:
    """Rows with stamps ``t`` (N,) and ``signals`` (N, n) each, but for those that say nothing."""
    finite = np.isfinite(t) & np.logical_and.reduce([np.isfinite(x).all(axis=1) for x in signals])
    unread = int((~finite).sum())
    if unread > UNREAD * len(t):
        finite, unread = np.ones(len(t), bool), 0
    rows = finite.copy()
    at = np.flatnonzero(finite)
    same = np.diff(t[at]) == 0
    for x in signals:
        same &= (x[at[1:]] == x[at[:-1]]).all(axis=1)
    rows[at[1:][same]] = False
    return SoundRows(rows, int(same.sum()), unread)
