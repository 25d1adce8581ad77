"""Degrees taken for radians: both are numbers of one size where an arm moved little, but only one of them makes gravity fit."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from stopset.offline.inspect.finding import Finding
from stopset.recording.types import Recording
from stopset.robot import Robot
from stopset.robot.rigid import gravity_torques
from stopset.types import Array

PER_TRIAL = 40  # rows taken of each trial
MOST = 4000  # rows held; beyond, every other one is dropped
CLEARER = 0.5  # of what one unit leaves of the torques the other must leave at most
FEWEST = 50  # rows


@dataclass(slots=True)
class UnitSample:
    """A few rows of every trial, evenly spread, however many trials there are: ``rows`` of (q, dq, tau) (n,) each."""

    rows: list[tuple[Array, Array, Array]] = field(default_factory=list)
    every: int = 1
    seen: int = 0

    def add(self, r: Recording) -> None:
        """Take a trial's rows in."""
        for k in range(0, len(r.t), max(1, len(r.t) // PER_TRIAL)):
            if self.seen % self.every == 0:
                self.rows.append((r.q[k], r.dq[k], r.tau[k]))
            self.seen += 1
        while len(self.rows) > MOST:
            self.rows, self.every = self.rows[::2], 2 * self.every


def degrees(sample: UnitSample, robot: Robot) -> list[Finding]:
    """Whether positions make the measured torque look like gravity in degrees, and not in radians."""
    if len(sample.rows) < FEWEST:
        return []
    q, dq, tau = (np.array([row[k] for row in sample.rows]) for k in range(3))
    in_rad, in_deg = _left(robot, q, dq, tau), _left(robot, np.radians(q), dq, tau)
    if in_deg > CLEARER * in_rad:
        return []
    seen = f"q taken in degrees leaves {np.sqrt(in_deg / in_rad):.2f} times what it leaves of the torques in radians"
    return [Finding("wrong_unit", "error", None, seen, "rad and rad/s", "convert q and dq", float(np.sqrt(in_deg / in_rad)))]


def _left(robot: Robot, q: Array, dq: Array, tau: Array) -> float:
    """Sum over joints of the share of torque variance that gravity and friction at ``q, dq`` do not explain."""
    load = gravity_torques(robot.chain, robot.pi, np.ascontiguousarray(q))
    share = 0.0
    for j in range(robot.n):
        y = tau[:, j] - tau[:, j].mean()
        X = np.column_stack([load[:, j], np.sign(dq[:, j]), dq[:, j], np.ones(len(q))])
        scale = np.maximum(np.linalg.norm(X, axis=0), 1e-12)
        x = np.linalg.lstsq(X / scale, y, rcond=1e-9)[0]
        if x[0] < 0:  # gravity that pulls upwards is no explanation
            x = np.r_[0.0, np.linalg.lstsq(X[:, 1:] / scale[1:], y, rcond=1e-9)[0]]
        share += float(np.sum((y - X / scale @ x) ** 2)) / max(float(y @ y), 1e-12)
    return share
