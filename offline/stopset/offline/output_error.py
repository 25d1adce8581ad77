"""Inertia, damping, offset and effects of each joint from compensated torque, by output error.

For recordings whose torque already is ``u`` of eq. (11) model 1 is one first-order lag per joint,
``J ddq + v dq + offset + effects = u``.  Its parameters are found so that the open-loop simulation from each trial's measured
start fits position and velocity best: the model is simulated, not differentiated.
Source: Liu & Althoff (2018), eq. (13); Ljung, System Identification (1999), sec. 7.2 (output error).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.signal import lfilter

from stopset.effects.base import Fitted
from stopset.offline.rollout import EffectTerm, JointBatch, roll_out

Array = NDArray[np.float64]

# a velocity error counts as the way it goes in this time [s]: rad and rad/s are not addable (trap P11)
VELOCITY_TIME = 0.3
ITERATIONS = 15  # of the damped Gauss-Newton steps with effects; they start from the fit without
PROGRESS = 1e-5  # relative fall of the cost below which the fit is done


@dataclass(frozen=True, slots=True)
class JointFit:
    """One joint: values and standard deviations of inertia, damping, offset; its effects; RMS errors of the simulation."""

    inertia: float
    damping: float
    offset: float
    std: tuple[float, float, float]
    effects: tuple[Fitted, ...]
    q_rmse: float
    dq_rmse: float


def fit_joint(batch: JointBatch, joint: str, terms: Sequence[EffectTerm] = ()) -> JointFit:
    """Fit one joint over all trials of the batch."""
    base = fit_lag(batch)
    columns = sum(len(t.effect.terms) for t in terms)
    p = np.concatenate([base, np.zeros(columns)])
    if columns:
        p = gauss_newton(batch, terms, p)
    e, jacobian = residuals(batch, terms, p, with_jacobian=True)
    return _packed(batch, joint, terms, p, e, jacobian)


def fit_lag(batch: JointBatch) -> Array:
    """``log J, log v, offset`` without effects: linear filters over the whole batch."""
    dt, weight = batch.dt, batch.inside
    impulse = np.cumsum(batch.u * dt, axis=0)
    elapsed = dt * np.arange(len(batch.u))[:, None]

    def misfit(p: Array) -> Array:
        J, v, offset = np.exp(p[0]), np.exp(p[1]), p[2]
        decay, gain = np.exp(-v * dt / J), -np.expm1(-v * dt / J) / v
        drive = np.vstack([batch.dq[:1], gain * (batch.u[:-1] - offset)])
        dq = lfilter([1.0], [1.0, -decay], drive, axis=0)
        # J (dq(t) - dq0) + v (q(t) - q0) = int u: position without a second integration
        moved = np.vstack([np.zeros_like(impulse[:1]), impulse[:-1]]) - offset * elapsed
        q = batch.q[0] + (moved - J * (dq - dq[0])) / v
        return np.concatenate([((batch.q - q) * weight).ravel(), (VELOCITY_TIME * (batch.dq - dq) * weight).ravel()])

    starts = ((1.0, 5.0), (5.0, 20.0), (12.0, 30.0))
    fits = [least_squares(misfit, [np.log(J), np.log(v), 0.0], method="lm") for J, v in starts]
    return np.asarray(min(fits, key=lambda r: float(r.cost)).x)


def residuals(batch: JointBatch, terms: Sequence[EffectTerm], p: Array, with_jacobian: bool) -> tuple[Array, Array]:
    """Weighted residuals (rows,) and their Jacobian (rows, parameters) by forward differences, one batched simulation."""
    step = 1e-4 * np.maximum(1.0, np.abs(p))
    P = np.vstack([p, p + np.diag(step)]) if with_jacobian else p[None, :]
    Q, DQ = roll_out(batch, np.exp(P[:, 0]), np.exp(P[:, 1]), P[:, 2:], terms)
    e = np.concatenate(
        [
            ((batch.q - Q) * batch.inside).reshape(len(P), -1),
            (VELOCITY_TIME * (batch.dq - DQ) * batch.inside).reshape(len(P), -1),
        ],
        axis=1,
    )
    return e[0], ((e[1:] - e[0]) / step[: len(e) - 1, None]).T


def gauss_newton(batch: JointBatch, terms: Sequence[EffectTerm], p: Array, steps: int = ITERATIONS) -> Array:
    """Levenberg's damped steps from ``p`` (log J, log v, offset, effects' terms) until the cost falls no more."""
    damping = 1e-3
    lo = np.array([-np.inf] * 3 + [t.lo for x in terms for t in x.effect.terms])
    hi = np.array([np.inf] * 3 + [t.hi for x in terms for t in x.effect.terms])
    for _ in range(steps):
        e, D = residuals(batch, terms, p, with_jacobian=True)
        cost, A, g = float(e @ e), D.T @ D, D.T @ e
        for _ in range(6):
            trial = np.clip(p - np.linalg.solve(A + damping * np.diag(np.diag(A) + 1e-12), g), lo, hi)
            new = residuals(batch, terms, trial, with_jacobian=False)[0]
            if float(new @ new) < cost:
                damping = max(damping / 5.0, 1e-9)
                break
            damping *= 5.0
        else:
            return p
        p = trial
        if cost - float(new @ new) < PROGRESS * cost:
            return p
    return p


def _packed(batch: JointBatch, joint: str, terms: Sequence[EffectTerm], p: Array, e: Array, jacobian: Array) -> JointFit:
    N, B = batch.inside.shape
    # trials, not samples, are independent: scatter by trial (sandwich), not by row
    by_trial = (jacobian.reshape(2, N, B, -1) * e.reshape(2, N, B, 1)).sum(axis=(0, 1))
    bread = np.linalg.pinv(jacobian.T @ jacobian)
    std = np.sqrt(np.maximum(np.diag(bread @ (by_trial.T @ by_trial) @ bread), 0.0))
    rows = int(batch.inside.sum())
    q_sum, dq_sum = (float(x @ x) for x in np.split(e, 2))
    effects, at = [], 3
    for term in terms:
        names = [t.symbol for t in term.effect.terms]
        values = dict(zip(names, p[at : at + len(names)].tolist(), strict=True)) | dict(term.shapes)
        spread = dict(zip(names, std[at : at + len(names)].tolist(), strict=True))
        effects.append(Fitted(term.effect.name, joint, values, spread))
        at += len(names)
    J, v = float(np.exp(p[0])), float(np.exp(p[1]))
    return JointFit(
        inertia=J, damping=v, offset=float(p[2]), std=(J * std[0], v * std[1], float(std[2])), effects=tuple(effects),
        q_rmse=float(np.sqrt(q_sum / rows)), dq_rmse=float(np.sqrt(dq_sum / rows) / VELOCITY_TIME),
    )  # fmt: skip
