"""Compensated torque against the robot's own inertia: gravity and Coulomb friction are off it already, momentum must balance.

``int u dt = s J(q) (dq(T) - dq(0)) + v (q(T) - q(0)) + offset T`` over windows of `WINDOW`, nothing differentiated; ``s`` is 1 up
to errors of the description where torque is in N m, -1 where its sign is wrong, 1000 in mN m.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from stopset.recording.types import Recording
from stopset.robot import Robot
from stopset.robot.rigid import mass_matrix
from stopset.types import Array

WINDOW = 0.2  # [s] long against noise of dq, short against a motion
TOGETHER = 4.0  # windows whose errors count as one: what is not modelled lasts about a second
SHARE = 0.1  # least part of the torque impulse, root mean square, that the inertia must make up
FEWEST = 20  # windows
ROTORS = 100.0  # a geared rotor that no data sheet tells may have this many times the inertia of what it moves


@dataclass(slots=True)
class Momentum:
    """Sums over windows, fed trial by trial: ``gram`` (n, 4, 4) of (inertia's impulse, way, time, torque's impulse)."""

    robot: Robot
    gram: Array = field(init=False)
    windows: int = 0

    def __post_init__(self) -> None:
        self.gram = np.zeros((self.robot.n, 4, 4))

    def add(self, r: Recording) -> None:
        """Take a trial of compensated torque in."""
        m = max(3, round(WINDOW / float(np.median(np.diff(r.t)))))
        at = np.arange(0, len(r.t) - m, m)
        if not len(at):
            return
        pushed = np.zeros_like(r.tau)
        np.cumsum(0.5 * (r.tau[1:] + r.tau[:-1]) * np.diff(r.t)[:, None], axis=0, out=pushed[1:])
        own = np.array([np.diag(mass_matrix(self.robot.chain, self.robot.pi, q)) for q in r.q[at + m // 2]]) + self.robot.rotor
        time = np.repeat((r.t[at + m] - r.t[at])[:, None], self.robot.n, axis=1)
        X = np.stack([own * (r.dq[at + m] - r.dq[at]), r.q[at + m] - r.q[at], time, pushed[at + m] - pushed[at]])
        self.gram += np.einsum("awj,bwj->jab", X, X)
        self.windows += len(at)

    def scales(self) -> tuple[Array, Array]:
        """(n,), (n,): measured over described inertia, and its standard error; ``nan`` where the motion does not tell."""
        n = self.robot.n
        scale, std = np.full(n, np.nan), np.full(n, np.inf)
        for j, S in enumerate(self.gram):
            d = np.sqrt(np.diag(S))
            if self.windows < FEWEST or np.any(d == 0.0):
                continue
            C = S / np.outer(d, d)
            A = C[:3, :3] + 1e-9 * np.eye(3)
            x = np.linalg.solve(A, C[:3, 3])
            if abs(x[0]) < SHARE:
                continue
            left = max(1.0 - float(x @ C[:3, 3]), 0.0) / self.windows * TOGETHER
            scale[j] = x[0] * d[3] / d[0]
            std[j] = np.sqrt(left * np.linalg.inv(A)[0, 0]) * d[3] / d[0]
            known = bool(np.isfinite(self.robot.drives[j].rotor_inertia))
            if not known and 1.0 < abs(scale[j]) < ROTORS:
                scale[j], std[j] = np.sign(scale[j]), std[j] / abs(scale[j])
        return scale, std
