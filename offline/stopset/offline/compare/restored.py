"""Torque that was low-passed before it was recorded, with what the filter took off put back from a model."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from stopset.artifact import Model
from stopset.offline.compare.known import TorqueModel, left_over
from stopset.offline.nominal.preprocess import PreparedMotion, Preprocessing, motions
from stopset.recording import Recording
from stopset.types import Array


def restored(model: Model | TorqueModel, trials: Iterable[Recording], cutoff: float) -> Iterator[Recording]:
    """The trials with ``tau + y - F y``: ``y`` the model's own torque, ``F`` the low-pass of ``cutoff`` [Hz]; poses as they are.

    Above the cut-off nothing was recorded: what such torque says there is the model's.
    """
    for r in trials:
        if r.phase == "static":
            yield r
            continue
        for m in motions(r, Preprocessing(low_pass=cutoff)):
            y = model_torque(model, m)
            tau = m.raw_tau + y - m.smooth(y) if m.narrow else m.raw_tau
            q, dq = (np.column_stack([np.interp(m.t, r.t, c) for c in x.T]) for x in (r.q, r.dq))
            yield replace(r, t=m.t, q=q, dq=dq, tau=tau, temp=m.temp, current=None, q_link=None, stop_trigger=None)


def model_torque(model: Model | TorqueModel, m: PreparedMotion) -> Array:
    """(N, n) [N m] torque that the model has for a motion, effects and friction in full, at every sample."""
    q, dq, ddq = (np.ascontiguousarray(x) for x in (m.q, m.dq, m.ddq))
    u = model.input(q, dq, m.raw_tau, m.temp, 0.0, m.t)
    whole = Recording("closed_loop", 0, 0, 0, m.t, q, dq, m.raw_tau)
    return m.raw_tau - left_over(model, whole, u, float("nan"), ddq, window=1)
