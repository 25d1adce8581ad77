"""The least inertia a joint can have, where recordings determine it too weakly to say.

A drive without a data sheet whose recordings hardly accelerate it may be fitted with any rotor, zero included.  A joint with
friction and next to no inertia then follows its torque within microseconds, which no recording showed.  Two floors are physical:
no drive accelerates a joint faster than `FASTEST` with the torque its description allows, and no speed settles faster than what
the filtered recordings can show.  Where the data do determine the inertia, they are believed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stopset.offline.nominal.friction import ParameterLimits
from stopset.offline.nominal.normal_equations import NormalEquations
from stopset.offline.nominal.preprocess import SLOWEST
from stopset.offline.nominal.prior import Prior
from stopset.robot import Robot
from stopset.robot.rigid import mass_matrix
from stopset.types import Array

FASTEST = 1000.0  # [rad/s^2] at full torque; light geared arms reach some hundred
WEAK = 4.0  # standard errors of the inertia within which the floor may lie above what was fitted
POSES = 40


@dataclass(frozen=True, slots=True)
class Floor:
    """Rows ``A theta >= lower`` for the rotors of some joints, and what each means, in words without numbers of the fit."""

    A: Array
    lower: Array
    joint: tuple[int, ...]
    why: tuple[str, ...]

    def binding(self, theta: Array, covariance: Array) -> Floor:
        """The rows that ``theta`` breaks by no more than `WEAK` of their standard errors: there the data do not decide."""
        short = self.lower - self.A @ theta
        std = np.sqrt(np.einsum("rk,kl,rl->r", self.A, covariance, self.A))
        k = np.flatnonzero((short > 0) & (short <= WEAK * std))
        return Floor(self.A[k], self.lower[k], tuple(self.joint[i] for i in k), tuple(self.why[i] for i in k))

    @property
    def limits(self) -> ParameterLimits:
        return ParameterLimits(self.A, self.lower, np.full(len(self.lower), np.inf))


def floor_of(robot: Robot, data: NormalEquations, prior: Prior) -> Floor:
    """The floors of all joints without a data sheet's rotor that moved."""
    n, layout = robot.n, data.layout
    cutoff = min(data.settings.cutoff, SLOWEST / data.period) if np.isfinite(data.period) else data.settings.cutoff
    settles = 1.0 / (2 * np.pi * cutoff)
    links = least_inertia(robot, data.span)
    rows, lower, joint, why = [], [], [], []
    for j in range(n):
        if prior.rotor_known[j] or not data.rows_moving[:, j].sum():
            continue
        rotor = np.eye(1, layout.size, 10 * n + j)[0]
        limit = float(robot.torque_limit[j])
        if np.isfinite(limit) and limit > 0:
            rows.append(rotor)
            lower.append(limit / FASTEST - links[j])
            joint.append(j)
            why.append(f"its {limit:g} N m would accelerate it by more than {FASTEST:g} rad/s^2")
        row = rotor.copy()
        for place, column in zip(layout.index(j)[10 * n + 1 :], layout.columns[j], strict=True):
            if column.effect.power == 1:
                row[place] = -settles
        rows.append(row)
        lower.append(-links[j])
        joint.append(j)
        why.append(
            f"its speed would settle within less than {settles * 1e3:.2g} ms, which recordings filtered at {cutoff:.3g} Hz do not show"
        )
    return Floor(np.array(rows).reshape(-1, layout.size), np.array(lower), tuple(joint), tuple(why))


def least_inertia(robot: Robot, span: Array) -> Array:
    """(n,) [kg m^2] smallest inertia of the described links about each axis, over poses within ``span`` (n, 2) [rad]."""
    rng = np.random.default_rng(0)
    lo, hi = (np.where(np.isfinite(x), x, 0.0) for x in span.T)
    poses = rng.uniform(lo, hi, (POSES, robot.n))
    least: Array = np.min([np.diag(mass_matrix(robot.chain, robot.pi, q)) for q in poses], axis=0)
    return least
