"""Columns under the names of other joints: a driver lists its joints in an order of its own, and who reads them by number exchanges two.

Friction, offset and rotor of a joint go with its columns; what tells is the rigid body of the description, of which every joint's torque
asks for the angles of all others.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from stopset.offline.inspect.torque_rows import FEWEST, TorqueRows
from stopset.recording.types import Recording
from stopset.robot import Robot
from stopset.robot.rigid import torques
from stopset.types import Array

FALLS = 2.0  # log of the product of all joints' errors by which the other order must be better: e^2
EXPLAINS = 0.3  # of its torque beside friction that the rigid body may leave of one of the joints that are exchanged
STRENGTH = (0.5, 2.0)  # of the described torques, payload and torque constants included
MOST = 2000  # rows that are looked at


@dataclass(frozen=True, slots=True)
class Exchanged:
    """Joints (by number) whose columns stand in each other's place, with their ``motion`` or of torque alone.

    ``better``: the log of all joints' errors that the other order takes away.
    """

    joints: tuple[int, ...]
    motion: bool
    better: float


def exchanged(robot: Robot, trials: Sequence[Recording]) -> Exchanged | None:
    """Another order of the columns of ``trials`` that the description clearly asks for; none where it does not."""
    found = TorqueRows.of(trials)
    if found is None:
        return None
    rows = found.thinned(MOST)
    if (rows.moving.sum(axis=0) < FEWEST).any():
        return None
    n, ours = robot.n, _left(robot, rows)
    best: Exchanged | None = None
    for order in _orders(n):
        changed = np.flatnonzero(order != np.arange(n))
        for motion in (True, False):
            at = order if motion else np.arange(n)
            as_if = TorqueRows(rows.q[:, at], rows.dq[:, at], rows.ddq[:, at], rows.tau[:, order], rows.moving[:, at])
            theirs = _left(robot, as_if)
            better = float(np.log(ours / theirs).sum())
            if theirs[changed].min() < EXPLAINS and better > max(FALLS, best.better if best is not None else 0.0):
                best = Exchanged(tuple(int(k) for k in changed), motion, better)
    return best


def _orders(n: int) -> Iterator[NDArray[np.intp]]:
    """Two joints exchanged, or all in reverse."""
    for a, b in combinations(range(n), 2):
        order = np.arange(n)
        order[[a, b]] = b, a
        yield order
    if n > 3:
        yield np.arange(n)[::-1]


def _left(robot: Robot, rows: TorqueRows) -> Array:
    """(n,) share of each joint's torque beside friction, offset and rotor that the described rigid body leaves, root mean square."""
    rigid = torques(robot.chain, robot.pi, *(np.ascontiguousarray(x) for x in rows[:3]))
    out = np.ones(robot.n)
    for j in range(robot.n):
        x, y = rows.beside_friction(j, np.column_stack([rigid[:, j], rows.tau[:, j]])).T
        size = float(np.clip(x @ y / max(float(x @ x), 1e-12), *STRENGTH))
        out[j] = np.sqrt(np.mean((y - size * x) ** 2) / max(float(np.mean(y**2)), 1e-12))
    return np.maximum(out, 1e-3)
