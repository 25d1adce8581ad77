"""How the arm is mounted, told by its torque: a robot on a wall or a ceiling whose description stands on the floor.

A torque of gravity is linear in gravity itself, so that the direction that recordings ask for comes out of three unknowns, beside
friction, offset and rotor of each joint.  Masses take their part of the blame only as far as they are the description's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stopset.offline.inspect.torque_rows import FEWEST, TorqueRows
from stopset.recording.types import Recording
from stopset.robot import Robot
from stopset.robot.rigid import moment_arms, torques
from stopset.types import Array

TURNED = 0.35  # [rad] more than a tilt that `diagnose` would name
ROUNDS = 5  # of weighing the joints by what they leave
FALLS = 2.0  # log of the product of all joints' errors by which the other direction must be better: e^2
STANDS = 0.3  # of the torque less inertia and friction that it may leave: else something else is wrong, too
STRENGTH = (0.6, 1.6)  # of gravity's size that comes out, payload and torque constants included
PLUMB = 0.035  # [rad] from an axis of the base frame: along it, as brackets are made


@dataclass(frozen=True, slots=True)
class Mounting:
    """Gravity [m/s^2] (3,) in the base frame that the torque asks for, of the described size, ``angle`` [rad] from the described one."""

    gravity: Array
    angle: float


def mounting(robot: Robot, trials: Sequence[Recording]) -> Mounting | None:
    """Another mounting than described that the torque of ``trials`` clearly asks for; none where it does not."""
    parts = _parts(robot, trials)
    described = np.array(robot.chain.gravity)
    size = float(np.linalg.norm(described))
    if not parts or size == 0.0:
        return None
    theirs, _ = _left(parts, described[:, None])
    ours, asked = _left(parts, np.eye(3))
    found = float(np.linalg.norm(asked))
    if not STRENGTH[0] * size < found < STRENGTH[1] * size:
        return None
    angle = float(np.arccos(np.clip(asked @ described / (found * size), -1.0, 1.0)))
    whole = np.sqrt([float(np.mean(y**2)) for _, y in parts])
    better = float(np.log(theirs / ours).sum())
    if angle < TURNED or better < FALLS or ours.sum() > STANDS * whole.sum():
        return None
    along = int(np.argmax(np.abs(asked)))
    if abs(asked[along]) > np.cos(PLUMB) * found:
        asked = found * np.sign(asked[along]) * np.eye(3)[along]
    return Mounting(size / found * asked, angle)


def _parts(robot: Robot, trials: Sequence[Recording]) -> list[tuple[Array, Array]]:
    """Per joint that moves, gravity's moments (rows, 3) and the torque less inertia (rows,), friction, offset and rotor projected out of both."""
    rows = TorqueRows.of(trials)
    if rows is None:
        return []
    q, pi, chain = rows.q, robot.pi, robot.chain
    rest = np.zeros_like(q)
    inertial = torques(chain, pi, q, rows.dq, rows.ddq) - torques(chain, pi, q, rest, rest)
    _, moment = moment_arms(chain, pi, q)
    out = []
    for j in range(robot.n):
        if rows.moving[:, j].sum() < FEWEST:
            continue
        both = rows.beside_friction(j, np.column_stack([-moment[:, j], rows.tau[:, j] - inertial[:, j]]))
        out.append((both[:, :3], both[:, 3]))
    return out


def _left(parts: Sequence[tuple[Array, Array]], directions: Array) -> tuple[Array, Array]:
    """(joints,) what gravity along ``directions`` (3, k), as strong as they ask, leaves of each joint [N m]; that gravity (3,)."""
    weight = np.ones(len(parts))
    left, gravity = weight, np.zeros(3)
    for _ in range(ROUNDS):
        A = sum(w * (X @ directions).T @ (X @ directions) for w, (X, _) in zip(weight, parts, strict=True))
        b = sum(w * (X @ directions).T @ y for w, (X, y) in zip(weight, parts, strict=True))
        strength = np.linalg.lstsq(np.asarray(A), np.asarray(b), rcond=1e-9)[0]
        gravity = directions @ (
            strength if len(strength) > 1 else np.maximum(strength, 0.0)
        )  # what is described does not pull upwards
        left = np.maximum([float(np.sqrt(np.mean((y - X @ gravity) ** 2))) for X, y in parts], 1e-9)
        weight = left**-2
    return left, gravity
