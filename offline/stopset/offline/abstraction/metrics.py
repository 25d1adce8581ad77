"""Errors of a model on recordings, per joint: torque, velocity and position, beside the measurement's own repeatability."""

from __future__ import annotations

from typing import Any

import numpy as np

from stopset.artifact import Abstraction
from stopset.offline.campaign.trials import Pairs
from stopset.offline.nominal.open_loop import RollOut
from stopset.reach.predict import predict
from stopset.recording import Recording, SuiteKey
from stopset.sets import Box
from stopset.types import Array

AVERAGING = (
    0.2  # [s] torque errors and deviations are averages over such windows, a stop's length: momentum balance, no differentiation
)
# trap P11: rad and rad/s are not addable. A velocity counts as the way it goes within a typical stop.
STOP_TIME = 0.2  # [s]
KINDS = ("torque", "velocity", "position")
TOGETHER = 128  # trials simulated side by side
REPEATED = ("torque", "position")  # whose scatter between repetitions is known
LONGEST = 5.0  # [s] open-loop predictions are compared up to here


def torque_error(abstraction: Abstraction, dt: float, q: Array, dq: Array, u: Array) -> Array:
    """Torque [N m] that the abstraction lacks, averaged over `AVERAGING`, one row per window, (W, n).

    ``M (dq(T) - dq(0) - int ddq dt)`` with the abstraction's own ``ddq``, Coriolis torques and all: momentum balance, so nothing
    measured is differentiated.
    """
    m = max(1, round(AVERAGING / dt))
    edges = np.arange(0, len(q) - 1, m)
    edges = edges[edges + m < len(q)]
    gained = np.vstack([np.zeros(q.shape[1]), np.cumsum(abstraction.ddq(q, dq, u) * dt, axis=0)])
    lacking = (dq[edges + m] - dq[edges]) - (gained[edges + m] - gained[edges])
    return np.asarray(lacking @ np.linalg.inv(abstraction.Minv).T / (m * dt))


Repeats = dict[SuiteKey, list[tuple[int, Array]]]  # errors (W, n) of the trials of a motion, every `AVERAGING`, with their places


