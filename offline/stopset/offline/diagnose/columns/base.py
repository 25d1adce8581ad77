"""Rows and columns of the base model, joint by joint: rigid body, rotor, Coulomb and viscous friction, stamps."""

from __future__ import annotations

import numpy as np

from stopset.offline.diagnose.columns.signals import ArmSignals
from stopset.offline.diagnose.rows.rows import JointRows, joint_rows, pose_scatter
from stopset.types import Array


def all_rows(source: ArmSignals) -> list[JointRows]:
    d, Ys = source.data, source.regressor_still
    thin = slice(None, None, max(1, len(d.q) // 500))
    square, phase = source.mass[thin] ** 2, d.phase[thin]
    mean = np.mean(square, axis=0)
    by_phase = [np.mean(square[phase == k], axis=0) if np.any(phase == k) else mean for k in range(len(d.torque_noise))]
    typical = np.sqrt(by_phase) + np.diag(source.robot.rotor)
    scatter = [pose_scatter(Ys[:, j], d.tau_still[:, j]) if len(Ys) else float("inf") for j in range(d.n)]
    return [joint_rows(d, j, typical[:, j], scatter[j]) for j in range(d.n)]


def base_columns(source: ArmSignals, rows: JointRows) -> Array:
    """y (against the description), rigid body, all drives' scale, and the joint's rotor, friction, friction left in the poses, stamps."""
    d, j = source.data, rows.joint
    y = d.tau[:, j] - source.link[:, j] - source.robot.rotor[j] * d.ddq[:, j]
    moving = [y, d.ddq[:, j], d.direction[:, j], d.dq[:, j], np.zeros(len(d.q)), -source.rigid(j).dtau]
    still = np.zeros((len(d.q_still), len(moving)))
    still[:, 0] = d.tau_still[:, j] - (0.0 if source.compensated else 1.0) * source.load_still[:, j]
    still[:, 4] = 1.0
    own = rows.column(np.stack(moving, axis=1), still)
    share = 0.0 if source.compensated else 1.0
    body = rows.column(share * source.regressor[:, j], share * source.regressor_still[:, j])
    rigid = (share * source.link[:, j] + source.robot.rotor[j] * d.ddq[:, j])[:, None]
    scale = rows.column(rigid, share * source.load_still[:, j, None])
    return np.column_stack([own[:, 0], body, scale, own[:, 1:]])


def first_friction(X: Array, sd: Array, known: Array) -> Array:
    """Coulomb and viscous coefficients of a joint fitted alone: the shape of its friction's random scale.

    ``known`` (2,): what was taken off the rows already.
    """
    A = X[:, 1:].T @ X[:, 1:] + np.diag(1.0 / sd**2 + 1e-9)
    theta = np.linalg.lstsq(A, X[:, 1:].T @ X[:, 0], rcond=1e-14)[0]
    out: Array = np.maximum(known + theta[-4:-2], 0.0)
    return out
