"""The rows of one joint, made independent: sensor noise whitened within each run, poses beside the moving rows."""

from __future__ import annotations

from dataclasses import dataclass
from math import prod

import numpy as np

from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.rows.noise import Whitening, autocovariance
from stopset.offline.diagnose.rows.prepare import Prepared
from stopset.types import Array, Index

DEPENDENT = 1e-9  # of the largest singular value: rounding


@dataclass(frozen=True, slots=True)
class JointRows:
    """Rows of joint ``j``: ``take`` (K,) rows of `Prepared`; ``trial`` (K + P,) its trial, -1 for poses; ``whiten``: their noise."""

    joint: int
    take: Index
    trial: Index
    whiten: Whitening
    still: int
    still_sd: float

    @property
    def size(self) -> int:
        return len(self.take) + self.still

    def column(self, moving: Array, still: Array | None = None) -> Array:
        """Whitened columns (K + P, k) from row values (N, k) of the whole of `Prepared` and pose values (P, k)."""
        x = np.ascontiguousarray(
            moving[self.take].reshape(len(self.take), prod(moving.shape[1:]))
        )  # of a joint that stands: none
        w = self.whiten(x)
        if not self.still:
            return w
        rest = np.zeros((self.still, w.shape[1])) if still is None else still.reshape(self.still, -1)
        return np.concatenate([w, rest / self.still_sd])

    def accelerated(self, data: Prepared, noise: float) -> float:
        """Sum of squares that white ``noise`` of the position [rad] leaves in the whitened acceleration."""
        power = self.whiten.power(autocovariance(data.kernel, data.step, 0.0, noise))
        return float(power[self.whiten.kind].sum())

    def plain(self, moving: Array) -> Array:
        """The rows' unwhitened values."""
        return moving[self.take]


def joint_rows(data: Prepared, joint: int, inertia: Array, still_sd: float) -> JointRows:
    """Rows of a joint; ``inertia`` (P, n) typical row of the mass matrix with rotor [kg m^2] by phase, for the position's noise."""
    take = np.flatnonzero(data.ok[:, joint])
    jump = np.diff(take, prepend=-2) != 1
    jump |= np.diff(data.trial[take], prepend=-1) != 0
    noises = zip(data.torque_noise[:, joint], np.linalg.norm(inertia * data.position_noise, axis=1), strict=True)
    whiten = Whitening.of(jump, data.phase[take], [autocovariance(data.kernel, data.step, *map(float, n)) for n in noises])
    poses = len(data.q_still) if np.isfinite(still_sd) else 0
    trial = np.concatenate([data.trial[take], np.full(poses, -1)]).astype(np.intp)
    return JointRows(joint, take, trial, whiten, poses, still_sd)


def pose_scatter(Y: Array, tau: Array) -> float:
    """Robust deviation [N m] of the poses' torque from any rigid body's gravity; ``inf`` where there are too few poses."""
    if len(tau) < limit.FEW_POSES:
        return float("inf")
    u, s, _ = np.linalg.svd(Y, full_matrices=False)
    u = u[:, s > DEPENDENT * s[0]] if s[0] > 0 else u[:, :0]
    basis = np.linalg.qr(np.column_stack([u, np.ones(len(tau))]))[0]
    if len(tau) < basis.shape[1] + limit.FEW_POSES:
        return float("inf")
    r = tau - basis @ (basis.T @ tau)
    spread = np.sqrt(len(tau) / (len(tau) - basis.shape[1]))
    return float(max(1.4826 * np.median(np.abs(r)) * spread, 1e-6))
