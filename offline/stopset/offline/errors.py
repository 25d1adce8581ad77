"""Errors of a model on recordings, per joint: torque, velocity and position, beside the measurement's own repeatability."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stopset.artifact import Abstraction
from stopset.offline.rollout import RollOut
from stopset.reach.flowpipe import predict
from stopset.recording import Recording
from stopset.sets import Box

Array = NDArray[np.float64]
Pairs = Callable[[], Iterable[tuple[int, Recording, Array]]]

AVERAGING = 0.2  # [s] torque errors are averages over such windows, a stop's length: momentum balance, no differentiation
TOGETHER = 128  # trials simulated side by side
LONGEST = 5.0  # [s] open-loop predictions are compared up to here


def torque_error(abstraction: Abstraction, dt: float, q: Array, dq: Array, u: Array) -> Array:
    """Torque [N m] that the abstraction lacks, averaged over `AVERAGING`, one row per window, (W, n).

    ``M (dq(T) - dq(0)) + int friction dt = int u dt`` is exact for the model, so nothing is differentiated.
    """
    m = max(1, round(AVERAGING / dt))
    edges = np.arange(0, len(q) - 1, m)
    edges = edges[edges + m < len(q)]
    M = np.linalg.inv(abstraction.Minv)
    friction = sum(abstraction.viscous[:, k] * dq ** (k + 1) for k in range(abstraction.viscous.shape[1]))
    rate = np.asarray(u - friction)
    impulse = np.vstack([np.zeros(q.shape[1]), np.cumsum(rate * dt, axis=0)])
    gained = (dq[edges + m] - dq[edges]) @ M.T
    return np.asarray((gained - (impulse[edges + m] - impulse[edges])) / (m * dt))


class _Sums:
    """Sums of squares per joint and the spread between repetitions of a suite."""

    def __init__(self, n: int) -> None:
        self.torque, self.velocity, self.position = np.zeros(n), np.zeros(n), np.zeros(n)
        self.windows = self.rows = 0
        self.repeats: dict[tuple[str, int], list[Array]] = {}  # count, sum and sum of squares per window of a suite
        self.hull: Box | None = None

    def add_repeat(self, motion: tuple[str, int], e: Array) -> None:
        if motion not in self.repeats:
            self.repeats[motion] = [np.zeros(len(e)), np.zeros_like(e), np.zeros_like(e)]
        count, total, square = self.repeats[motion]
        m = min(len(count), len(e))
        count[:m] += 1
        total[:m] += e[:m]
        square[:m] += e[:m] ** 2

    def add_open_loop(self, r: Recording, x: Array) -> None:
        n = r.q.shape[1]
        self.position += ((x[:, :n] - r.q) ** 2).sum(axis=0)
        self.velocity += ((x[:, n:] - r.dq) ** 2).sum(axis=0)
        self.rows += len(r.t)

    def add_rolled(self, trials: Sequence[Recording], states: Sequence[Array]) -> None:
        for r, x in zip(trials, states, strict=True):
            self.add_open_loop(r, x)

    def floor(self) -> Array | None:
        """RMS deviation from the mean of the repetitions (n,), None without repetitions."""
        freedom, spread = 0.0, np.zeros_like(self.torque)
        for count, total, square in self.repeats.values():
            twice = count >= 2
            freedom += float((count[twice] - 1).sum())
            spread += (square[twice] - total[twice] ** 2 / count[twice, None]).sum(axis=0)
        return np.sqrt(np.maximum(spread, 0.0) / freedom) if freedom > 0 else None


def joint_figures(
    pairs: Pairs, abstraction: Abstraction, joints: tuple[str, ...], dt: float, roll: RollOut | None = None
) -> tuple[dict[str, dict[str, Any]], Box]:
    """Per joint ``torque_rmse, torque_rmse_floor, velocity_rmse, position_rmse`` (SI), and the hull of the inputs seen.

    Velocity and position are those of the open-loop prediction from each trial's start, at most `LONGEST` long; the floor is
    the scatter between repetitions of the same torques, null without repetitions.  ``roll`` simulates effects at the
    simulated state; without it the inputs carry them at the measured one.
    """
    sums = _Sums(len(joints))
    waiting: list[Recording] = []
    for _, r, u in pairs():
        sums.hull = Box.hull(u) if sums.hull is None else sums.hull | Box.hull(u)
        e = torque_error(abstraction, dt, r.q, r.dq, u)
        sums.torque += (e**2).sum(axis=0)
        sums.windows += len(e)
        if r.phase == "open_loop":
            sums.add_repeat(r.motion, e)
        last = min(len(r.t), round(LONGEST / dt) + 1)
        if roll is None:
            sums.add_open_loop(r.cut(0, last), predict(abstraction, dt, np.concatenate([r.q[0], r.dq[0]]), u[:last]))
            continue
        waiting.append(r.cut(0, last))
        if len(waiting) == TOGETHER:
            sums.add_rolled(waiting, roll(waiting, dt))
            waiting = []
    if roll is not None and waiting:
        sums.add_rolled(waiting, roll(waiting, dt))
    floor = sums.floor()
    assert sums.hull is not None
    out = {
        j: {
            "torque_rmse": float(np.sqrt(sums.torque[k] / sums.windows)) if sums.windows else None,
            "torque_rmse_floor": None if floor is None else float(floor[k]),
            "velocity_rmse": float(np.sqrt(sums.velocity[k] / sums.rows)),
            "position_rmse": float(np.sqrt(sums.position[k] / sums.rows)),
        }
        for k, j in enumerate(joints)
    }
    return out, sums.hull
