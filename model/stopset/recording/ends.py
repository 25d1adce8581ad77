"""The ends of a recording that a filter bent: readings that say nothing of the arm.

Who filters a recording forwards and backwards, or from its first sample on, leaves the filter's start in it: positions come to rest
while speeds go on.  Held for readings, such a part would make every error bound as large as itself.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stopset.recording.types import Recording
from stopset.types import Array

SLOPE = 0.02  # [s] over which the slope of positions is taken, at least two samples to each side
EDGE = 1.0  # [s] how far such a part can reach
FEWEST = 10.0  # times `EDGE` that a trial must be long: a short one has no middle to compare with
OFF = 0.1  # of the joint's largest speed by which speed and slope must differ at the very end
USUAL = 3.0  # times what they differ by in the middle, all but the largest hundredth; likewise
FADES = 0.2  # of that difference, from which on inwards the part still counts
MOSTLY = 0.5  # share of the part in which they differ


def sound_part(r: Recording, *, alone: bool = False) -> Recording:
    """A powered trial without the ends at which its speeds contradict its positions; ``bent`` [s]: what was left out.

    In open loop the beginning stays: trials of one suite are those that begin alike.  ``alone``: nobody said that it is open loop, for which
    a file without phases is taken, and there is no other trial that it could begin like.
    """
    if r.phase not in ("closed_loop", "open_loop") or r.t[-1] - r.t[0] < FEWEST * EDGE:
        return r
    by = _contradiction(r)
    begin = _reach(by, r.t - r.t[0]) if alone or r.phase == "closed_loop" else 0
    end = _reach(by[::-1], r.t[-1] - r.t[::-1])
    if begin == end == 0:
        return r
    lo, hi = begin, len(r.t) - end
    return replace(r.cut(lo, hi), bent=(float(r.t[lo] - r.t[0]), float(r.t[-1] - r.t[hi - 1])))


def _contradiction(r: Recording) -> Array:
    """(N,) how far the speed of any joint is from the slope of its positions, 1: by far more than in the middle of the trial."""
    k = max(2, round(SLOPE / float(np.median(np.diff(r.t)))))
    left = np.clip(np.arange(len(r.t)) - k, 0, None)
    right = np.clip(np.arange(len(r.t)) + k, None, len(r.t) - 1)
    travel = np.zeros_like(r.q)
    np.cumsum(0.5 * (r.dq[1:] + r.dq[:-1]) * np.diff(r.t)[:, None], axis=0, out=travel[1:])
    off = np.abs((r.q - travel)[right] - (r.q - travel)[left]) / (r.t[right] - r.t[left])[:, None]
    middle = (r.t > r.t[0] + EDGE) & (r.t < r.t[-1] - EDGE)
    least = np.maximum(OFF * np.abs(r.dq).max(axis=0), USUAL * np.percentile(off[middle], 99, axis=0))
    return np.asarray((off / np.maximum(least, 1e-9)).max(axis=1))


def _reach(by: Array, away: Array) -> int:
    """Samples from an end (``away`` [s] from it) up to where the contradiction fades; 0 where there is none at the end itself."""
    if by[0] <= 1.0:
        return 0
    near = np.flatnonzero((by > FADES) & (away <= EDGE))
    mostly = np.arange(1, len(near) + 1) >= MOSTLY * (near + 1)
    return int(near[mostly][-1]) + 1
