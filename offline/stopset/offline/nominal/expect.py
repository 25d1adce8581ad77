"""How sure identification would be after recordings that exist only as a plan: the normal matrix needs no torque."""

from __future__ import annotations

import numpy as np

from stopset.offline.nominal.delay import joint_reduced, lag_weights
from stopset.offline.nominal.fit import assemble, problem_of
from stopset.offline.nominal.normal_equations import TOGETHER, NormalEquations
from stopset.offline.nominal.prior import Prior
from stopset.types import Array


def expected_covariance(data: NormalEquations, prior: Prior, sigma: Array) -> Array:
    """(size, size) covariance of all parameters for a torque noise ``sigma`` (n,) [N m] per filtered sample.

    Samples hang together over half a second, poses are independent: see `stopset.offline.nominal.fit`.
    """
    lags = lag_weights(0.0)
    moving, still = joint_reduced(data.moving.sum(axis=0), lags), joint_reduced(data.still, lags)
    rows, rows_still = data.rows_moving.sum(axis=0), data.rows_still
    p = problem_of(data.layout, moving, still, rows, rows_still)
    w = np.where(rows > 0, 1 / (sigma**2 * TOGETHER), 0.0)
    w_still = np.where(rows_still > 0, 1 / sigma**2, 0.0)
    H, _ = assemble(p, w, w_still, prior.precision, prior.mean)
    return np.asarray(np.linalg.inv(H))
