"""What the nominal model leaves of a recorded torque; at standstill, what no stiction can hold."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stopset.offline.nominal.delay import lag_weights
from stopset.offline.nominal.friction import dry
from stopset.offline.nominal.nominal import Nominal
from stopset.offline.nominal.normal_equations import friction_columns, moving_rows
from stopset.offline.nominal.preprocess import PreparedMotion, motions
from stopset.recording.types import Recording
from stopset.robot import Robot
from stopset.types import Array


@dataclass(frozen=True, slots=True)
class Residual:
    """Torque left over along one even piece of a trial: ``t`` (N,), ``q, dq, ddq, measured, left`` (N, n), filtered like the fit.

    ``moving`` (N, n): joint out of the stiction band; ``beyond`` (N, n): as ``left``, but where a joint is within that band its dry
    friction is any torque between that of the two directions, and only what is outside counts; ``temp`` (N, n) or None.
    """

    t: Array
    q: Array
    dq: Array
    ddq: Array
    measured: Array
    left: Array
    beyond: Array
    moving: NDArray[np.bool_]
    temp: Array | None


def residuals(nominal: Nominal, robot: Robot, recording: Recording) -> list[Residual]:
    """What the nominal model leaves of a trial's torque; ``robot`` is the description it was identified with."""
    data = nominal.data
    view = robot.with_parameters(data.reference)
    lags = np.array([lag_weights(float(d)) for d in nominal.delay_applied])
    out = []
    for m in motions(recording, data.settings):
        X, moving = moving_rows(data, view, m)
        measured = np.einsum("jkd,jd->kj", X[:, :, -lags.shape[1] :], lags)
        model = np.empty_like(measured)
        for j in range(robot.n):
            index = data.layout.index(j)
            model[:, j] = X[j, :, : len(index)] @ nominal.theta[index]
        left = measured - model
        here, ahead, back = (_dry_torque(nominal, view, m, direction) for direction in (None, 1.0, -1.0))
        held = left + here
        beyond = np.where(moving, left, held - np.clip(held, np.minimum(ahead, back), np.maximum(ahead, back)))
        k = m.retained
        temp = None if m.temp is None else m.temp[k]
        out.append(Residual(m.t[k], m.q[k], m.dq[k], m.ddq[k], measured, left, beyond, moving, temp))
    return out


def _dry_torque(nominal: Nominal, view: Robot, m: PreparedMotion, direction: float | None) -> Array:
    """(rows, n) dry friction of the model along a motion, or while creeping in the direction ``direction``."""
    layout = nominal.data.layout
    columns, _ = friction_columns(layout, view, m, nominal.data.settings.still, direction)
    out = np.zeros((len(m.retained), layout.n))
    for j, mine in enumerate(layout.columns):
        theta = nominal.theta[layout.index(j)[10 * layout.n + 1 :]]
        effects = dict.fromkeys(c.effect for c in mine)
        resisting = np.concatenate([dry(e) for e in effects]) if effects else np.zeros(0, bool)
        for use, value, column in zip(resisting, theta, columns[j], strict=True):
            if use:
                out[:, j] += value * column
    return out
