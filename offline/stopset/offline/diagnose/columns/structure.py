"""The columns of a structure that gives: a pedestal that rocks at its foot, a link that bends half way along.

No joint moves with it, and no encoder sees it: all torques feel the acceleration of what stands on it, and gravity from another side.
Like the link behind an elastic gear it swings as its own moment drives it, which the arm's chain tells with one more joint in it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stopset.offline.diagnose.columns.elasticity import driven
from stopset.offline.diagnose.columns.signals import ArmSignals
from stopset.robot import Robot
from stopset.robot.rigid import Chain, gravity_torques, mass_matrices, torques
from stopset.types import Array

FOOT = (0.0, 0.5)  # [m] below the arm's base at which a pedestal rocks
SHORT = 0.02  # [m] a link no longer has nothing to bend
STEP = 1e-4  # [rad] of a central difference of gravity


@dataclass(frozen=True, slots=True)
class Place:
    """Where a structure may give: ``where`` in words, before joint ``at``, about ``axis`` (3,), ``before`` and ``behind`` it (3,) [m]."""

    where: str
    at: int
    axis: Array
    before: Array
    behind: Array

    def chain(self, c: Chain) -> Chain:
        """The arm's chain with the structure as a joint."""
        R, p = np.insert(c.R, self.at, np.eye(3), axis=0), np.insert(c.p, self.at, self.before, axis=0)
        p[self.at + 1] = self.behind
        return Chain(R, p, np.insert(c.axis, self.at, self.axis, axis=0), c.gravity)


def places(robot: Robot) -> list[Place]:
    """Two level axes under the base, and two across every link."""
    c = robot.chain
    up = -c.gravity / max(float(np.linalg.norm(c.gravity)), 1e-12)
    level = _across(up)
    out = [Place("the base", 0, a, np.zeros(3), c.p[0] + foot * up) for foot in FOOT for a in level]
    for at in range(1, len(c.p)):
        if (length := float(np.linalg.norm(c.p[at]))) > SHORT:
            half = 0.5 * c.p[at]
            out += [Place(f"the link before {robot.joints[at]}", at, a, half, half) for a in _across(c.p[at] / length)]
    return out


def _across(direction: Array) -> Array:
    """(2, 3) unit vectors across a unit vector and each other."""
    first = np.cross(direction, np.eye(3)[int(np.argmin(np.abs(direction)))])
    first = first / np.linalg.norm(first)
    return np.stack([first, np.cross(direction, first)])


@dataclass(frozen=True, slots=True)
class Giving:
    """A place with all that its swing asks of the rows: (N, n + 1) mass and gravity's stiffness about it, (N,) its moment and gravity's."""

    source: ArmSignals
    place: Place
    mass: Array
    stiff: Array
    moment: Array
    gravity: Array

    @staticmethod
    def of(source: ArmSignals, place: Place) -> Giving:
        d, at = source.data, place.at
        chain, pi = place.chain(source.robot.chain), np.insert(source.robot.pi, place.at, 0.0, axis=0)
        q, dq, ddq = (np.ascontiguousarray(np.insert(x, at, 0.0, axis=1)) for x in (d.q, d.dq, d.ddq))
        bent = np.zeros(chain.p.shape[0])
        bent[at] = STEP
        stiff = (gravity_torques(chain, pi, q + bent) - gravity_torques(chain, pi, q - bent)) / (2 * STEP)
        moment, gravity = torques(chain, pi, q, dq, ddq)[:, at], gravity_torques(chain, pi, q)[:, at]
        return Giving(source, place, mass_matrices(chain, pi, q)[:, :, at], stiff, moment, gravity)

    @property
    def inertia(self) -> float:
        """[kg m^2] about the axis, of all that stands on it, the median over the rows."""
        return float(np.median(self.mass[:, self.place.at]))

    def columns(self, K: float, D: float) -> Array:
        """(N, n) what a structure of stiffness ``K`` [N m/rad] and damping ``D`` [N m s/rad] adds to the joints' torques, as a gear's swing does."""
        at = self.place.at
        x, ddx = driven(self.source, self.moment, self.gravity, self.mass[:, at], self.stiff[:, at], (K, D))
        return np.delete(self.mass * ddx[:, None] + self.stiff * x[:, None], at, axis=1)
