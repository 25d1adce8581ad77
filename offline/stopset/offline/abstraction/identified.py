"""The abstraction of an identified arm: its viscous effects and the poses it was recorded in."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from stopset.artifact import Abstraction
from stopset.effects.base import Fitted
from stopset.effects.registry import get
from stopset.offline.abstraction.choose import ModelCandidate, best_first, prediction_error
from stopset.offline.abstraction.models import build
from stopset.robot import Robot
from stopset.robot.rigid import mass_matrix
from stopset.types import Array

HORIZON = 1.0  # [s] predictions are compared up to here
ORDERS = {1: (1, 3), 2: (3, 5, 12), 3: (1, 3, 5)}  # tried where none is asked for; 12 is exact for six joints
# where the linear model's sets say too little: model and order that are tried, in this order, and the share by which one must lower the
# torque it lacks, and its tube after 0.1 s, in the geometric mean over joints
LADDER, WORTH = ((2, 3), (3, 3)), 0.2


def friction_polynomial(joints: Sequence[str], effects: Sequence[Fitted]) -> Array:
    """(n, 1 or 3) coefficients of ``dq, dq^2, dq^3`` [N m (s/rad)^k]; linear damping is kept from driving (>= 0).

    The other effects are taken off the input.
    """
    v: Array = np.zeros((len(joints), 3))
    for f in effects:
        effect = get(f.effect)
        if effect.power and f.joint is not None:
            v[list(joints).index(f.joint), effect.power - 1] += f.values.get(effect.terms[0].symbol, 0.0)
    v[:, 0] = np.maximum(v[:, 0], 0.0)
    return v if np.any(v[:, 1:]) else v[:, :1]


@dataclass(frozen=True, slots=True)
class IdentifiedArm:
    """An arm with its identified numbers, and where it was recorded.

    ``rotor``: (n,) [kg m^2]; ``poses``: (N, n) [rad]; ``standstill``: (n,) speed below which a joint counts as still [rad/s].
    """

    robot: Robot
    rotor: Array
    effects: Sequence[Fitted]
    poses: Array
    standstill: Array | None = None


def abstract(arm: IdentifiedArm, kind: int, order: int) -> Abstraction:
    """The abstraction of ``kind`` and ``order`` for an identified arm.

    The mean of its poses is the expansion point, and models 1 and 2 take the mean of the mass matrix over them in place of
    that at one pose.
    """
    robot, poses = arm.robot, arm.poses
    q_a = np.asarray(poses).mean(axis=0)
    model = build(kind, order, robot, arm.rotor, friction_polynomial(robot.joints, arm.effects), q_a=q_a)
    if kind != 3:
        M = np.mean([mass_matrix(robot.chain, robot.pi, q) for q in poses], axis=0) + np.diag(arm.rotor)
        model = replace(model, Minv=np.linalg.inv(M))
    return model if arm.standstill is None else replace(model, standstill=arm.standstill)


class Chosen(NamedTuple):
    """An abstraction, and why this order."""

    abstraction: Abstraction
    note: str


def candidates(robot: Robot, effects: Sequence[Fitted], kind: int) -> tuple[int, ...]:
    """The orders that are worth comparing: model 1 with linear friction has no other than 1."""
    bent = friction_polynomial(robot.joints, effects).shape[1] > 1
    return ORDERS[kind] if bent or kind != 1 else (1,)


def best_order(
    arm: IdentifiedArm, kind: int, orders: Sequence[int], seen: Callable[[Abstraction], Sequence[tuple[Array, Array]]], dt: float
) -> Chosen:
    """The abstraction of ``kind`` and that of ``orders`` which predicts ``seen`` trials best.

    ``seen``: for an abstraction, states (N, 2n) and its inputs (N, n) every ``dt`` [s]: what a model holds itself, its input
    must not be freed from (cubic friction is part of order 3 and taken off the input of order 1).
    """
    models = [abstract(arm, kind, p) for p in orders]
    if len(models) == 1:
        return Chosen(models[0], f"model {kind} of order {models[0].order}")
    found = best_first([ModelCandidate(m, prediction_error(m, seen(m), dt, HORIZON)) for m in models], HORIZON)
    table = ", ".join(f"order {c.abstraction.order}: {_error(c.error)}" for c in found)
    return Chosen(found[0].abstraction, f"model {kind}: order {found[0].abstraction.order} by prediction error ({table})")


def _error(rad: float) -> str:
    """An angle that is wrong by more than a turn is none."""
    return f"{1e3 * rad:.2f} mrad" if rad < 2 * np.pi else "runs away"
