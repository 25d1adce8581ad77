"""Whether the torque shows the rotors, and how far the inertia about each axis may be off.

U holds what the identified numbers are wrong by at the accelerations that were recorded.  Brakes decelerate an arm several times as
hard, so a stop needs this error for itself.  Torque that is measured behind the gears (joint torque sensors, a controller's estimate of
what moves the links) holds no rotor at all, while brakes have to stop the rotors too: there a data sheet's rotors belong into the
stops and not into the torque, and without one nothing is known of them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from stopset.effects.base import Fitted
from stopset.effects.bound import SIGMAS
from stopset.effects.registry import get
from stopset.offline.nominal.fit import Fit
from stopset.offline.nominal.prior import Prior
from stopset.robot import Robot
from stopset.robot.rigid import mass_matrices, regressors
from stopset.types import Array

POSES = 100
FAR = 0.7  # of the data sheet's rotor: a drive is off its sheet by a few percent


def far_below(prior: Prior, fitted: Fit) -> bool:
    """Whether half of the rotors that a data sheet states come out so small that they may not be in the torque at all."""
    known = np.flatnonzero(prior.rotor_known) + 10 * len(prior.rotor_known)
    return len(known) > 0 and 2 * int(np.sum(fitted.theta[known] < FAR * prior.mean[known])) >= len(known)


def contradicted(prior: Prior, free: Fit) -> bool:
    """Whether a fit ``free`` of the data sheet shows no rotors, and surely not the stated one at half of the joints that have one."""
    n = len(prior.rotor_known)
    at = slice(10 * n, 11 * n)
    rotor, std = free.theta[at], np.sqrt(np.diag(free.covariance)[at])
    known = np.array(prior.rotor_known)
    off = (prior.mean[at] - rotor > SIGMAS * std)[known]
    return not by_most(shown(rotor, std)) and 2 * int(off.sum()) >= len(off)


def shown(rotor: Array, std: Array) -> NDArray[np.bool_]:
    """(n,) whether torque tells a ``rotor`` (n,) from none, by its standard error ``std``."""
    return rotor > SIGMAS * std


def by_most(shows: NDArray[np.bool_]) -> bool:
    """Whether half of the joints show something: of seven joints behind the gears one does by chance, or by an error of the model."""
    return 2 * int(shows.sum()) >= len(shows)


def rotors_shown(theta: Array, covariance: Array, n: int) -> bool:
    """Whether the torque of half of the joints tells their rotors from none: torque behind the gears does not."""
    at = np.arange(10 * n, 11 * n)
    return by_most(shown(theta[at], np.sqrt(np.diag(covariance)[at])))


def inertia_std(robot: Robot, covariance: Array, span: Array) -> Array:
    """(n,) [kg m^2] standard error of ``M_ii + J_rotor,i``, the largest over poses within the recorded angles ``span`` (n, 2)."""
    n, q = robot.n, _poses(span)
    still = np.zeros_like(q)
    gravity = regressors(robot.chain, q, still, still)
    out = np.empty(n)
    for j in range(n):
        turning = still.copy()
        turning[:, j] = 1.0
        row = (regressors(robot.chain, q, still, turning) - gravity)[:, j]
        at = np.r_[0 : 10 * n, 10 * n + j]
        X = np.column_stack([row, np.ones(POSES)])
        out[j] = np.sqrt(np.einsum("ka,ab,kb->k", X, covariance[np.ix_(at, at)], X).clip(min=0.0).max())
    return out


def with_scales(std: Array, robot: Robot, rotor: Array, effects: Sequence[Fitted], span: Array) -> Array:
    """(n,) [kg m^2] `inertia_std` with what the scale of a drive's torque, an effect of ``effects``, is uncertain by itself: as much of the
    inertia about its axis, as identified (``robot``, ``rotor``)."""
    out, q = np.array(std, float), _poses(span)
    for f in effects:
        effect = get(f.effect)
        if effect.enters == "input_gain":
            e = effect.terms[0].symbol
            for j in effect.acts_on(f.joint, robot.joints):
                inertia = rotor[j] + mass_matrices(robot.chain, robot.pi, q)[:, j, j].max()
                out[j] = np.hypot(out[j], f.std.get(e, 0.0) / (1.0 + f.values[e]) * inertia)
    return out


def _poses(span: Array) -> Array:
    """(POSES, n) [rad] drawn within the recorded angles ``span`` (n, 2)."""
    lo, hi = (np.where(np.isfinite(x), x, 0.0) for x in span.T)
    return np.random.default_rng(0).uniform(lo, hi, (POSES, len(span)))


def unseen_rotors(robot: Robot) -> str:
    """What is to be told where no rotor is in the torque; ``robot``: as described."""
    missing = [j for j, d in zip(robot.joints, robot.drives, strict=True) if not np.isfinite(d.rotor_inertia)]
    seen = (
        "the torque of most joints shows no inertia of a rotor, as torque does that is measured behind the gears (joint torque sensors), or that of "
        "motions too slow to tell: what brakes have to stop may not be in it"
    )
    if not missing:
        return f"{seen}; the rotors of robot.json count for stops alone"
    return (
        f"{seen}, so no stop is bounded; state reflected_motor_inertia_kgm2 of {', '.join(missing)} in robot.json (0 where there is none) and "
        "identify again"
    )
