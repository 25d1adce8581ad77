"""Torque that a joint's simulated lag lacks along the measured motion: what a simulation that errs both ways may hide.

Position error is judged where a model is simulated; it can fall although the law claimed is not the one at work.  The momentum
balance over a stop's length needs no simulation and no derivative of what was measured, so it is a second judge of the same claim.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stopset.offline.abstraction.metrics import AVERAGING
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.nominal.open_loop import EffectTerm, JointBatch
from stopset.offline.nominal.output_error import momentum
from stopset.types import Array


def lacking(batch: JointBatch, terms: Sequence[EffectTerm], p: Array) -> Array:
    """(B,) mean square [N^2 m^2], by trial, of the torque that ``p`` (log J, log v, offset, terms) lacks, averaged over `AVERAGING`."""
    impulse, columns = momentum(batch, terms)
    left = impulse - columns @ np.concatenate([np.exp(p[:2]), p[2:]])
    m = max(1, round(AVERAGING / batch.dt))
    squares = (np.diff(left[::m], axis=0) / (m * batch.dt)) ** 2
    whole = batch.inside[::m][1:]
    return np.asarray((squares * whole).sum(axis=0) / np.maximum(whole.sum(axis=0), 1))


def rises(before: Array, after: Array) -> bool:
    """Whether trials lack more torque ``after`` than ``before`` (B, mean squares), by more than chance among them and by `limit.RISES`."""
    more = after - before
    chance = np.std(more, ddof=1) / np.sqrt(len(more)) if len(more) > 1 else 0.0
    return bool(more.mean() > limit.SURE_RISE * chance and after.mean() > (1.0 + limit.RISES) ** 2 * before.mean())
