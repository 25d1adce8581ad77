"""One fault at a time in an arm whose truth is known: what it does to the arm, or to what is read of it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from monitor_arm import DT, VISCOUS, U
from stopset.monitor.evidence.cause import Kind
from stopset.types import Array

KINDS = (
    Kind.SPIKE, Kind.FROZEN, Kind.STALE, Kind.LATE_TORQUE, Kind.CONTACT, Kind.DRIFT, Kind.MISSING_EFFECT, Kind.ENCODER_JUMP,
)  # fmt: skip
HALF = 0.5 * (U.hi - U.lo)


@dataclass
class Fault:
    """A fault of ``kind`` from cycle ``at`` on, the rest drawn from ``rng``; ``joint`` is where it shows first of all."""

    kind: Kind
    rng: np.random.Generator
    at: int
    joint: int = field(init=False)
    _read: list[Array] = field(default_factory=list)

    def __post_init__(self) -> None:
        rng = self.rng
        self.joint, self.sign, self.variant = int(rng.integers(0, 6)), float(rng.choice([-1.0, 1.0])), int(rng.integers(0, 3))
        self.size, self.cycles = float(rng.uniform()), int(rng.integers(6, 20))
        # a push on a link is felt by the joints before it
        share = np.where(np.arange(6) < self.joint, rng.uniform(0.0, 1.0, 6) * rng.choice([-1.0, 1.0], 6), 0.0)
        share[self.joint] = self.sign
        self.push_on = share * (3.5 + 6.5 * self.size) * HALF

    def torque(self, k: int, u: Array, dq: Array) -> Array:
        """(n,) what the arm feels beside its input [N m]."""
        out, since, j = np.zeros(6), (k - self.at) * DT, self.joint
        if self.kind is Kind.CONTACT and since >= 0:
            # a wall that holds, one that gives way over 20 ms, a blow of 60 ms
            course = (1.0, min(1.0, since / 0.02), max(0.0, np.sin(np.pi * min(since, 0.06) / 0.06)))[self.variant]
            out = self.push_on * course
        elif self.kind is Kind.DRIFT and since >= 0:
            out[j] = self.sign * (5 + 5 * self.size) * HALF[j] * since / 0.8
        elif self.kind is Kind.MISSING_EFFECT:
            if self.variant == 0 and since >= 0:  # drag grows
                out[j] = -(0.4 + 0.3 * self.size) * VISCOUS[j] * dq[j]
            elif self.variant == 1:  # drag that never was in the model
                out[j] = (0.4 + 0.3 * self.size) * VISCOUS[j] * dq[j]
            elif since >= 0:  # the drive gives less than it says
                out[j] = -(0.35 + 0.2 * self.size) * u[j]
        return out

    def reading(self, k: int, values: Array) -> Array:
        """``values`` (signals, n) of cycle ``k`` as they are read."""
        self._read.append(values.copy())
        out, j, since = values.copy(), self.joint, k - self.at
        if self.kind is Kind.SPIKE and since == 0:
            row = (0, 1, 2)[self.variant]
            out[row, j] += self.sign * (0.01 + 0.5 * self.size, 0.05 + 0.5 * self.size, (30 + 30 * self.size) * HALF[j])[row]
        elif self.kind is Kind.ENCODER_JUMP and since >= 0:
            out[0, j] += self.sign * (0.005 + 0.1 * self.size)
        elif self.kind is Kind.FROZEN and since >= 0:
            out[:2, j] = self._read[self.at][:2, j]
        elif self.kind is Kind.STALE and 0 <= since < self.cycles:
            out[:] = self._read[self.at]
        elif self.kind is Kind.LATE_TORQUE and since >= 0:
            late = 5 + self.cycles % 6
            columns = slice(None) if self.variant else [j]
            out[2, columns] = self._read[max(0, k - late)][2, columns]
        return out


@dataclass
class Spring(Fault):
    """A spring that appears where the arm is, or rests at zero; up to a few times what the model may lack."""

    q: Array = field(default_factory=lambda: np.zeros(6))
    rest: float | None = None

    def torque(self, k: int, u: Array, dq: Array) -> Array:
        """As `Fault.torque`."""
        out, j = np.zeros(6), self.joint
        if k >= self.at:
            if self.rest is None:
                self.rest = float(self.q[j]) if self.variant else 0.0
            out[j] = -(1.5 + 2.5 * self.size) * HALF[j] / 0.08 * (self.q[j] - self.rest)
        self.q = self.q + dq * DT
        return out