class Figures:
    """Errors per joint, fed trial by trial; parts fed elsewhere can be merged, with the same bits as fed in one go.

    ``roll`` simulates effects at the simulated state; without it the inputs carry them at the measured one.
    """

    def __init__(self, abstraction: Abstraction, dt: float, roll: RollOut | None = None) -> None:
        self._abstraction, self._dt, self._roll = abstraction, dt, roll
        self._rows: list[tuple[int, Array]] = []  # (place, sums of squares and counts of one trial)
        self._repeats: dict[str, Repeats] = {kind: {} for kind in REPEATED}
        self._waiting: list[Recording] = []
        self.u: Box | None = None  # hull of the inputs seen

    def add(self, r: Recording, u: Array) -> None:
        """Take a trial on the grid and its input (N, n) in."""
        self.u = Box.hull(u) if self.u is None else self.u | Box.hull(u)
        e = torque_error(self._abstraction, self._dt, r.q, r.dq, u)
        self._put(r.place, "torque", e)
        self._repeat("torque", r, e)
        last = min(len(r.t), round(LONGEST / self._dt) + 1)
        if self._roll is None:
            with np.errstate(over="ignore", invalid="ignore"):  # a model that runs away has no open-loop error
                x = predict(self._abstraction, self._dt, np.concatenate([r.q[0], r.dq[0]]), u[:last])
            self._open_loop(r.cut(0, last), x)
            return
        self._waiting.append(r.cut(0, last))
        if len(self._waiting) == TOGETHER:
            self._flush()

    def merge(self, other: Figures) -> Figures:
        """Both together."""
        for part in (self, other):
            part._flush()
        out = Figures(self._abstraction, self._dt, self._roll)
        out._rows = self._rows + other._rows
        for kind in REPEATED:
            for repeats in (self._repeats[kind], other._repeats[kind]):
                for motion, rows in repeats.items():
                    out._repeats[kind].setdefault(motion, []).extend(rows)
        out.u = self.u | other.u if self.u is not None and other.u is not None else self.u or other.u
        return out

    def rows(self) -> tuple[list[tuple[int, Array]], dict[str, Repeats], Box | None]:
        """All that was taken in: sums by place and kind, errors of repeated motions by kind, hull of the inputs."""
        self._flush()
        return self._rows, self._repeats, self.u

    @classmethod
    def of(
        cls, abstraction: Abstraction, dt: float, rows: list[tuple[int, Array]], repeats: dict[str, Repeats], u: Box | None,
    ) -> Figures:  # fmt: skip
        """What `rows` gave, to merge with figures of later trials."""
        out = cls(abstraction, dt)
        out._rows, out.u = rows, u
        out._repeats |= repeats
        return out

    def result(self, joints: tuple[str, ...]) -> dict[str, dict[str, Any]]:
        """Per joint ``torque_rmse, torque_rmse_floor, velocity_rmse, position_rmse, position_rmse_floor`` (SI).

        Velocity and position are those of the open-loop prediction from each trial's start, at most `LONGEST` long; the
        floors are the scatter between repetitions of the same torques, null without repetitions.
        """
        self._flush()
        rms = {name: self._rms(name) for name in ("torque", "velocity", "position")}
        floor = {kind: self._floor(kind) for kind in REPEATED}
        return {
            j: {
                "torque_rmse": _finite(rms["torque"], k),
                "torque_rmse_floor": _finite(floor["torque"], k),
                "velocity_rmse": _finite(rms["velocity"], k),
                "position_rmse": _finite(rms["position"], k),
                "position_rmse_floor": _finite(floor["position"], k),
            }
            for k, j in enumerate(joints)
        }

    def _put(self, place: int, name: str, e: Array) -> None:
        # one row per trial and kind, summed in campaign order at the end: the sum does not depend on who added what
        self._rows.append((3 * place + KINDS.index(name), np.concatenate([(e**2).sum(axis=0), [len(e)]])))

    def _repeat(self, kind: str, r: Recording, e: Array) -> None:
        if r.phase == "open_loop":
            self._repeats[kind].setdefault(r.suite_key, []).append((r.place, e))

    def _open_loop(self, r: Recording, x: Array) -> None:
        n = r.q.shape[1]
        with np.errstate(over="ignore", invalid="ignore"):
            away = x[:, :n] - r.q
            self._put(r.place, "position", away)
            self._repeat("position", r, away[:: max(1, round(AVERAGING / self._dt))])
            self._put(r.place, "velocity", x[:, n:] - r.dq)

    def _flush(self) -> None:
        if self._waiting and self._roll is not None:
            for r, x in zip(self._waiting, self._roll(self._waiting, self._dt), strict=True):
                self._open_loop(r, x)
            self._waiting = []

    def _rms(self, name: str) -> Array | None:
        rows = [row for key, row in sorted(self._rows, key=lambda p: p[0]) if key % 3 == KINDS.index(name)]
        total = np.sum(rows, axis=0) if rows else np.zeros(1)
        return np.asarray(np.sqrt(total[:-1] / total[-1])) if total[-1] > 0 else None

    def _floor(self, kind: str) -> Array | None:
        """RMS deviation from the mean of the repetitions (n,), None without repetitions."""
        freedom, spread = 0.0, np.zeros(self._abstraction.n)
        for _, trials in sorted(self._repeats[kind].items()):
            rows = [e for _, e in sorted(trials, key=lambda p: p[0])]
            m = min(len(e) for e in rows)
            if len(rows) >= 2 and m > 0:
                block = np.stack([e[:m] for e in rows])
                freedom += (len(rows) - 1) * m
                spread += ((block - block.mean(axis=0)) ** 2).sum(axis=(0, 1))
        return np.asarray(np.sqrt(spread / freedom)) if freedom > 0 else None


def _finite(row: Array | None, joint: int) -> float | None:
    return float(row[joint]) if row is not None and np.isfinite(row[joint]) else None


def joint_figures(
    pairs: Pairs, abstraction: Abstraction, joints: tuple[str, ...], dt: float, roll: RollOut | None = None
) -> dict[str, dict[str, Any]]:
    """`Figures` over all ``pairs``."""
    figures = Figures(abstraction, dt, roll)
    for _, r, u in pairs():
        figures.add(r, u)
    return figures.result(joints)
