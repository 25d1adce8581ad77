"""Inertia, damping, offset and effects of each joint from compensated torque, by output error.

For recordings whose torque already is ``u`` of eq. (11) model 1 is one first-order lag per joint,
``J ddq + v dq + offset + effects = u``.  Its parameters are found so that the open-loop simulation from each trial's measured
start fits position and velocity best: the model is simulated, not differentiated.
Source: Liu & Althoff (2018), eq. (13); Ljung, System Identification (1999), sec. 7.2 (output error).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stopset.effects.base import Fitted, Signals
from stopset.offline.nominal.filters import lag
from stopset.offline.nominal.open_loop import DIRECTION_WIDTH, EffectTerm, JointBatch, roll_out
from stopset.types import Array

# a velocity error counts as the way it goes in this time [s]: rad and rad/s are not addable (trap P11)
VELOCITY_TIME = 0.3
ITERATIONS = 15  # of the damped Gauss-Newton steps with effects; they start from the fit without
STARTS = ((1.0, 5.0), (5.0, 20.0), (12.0, 30.0))  # inertia [kg m^2] and damping [N m s] to start from
FEW = 24  # trials that find the way to the minimum; the minimum itself is that of all of them
FAR = 30.0  # of a logarithm
PROGRESS = 1e-5  # relative fall of the cost below which the fit is done
# a joint that hardly moves fits any inertia, as the infinite one explains standing still best of all; where the relative
# standard deviation says so the description's inertia and a drive's usual time constant J / v decide, each within a factor e
UNDETERMINED = 0.5
NOT_FELT = 1e-6  # of the strongest parameter's influence on the simulation: less is a rounded zero
USUAL_TIME = 0.2  # [s]; the joints of a real arm (LWA-4P) have 0.1 to 0.7 s


@dataclass(frozen=True, slots=True)
class JointFit:
    """One joint: values and standard deviations of inertia, damping, offset; its effects; RMS errors of the simulation.

    ``determined``: whether inertia and damping come from the recordings; else they are near the description's.
    """

    inertia: float
    damping: float
    offset: float
    std: tuple[float, float, float]
    effects: tuple[Fitted, ...]
    q_rmse: float
    dq_rmse: float
    determined: bool = True


def fit_joint(batch: JointBatch, joint: str, terms: Sequence[EffectTerm] = (), described: float | None = None) -> JointFit:
    """Fit one joint over all trials of the batch.

    ``described``: inertia of the joint by the robot's description [kg m^2], for a joint that these trials hardly move.
    """
    p = fit_lag(batch)
    determined = described is None or bool(np.all(_spread(batch, (), p)[:2] < UNDETERMINED))
    if not determined:
        p = fit_lag(batch, described)
    if terms:
        p = gauss_newton(batch, terms, start(batch, terms, p, lag_known=not determined), lag_known=not determined)
    return _packed(batch, joint, terms, p, determined=determined)


def fit_lag(batch: JointBatch, described: float | None = None) -> Array:
    """``log J, log v, offset`` without effects: linear filters over the whole batch; ``described``: inertia expected [kg m^2]."""
    from scipy.optimize import least_squares  # half a second, not for who only simulates

    misfit = _lag_misfit(batch)
    if described is not None:
        expected = np.array([np.log(described), np.log(described / USUAL_TIME), 0.0])
        # the trial is the independent unit: what is expected weighs as much as one of them
        weigh = np.sqrt(np.sum(misfit(expected) ** 2) / batch.inside.shape[1])

        def with_expected(p: Array) -> Array:
            return np.concatenate([misfit(p), weigh * np.array([p[0] - expected[0], p[1] - p[0] + np.log(USUAL_TIME)])])

        return np.asarray(least_squares(with_expected, expected, method="lm").x)
    # from afar on the trials that move most, then the last steps on all of them
    few = _lag_misfit(batch.trials(np.argsort(-np.ptp(batch.q, axis=0), kind="stable")[:FEW]))
    near = [least_squares(few, [np.log(J), np.log(v), 0.0], method="lm").x for J, v in STARTS]
    return np.asarray(least_squares(misfit, min(near, key=lambda p: float(np.sum(misfit(p) ** 2))), method="lm").x)


def start(batch: JointBatch, terms: Sequence[EffectTerm], plain: Array, *, lag_known: bool = False) -> Array:
    """Where the fit with ``terms`` begins: the ``plain`` lag found without them, or what the measured motion tells, whichever simulates better.

    A lag found without a strong effect has taken up what it could of it, and from there the fit may end with no inertia at all.
    """
    bounded = (np.clip(plain[:2], -FAR, FAR), plain[2:])
    p = np.concatenate([*bounded, *(np.array(t.given or np.zeros(len(t.effect.terms))) for t in terms)])
    other = None if lag_known else _along_the_measurement(batch, terms)
    starts = [p] if other is None else [p, other]
    return min(starts, key=lambda x: float(np.sum(residuals(batch, terms, x, with_jacobian=False)[0] ** 2)))


def _along_the_measurement(batch: JointBatch, terms: Sequence[EffectTerm]) -> Array | None:
    """``log J, log v, offset`` and terms by least squares on the equation of motion, integrated along the measured motion.

    None where they are no lag's, or an effect has a memory that the measurement does not hold.
    """
    if any(t.effect.states for t in terms):
        return None
    impulse, columns = momentum(batch, terms)
    known = [None, None, None, *(v for t in terms for v in (t.given or (None,) * len(t.effect.terms)))]
    y = impulse - sum(v * columns[:, :, k] for k, v in enumerate(known) if v is not None)
    X = columns[:, :, [k for k, v in enumerate(known) if v is None]][batch.inside]
    size = np.linalg.norm(X, axis=0) + 1e-30
    found = np.linalg.lstsq(X / size, y[batch.inside], rcond=1e-10)[0] / size
    if found[0] <= 0.0 or found[1] <= 0.0:
        return None
    others = iter(found[3:].tolist())
    return np.array([*np.log(found[:2]), found[2], *(next(others) if v is None else v for v in known[3:])])


def momentum(batch: JointBatch, terms: Sequence[EffectTerm]) -> tuple[Array, Array]:
    """Impulse (N, B) [N m s] of the torque since each trial's start, and what ``J, v, offset`` and the terms multiply in it,
    (N, B, 3 + terms), along the measured motion: ``J (dq - dq0) + v (q - q0) + offset t + int effects = int u``."""
    elapsed = batch.dt * np.arange(len(batch.u))[:, None]
    s = Signals(
        q=batch.q, dq=batch.dq, given_direction=np.tanh(batch.dq / DIRECTION_WIDTH), load=batch.load, temp=batch.temp,
        warm=batch.warm, t=elapsed,
    )  # fmt: skip

    def impulse(x: Array) -> Array:  # torques are held over a step, as in the simulation
        held = np.broadcast_to(x, batch.u.shape)[:-1]
        return np.vstack([np.zeros_like(batch.u[:1]), np.cumsum(held * batch.dt, axis=0)])

    columns = [impulse(c) for t in terms for c in t.columns(replace(s, memory=_remembered(batch, t, s)))]
    return impulse(batch.u), np.stack([batch.dq - batch.dq[0], batch.q - batch.q[0], elapsed + 0.0 * batch.q, *columns], axis=2)


def _remembered(batch: JointBatch, term: EffectTerm, s: Signals) -> tuple[Array, ...]:
    """What an effect remembers at every sample of the measured motion, (N, B) each; empty for one without memory."""
    if not term.effect.states:
        return ()
    memory = [term.begun(batch.u.shape[1:])]
    rows = zip(batch.q, batch.dq, np.asarray(s.direction), batch.load, batch.temp, np.asarray(s.t), strict=True)
    for q, dq, direction, load, temp, t in rows:
        now = Signals(q=q, dq=dq, given_direction=direction, load=load, temp=temp, warm=batch.warm, t=t)
        memory.append(term.stepped(replace(now, memory=tuple(memory[-1])), batch.dt))
    return tuple(np.stack(memory[:-1], axis=1))


def _lag_misfit(batch: JointBatch) -> Callable[[Array], Array]:
    """Weighted errors (rows,) of position and velocity, by ``log J, log v, offset``."""
    dt, weight = batch.dt, batch.inside
    impulse = np.cumsum(batch.u * dt, axis=0)
    elapsed = dt * np.arange(len(batch.u))[:, None]

    def misfit(p: Array) -> Array:
        # what hardly moves sends inertia and damping to infinity, where they all fit alike
        (J, v), offset = np.exp(np.clip(p[:2], -FAR, FAR)), p[2]
        decay, gain = np.exp(-v * dt / J), -np.expm1(-v * dt / J) / v
        drive = np.vstack([batch.dq[:1], gain * (batch.u[:-1] - offset)])
        dq = lag(float(decay), drive)
        # J (dq(t) - dq0) + v (q(t) - q0) = int u: position without a second integration
        moved = np.vstack([np.zeros_like(impulse[:1]), impulse[:-1]]) - offset * elapsed
        q = batch.q[0] + (moved - J * (dq - dq[0])) / v
        return np.concatenate([((batch.q - q) * weight).ravel(), (VELOCITY_TIME * (batch.dq - dq) * weight).ravel()])

    return misfit


def residuals(batch: JointBatch, terms: Sequence[EffectTerm], p: Array, *, with_jacobian: bool) -> tuple[Array, Array]:
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


def gauss_newton(
    batch: JointBatch, terms: Sequence[EffectTerm], p: Array, steps: int = ITERATIONS, *, lag_known: bool = False
) -> Array:
    """Levenberg's damped steps from ``p`` (log J, log v, offset, effects' terms) until the cost falls no more.

    ``lag_known``: inertia and damping stay as they are; so do terms whose values are given.
    """
    damping = 1e-3
    known = np.array([lag_known, lag_known, False, *(bool(x.given) for x in terms for _ in x.effect.terms)])
    lo = np.array([-FAR, -FAR, -np.inf] + [t.lo for x in terms for t in x.effect.terms])
    hi = np.array([FAR, FAR, np.inf] + [t.hi for x in terms for t in x.effect.terms])
    for _ in range(steps):
        e, D = residuals(batch, terms, p, with_jacobian=True)
        D[:, known] = 0.0
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


def _spread(batch: JointBatch, terms: Sequence[EffectTerm], p: Array) -> Array:
    """Standard deviations of ``p``: trials, not samples, are independent, so scatter is taken by trial (sandwich).

    Infinite for what the simulation does not depend on.
    """
    e, jacobian = residuals(batch, terms, p, with_jacobian=True)
    size = np.linalg.norm(jacobian, axis=0)
    felt = size > NOT_FELT * size.max()
    scaled = jacobian[:, felt] / size[felt]  # else a weak parameter drowns in the inverse
    N, B = batch.inside.shape
    by_trial = (scaled.reshape(2, N, B, -1) * e.reshape(2, N, B, 1)).sum(axis=(0, 1))
    bread = np.linalg.pinv(scaled.T @ scaled)
    std = np.full(len(p), np.inf)
    std[felt] = np.sqrt(np.maximum(np.diag(bread @ (by_trial.T @ by_trial) @ bread), 0.0)) / size[felt]
    return std


def _packed(batch: JointBatch, joint: str, terms: Sequence[EffectTerm], p: Array, *, determined: bool) -> JointFit:
    e, std = residuals(batch, terms, p, with_jacobian=False)[0], _spread(batch, terms, p)
    if not determined:
        std[:2] = 1.0  # what is expected holds within a factor e
    rows = int(batch.inside.sum())
    q_sum, dq_sum = (float(x @ x) for x in np.split(e, 2))
    effects, at = [], 3
    for term in terms:
        names = [t.symbol for t in term.effect.terms]
        values = dict(zip(names, p[at : at + len(names)].tolist(), strict=True)) | dict(term.shapes)
        admissible = [t.hi - t.lo for t in term.effect.terms]  # all that is known of what these trials do not show
        spread = dict(zip(names, np.minimum(std[at : at + len(names)], admissible).tolist(), strict=True))
        effects.append(Fitted(term.effect.name, joint, values, spread))
        at += len(names)
    J, v = float(np.exp(p[0])), float(np.exp(p[1]))
    return JointFit(
        inertia=J, damping=v, offset=float(p[2]), std=(J * std[0], v * std[1], float(std[2])), effects=tuple(effects),
        q_rmse=float(np.sqrt(q_sum / rows)), dq_rmse=float(np.sqrt(dq_sum / rows) / VELOCITY_TIME),
        determined=determined,
    )  # fmt: skip
