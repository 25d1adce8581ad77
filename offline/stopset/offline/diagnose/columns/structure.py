"""The columns of a structure that gives: a pedestal that rocks at its foot, a link that bends half way along.

No joint moves with it, and no encoder sees it: all torques feel the acceleration of what stands on it, and gravity from another side.
Like the link behind an elastic gear it swings as its own moment drives it, which the arm's chain tells with two more joints in it.  What
drives it is taken as it was recorded: smoothed as for a gear's first search, a swing of 7 Hz and more would be next to nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stopset.offline.diagnose.columns.elasticity import driven
from stopset.offline.diagnose.columns.signals import ArmSignals
from stopset.robot import Robot
from stopset.robot.rigid import Chain, gravity_torques, mass_matrices, torques
from stopset.types import Array

SHORT = 0.02  # [m] a link no longer has nothing to bend
STEP = 1e-4  # [rad] of a central difference of gravity


@dataclass(frozen=True, slots=True)
class Place:
    """Where a structure may give: ``where`` in words, before joint ``at``, about ``axes`` (k, 3) there, which cross, ``before`` and ``behind``
    them (3,) [m]; ``up`` (3,): the way from its foot, which may be any; zero where its axes lie where they are."""

    where: str
    at: int
    axes: Array
    before: Array
    behind: Array
    up: Array

    def chain(self, c: Chain, foot: float) -> Chain:
        """The arm's chain with the structure as joints, ``foot`` [m] below ``behind``."""
        k, at = len(self.axes), self.at
        R, p = np.insert(c.R, [at] * k, np.eye(3), axis=0), np.insert(c.p, [at] * k, 0.0, axis=0)
        p[at], p[at + k] = self.before, self.behind + foot * self.up
        return Chain(R, p, np.insert(c.axis, [at] * k, self.axes, axis=0), c.gravity)

    @property
    def standing(self) -> bool:
        """Whether it stands on a foot."""
        return bool(np.any(self.up))

    @property
    def crossing(self) -> bool:
        """Whether it gives about one of all axes that cross its own, rather than about all of its own."""
        return len(self.axes) > 1 and not self.standing


def places(robot: Robot) -> list[Place]:
    """Two level axes under the base, where gravity says what is level, and two across every link half way along."""
    c, out = robot.chain, list[Place]()
    if weight := float(np.linalg.norm(c.gravity)):
        up = -c.gravity / weight
        out.append(Place("the base", 0, _across(up), np.zeros(3), c.p[0], up))
    for at in range(1, len(c.p)):
        if (length := float(np.linalg.norm(c.p[at]))) > SHORT:
            half = 0.5 * c.p[at]
            out.append(Place(f"the link before {robot.joints[at]}", at, _across(c.p[at] / length), half, half, np.zeros(3)))
    return out


def gears(robot: Robot) -> list[Place]:
    """Every joint's own axis: what gives there is its gear."""
    c = robot.chain
    return [Place(joint, j, (c.R[j] @ c.axis[j])[None], c.p[j], np.zeros(3), np.zeros(3)) for j, joint in enumerate(robot.joints)]


def _across(direction: Array) -> Array:
    """(2, 3) unit vectors across a unit vector and each other."""
    first = np.cross(direction, np.eye(3)[int(np.argmin(np.abs(direction)))])
    first = first / np.linalg.norm(first)
    return np.stack([first, np.cross(direction, first)])


@dataclass(frozen=True, slots=True)
class Spring:
    """How a structure gives: ``rate`` [rad/s] and ``damping`` (of the root of stiffness times inertia) of its swing; ``angle`` [rad] of the axis
    across a link, from the place's first to its second; ``foot`` [m] below a pedestal's top."""

    rate: float
    damping: float
    angle: float = 0.0
    foot: float = 0.0


@dataclass(frozen=True, slots=True)
class Giving:
    """A place, its foot chosen, with all that its swing asks of the rows, about each of its axes: ``mass`` and gravity's stiffness ``stiff`` of
    the arm's joints (N, n, k) and of its own (N, k, k), (N, k) its ``moment`` and gravity's."""

    source: ArmSignals
    mass: Array
    stiff: Array
    own_mass: Array
    own_stiff: Array
    moment: Array
    gravity: Array

    @staticmethod
    def of(source: ArmSignals, place: Place, foot: float = 0.0) -> Giving:
        d, k = source.data, len(place.axes)
        at = np.arange(place.at, place.at + k)
        chain, pi = place.chain(source.robot.chain, foot), np.insert(source.robot.pi, [place.at] * k, 0.0, axis=0)
        q, dq, ddq = (np.ascontiguousarray(np.insert(x, [place.at] * k, 0.0, axis=1)) for x in (d.q, d.dq, d.ddq))
        bent = STEP * np.eye(q.shape[1])[at]
        stiff = [(gravity_torques(chain, pi, q + b) - gravity_torques(chain, pi, q - b)) / (2 * STEP) for b in bent]
        g, M = np.stack(stiff, axis=-1), mass_matrices(chain, pi, q)[:, :, at]
        moment, gravity = torques(chain, pi, q, dq, ddq)[:, at], gravity_torques(chain, pi, q)[:, at]
        return Giving(source, np.delete(M, at, axis=1), np.delete(g, at, axis=1), M[:, at], g[:, at], moment, gravity)

    @property
    def stands(self) -> bool:
        """Whether anything stands on it: what is described without inertia cannot swing."""
        return bool(np.all(np.einsum("naa->na", self.own_mass) > 0.0))

    @property
    def inertia(self) -> float:
        """[kg m^2] about its axes, of all that stands on it, the median over the rows."""
        return float(np.median(np.trace(self.own_mass, axis1=1, axis2=2) / self.own_mass.shape[1]))

    def crossed(self, angle: float) -> Giving:
        """The same about one axis that crosses its two at ``angle`` [rad]."""
        axis = np.array([[np.cos(angle)], [np.sin(angle)]])
        own_mass, own_stiff = (axis.T @ x @ axis for x in (self.own_mass, self.own_stiff))
        mass, stiff, moment, gravity = (x @ axis for x in (self.mass, self.stiff, self.moment, self.gravity))
        return Giving(self.source, mass, stiff, own_mass, own_stiff, moment, gravity)

    def columns(self, s: Spring) -> Array:
        """(N, n) what the structure adds to the joints' torques, as a gear's swing does: of a pedestal's axes, equally stiff, each by itself."""
        K = s.rate**2 * self.inertia
        out = np.zeros(self.mass.shape[:2])
        for i in range(self.moment.shape[1]):
            own = (self.moment[:, i], self.gravity[:, i], self.own_mass[:, i, i], self.own_stiff[:, i, i])
            x, ddx = driven(self.source, *own, (K, s.damping * K / s.rate))
            out += self.mass[..., i] * ddx[:, None] + self.stiff[..., i] * x[:, None]
        return out
