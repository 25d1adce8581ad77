"""Torque that the recordings leave open: what the uncertainty of the nominal model's own numbers amounts to.

Few recordings are explained by many numbers, and sets that only enclose what was recorded then come out too narrow: the fewer
motions, the narrower.  So a torque set is never narrower than twice the standard error of the nominal torque, at 95 % of states
as they were recorded, joint by joint, but recombined across joints and times.  With enough motions to calibrate the margin on
unseen ones nothing is widened: what the numbers leave open is then in the margin.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from stopset.artifact import UncertaintySets
from stopset.effects.selection import base
from stopset.effects.signals import Samples, arm_signals
from stopset.offline.nominal import Nominal
from stopset.recording import Recording
from stopset.robot import Robot
from stopset.robot.rigid import regressors
from stopset.sets import Box
from stopset.types import Array

ERRORS = 2.0  # standard errors that a torque set holds at least
SHARE = 0.95  # of the recombined states at which it does
STATES = 400  # recombined states looked at
SPAN = 0.1  # [s] over which accelerations are taken
FELT = 0.1  # of the torque that the model leaves: what its numbers leave open by less is not worth a word
DIGITS = 5


def recombined(sample: Iterable[Recording]) -> tuple[Array, Array, Array]:
    """``q, dq, ddq`` (`STATES`, n): of each joint as recorded at some time, each joint's time another one."""
    rows = []
    for r in sample:
        m = max(1, round(SPAN / float(np.median(np.diff(r.t)))))
        if len(r.t) > m:
            ddq = (r.dq[m:] - r.dq[:-m]) / (r.t[m:] - r.t[:-m])[:, None]
            rows.append(np.stack([r.q[m // 2 :][: len(ddq)], r.dq[m // 2 :][: len(ddq)], ddq]))
    x = np.concatenate(rows, axis=1)
    rng = np.random.default_rng(0)
    at = rng.integers(0, x.shape[1], (STATES, x.shape[2]))
    q, dq, ddq = (np.take_along_axis(s, at, axis=0) for s in x)
    return q, dq, ddq


def of_regression(robot: Robot, nominal: Nominal, sample: Sequence[Recording]) -> Array:
    """(n,) [N m] for a nominal model regressed with all its correlations; ``robot`` as described."""
    q, dq, ddq = recombined(sample)
    layout, n = nominal.data.layout, robot.n
    needs = {s for cs in layout.columns for c in cs for s in c.effect.needs}
    signals = arm_signals(robot, Samples(q, dq, ddq), needs or {"dq"})
    Y = regressors(robot.chain, q, dq, ddq)
    out = np.empty(n)
    for j, columns in enumerate(layout.columns):
        friction = [np.broadcast_to(c, len(q)) for e in dict.fromkeys(c.effect for c in columns) for c in e.columns(signals[j])]
        X = np.column_stack([Y[:, j], ddq[:, j], *friction])
        at = layout.index(j)
        variance = np.einsum("ka,ab,kb->k", X, nominal.covariance[np.ix_(at, at)], X)
        out[j] = ERRORS * np.sqrt(np.quantile(variance, SHARE))
    return out


def left_open(robot: Robot, nominal: Nominal, sample: Sequence[Recording]) -> Array:
    """(13 n, k) what the recordings leave open of the nominal model's own numbers: links' parameters (10 n), rotors, Coulomb and viscous
    friction (n each) may be off together along each column, one standard deviation.

    A joint's numbers err against each other, and those of a body that was hardly moved are the description's, so this is told as a whole: other
    motions than these show it, and it is no change of the arm.  Columns whose torque is `FELT` at states as they were recorded, recombined.
    """
    q, dq, ddq = recombined(sample)
    n = robot.n
    friction = [[_place(nominal, j, name) for j in range(n)] for name in base()]
    at = np.concatenate([np.arange(11 * n), *friction]).astype(np.intp)
    covariance = nominal.covariance[np.ix_(at, at)]
    size = np.sqrt(np.maximum(np.diag(covariance), 1e-30))
    w, V = np.linalg.eigh(covariance / np.outer(size, size))
    F = size[:, None] * V * np.sqrt(np.maximum(w, 0.0))
    Y = regressors(robot.chain, q, dq, ddq)
    felt = np.zeros((F.shape[1], F.shape[1]))
    for j in range(n):
        torque = along(F, j, Y[:, j], own_columns(dq[:, j], ddq[:, j]))
        felt += torque.T @ torque / (len(q) * max(float(nominal.rms[j]), 1e-9) ** 2)
    share, turn = np.linalg.eigh(felt)
    F = (F @ turn)[:, share > FELT**2]
    scale = 10.0 ** (DIGITS - 1 - np.floor(np.log10(np.maximum(np.abs(F), 1e-300))))
    return np.asarray(np.round(F * scale) / scale)


def along(directions: Array, joint: int, body: Array, own: Array) -> Array:
    """(K, k) a joint's torque along ``directions`` (13 n, k) of a model's numbers, which stand as in `left_open`.

    ``body`` (K, 10 n), ``own`` (K, 3): torque per unit of the links' parameters, and of the joint's rotor and friction (`own_columns`), both
    in N m or both whitened.
    """
    n = len(directions) // 13
    return np.asarray(body @ directions[: 10 * n] + own @ directions[10 * n + joint :: n])


def own_columns(dq: Array, ddq: Array) -> Array:
    """(K, 3) [N m] torque per unit of a joint's rotor inertia, Coulomb and viscous friction; ``dq, ddq`` (K,)."""
    return np.column_stack([ddq, np.sign(dq), dq])


def _place(nominal: Nominal, joint: int, effect: str) -> int:
    """Where the number of a joint's ``effect`` stands among all parameters."""
    layout = nominal.data.layout
    at = layout.index(joint)[10 * layout.n + 1 :]
    return next(int(k) for k, c in zip(at, layout.columns[joint], strict=True) if c.effect.name == effect)


def of_lags(std: Array, sample: Sequence[Recording]) -> Array:
    """(n,) [N m] for one lag per joint; ``std`` (n, 3): of inertia, damping and offset."""
    _, dq, ddq = recombined(sample)
    variance = (ddq * std[:, 0]) ** 2 + (dq * std[:, 1]) ** 2 + std[:, 2] ** 2
    return np.asarray(ERRORS * np.sqrt(np.quantile(variance, SHARE, axis=0)))


def widened(sets: UncertaintySets, uncertain_torque: Array) -> UncertaintySets:
    """``sets`` with U of each joint at least ``uncertain_torque`` (n,) [N m] to both sides of its centre."""
    lack = np.maximum(uncertain_torque - sets.U.radius, 0.0)
    if not lack.any():
        return sets
    if sets.zonotope is None:
        return replace(sets, U=Box(sets.U.lo - lack, sets.U.hi + lack))
    z = replace(sets.zonotope, generators=np.hstack([sets.zonotope.generators, np.diag(lack)[:, lack > 0.0]]))
    return replace(sets, U=z.set.box, zonotope=z)


def notes(before: UncertaintySets, after: UncertaintySets, joints: tuple[str, ...]) -> list[str]:
    """What was widened, in words."""
    return [
        f"undetermined: these recordings leave the torque of {j} open by {after.U.radius[k]:.3g} N m, more than they were seen to "
        f"deviate; U was widened from {before.U.width[k]:.3g} to {after.U.width[k]:.3g} N m: record more motions"
        for k, j in enumerate(joints)
        if after.U.width[k] > before.U.width[k]
    ]
