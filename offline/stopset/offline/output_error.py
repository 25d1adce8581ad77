"""Inertia and damping of each joint from compensated torque, by output error: the model is simulated, not differentiated.

For recordings whose torque already is ``u`` of eq. (11) model 1 is one first-order lag per joint,
``J ddq + v dq = u - o``; ``J``, ``v`` and the offset ``o`` are found so that the simulation from each trial's measured
start fits position and velocity best.  Source: Liu & Althoff (2018), eq. (13); Ljung, System Identification (1999), sec. 7.2 (output error).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.signal import lfilter

from stopset.recording import Recording

Array = NDArray[np.float64]

# a velocity error counts as the way it goes in this time [s]: rad and rad/s are not addable (trap P11)
VELOCITY_TIME = 0.3


@dataclass(frozen=True, slots=True)
class OutputError:
    """Per joint (n,): inertia [kg m^2], damping [N m s/rad], offset [N m], their standard deviations, RMSE of q and dq."""

    inertia: Array
    damping: Array
    offset: Array
    inertia_std: Array
    damping_std: Array
    offset_std: Array
    q_rmse: Array
    dq_rmse: Array


def simulate_joint(J: float, v: float, dt: float, q0: float, dq0: float, u: Array) -> tuple[Array, Array]:
    """Exact response of ``J ddq + v dq = u`` to a held input: ``q, dq`` (N,) from ``q0, dq0``."""
    decay = np.exp(-v * dt / J)
    gain = -np.expm1(-v * dt / J) / v if v > 1e-12 else dt / J
    drive = np.empty_like(u)
    drive[0] = dq0
    drive[1:] = gain * u[:-1]
    dq = lfilter([1.0], [1.0, -decay], drive)
    # J (dq(t) - dq0) + v (q(t) - q0) = int u: position without a second integration
    impulse = np.concatenate([[0.0], np.cumsum(u[:-1]) * dt])
    if v > 1e-6:
        return q0 + (impulse - J * (dq - dq0)) / v, dq
    return q0 + np.concatenate([[0.0], np.cumsum(0.5 * (dq[1:] + dq[:-1])) * dt]), dq


def fit_output_error(trials: Sequence[Recording], dt: float) -> OutputError:
    """Fit every joint of the trials (all sampled every ``dt`` [s], torque = compensated torque ``u``)."""
    n = trials[0].q.shape[1]
    figures = np.array([_fit_joint([(r.q[:, j], r.dq[:, j], r.tau[:, j]) for r in trials], dt) for j in range(n)])
    return OutputError(*(figures[:, k].copy() for k in range(8)))


def _fit_joint(signals: list[tuple[Array, Array, Array]], dt: float) -> tuple[float, ...]:
    def errors(p: Array) -> list[tuple[Array, Array]]:
        J, v, offset = np.exp(p[0]), np.exp(p[1]), p[2]
        out = []
        for q, dq, u in signals:
            qs, ds = simulate_joint(J, v, dt, float(q[0]), float(dq[0]), u - offset)
            out.append((q - qs, VELOCITY_TIME * (dq - ds)))
        return out

    def residuals(p: Array) -> Array:
        return np.concatenate([np.concatenate(pair) for pair in errors(p)])

    starts = ((1.0, 5.0), (5.0, 20.0), (12.0, 30.0))
    fits = (least_squares(residuals, [np.log(J), np.log(v), 0.0], method="lm") for J, v in starts)
    best = min(fits, key=lambda r: float(r.cost))
    e = errors(best.x)
    # trials, not samples, are independent: scatter by trial (sandwich), not by row
    edges = np.cumsum([0] + [2 * len(s[0]) for s in signals])
    flat = residuals(best.x)
    scores = np.stack([best.jac[a:b].T @ flat[a:b] for a, b in zip(edges[:-1], edges[1:], strict=True)])
    bread = np.linalg.pinv(best.jac.T @ best.jac)
    std = np.sqrt(np.diag(bread @ (scores.T @ scores) @ bread))
    J, v, offset = float(np.exp(best.x[0])), float(np.exp(best.x[1])), float(best.x[2])
    rmse = [float(np.sqrt(np.mean(np.concatenate([pair[k] for pair in e]) ** 2))) for k in (0, 1)]
    return J, v, offset, J * std[0], v * std[1], std[2], rmse[0], rmse[1] / VELOCITY_TIME
