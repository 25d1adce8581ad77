"""The columns of a structure that gives: a pedestal that rocks at its foot, a link that bends half way along.

No joint moves with it, and no encoder sees it: all torques feel the acceleration of what stands on it, and gravity from another side.
Like the link behind an elastic gear it swings as its own moment drives it, which the arm's chain tells with two more joints in it.  What
drives it is taken as it was recorded: smoothed as for a gear's first search, a swing of 7 Hz and more would be next to nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stopset.offline.diagnose.columns.elasticity import driven, rocked
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


def places(robot: Robot) -> list[Place]:
    """Two level axes under the base, and two across every link half way along."""
    c = robot.chain
    up = -c.gravity / max(float(np.linalg.norm(c.gravity)), 1e-12)
    out = [Place("the base", 0, _across(up), np.zeros(3), c.p[0], up)]
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
    """How a structure gives: ``rate`` [rad/s] and ``damping`` (of the root of stiffness times inertia) of its swing about the axis at ``angle``
    [rad], from the place's first to its second; how many times as stiff it is ``across`` that, None: rigid; ``foot`` [m], ``own``: its
    own inertia over the arm's."""

    rate: float
    damping: float
    angle: float = 0.0
    across: float | None = None
    foot: float = 0.0
    own: float = 0.0


@dataclass(frozen=True, slots=True)
class Giving:
    """A place, of whose foot one is taken, with all that its swing asks of the rows, about each of its axes: ``mass`` and gravity's stiffness
    ``stiff`` of the arm's joints (N, n, k) and of its own (N, k, k), (N, k) its ``moment`` and gravity's."""

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
    def inertia(self) -> float:
        """[kg m^2] about its axes, of all that stands on it, the median over the rows."""
        return float(np.median(np.trace(self.own_mass, axis1=1, axis2=2) / self.own_mass.shape[1]))

    def about(self, angle: float, k: int) -> Giving:
        """The same about the first ``k`` of its axes turned by ``angle`` [rad]."""
        c, s, own = np.cos(angle), np.sin(angle), self.moment.shape[1]
        a = np.array([[c, -s], [s, c]])[:own, : min(k, own)]
        return Giving(
            self.source,
            self.mass @ a,
            self.stiff @ a,
            a.T @ self.own_mass @ a,
            a.T @ self.own_stiff @ a,
            self.moment @ a,
            self.gravity @ a,
        )

    def columns(self, s: Spring) -> Array:
        """(N, n) what the structure adds to the joints' torques, as a gear's swing does."""
        g = self.about(s.angle, 1 if s.across is None else 2)
        k, inertia = g.moment.shape[1], self.inertia
        own, K = s.own * inertia, s.rate**2 * inertia * (1.0 + s.own)
        springs = np.array([(K * x, s.damping * K * x / s.rate) for x in (1.0, s.across or 1.0)])
        if k > 1:
            x, ddx = rocked(g.source, g.moment, g.gravity, g.own_mass + own * np.eye(2), g.own_stiff, springs)
        else:
            x, ddx = (
                y[:, None]
                for y in driven(
                    g.source, g.moment[:, 0], g.gravity[:, 0], g.own_mass[:, 0, 0] + own, g.own_stiff[:, 0, 0], tuple(springs[0])
                )
            )
        return np.asarray(np.einsum("nij,nj->ni", g.mass, ddx) + np.einsum("nij,nj->ni", g.stiff, x))

    def parts(self, rate: float, damping: float) -> Array:
        """(N, n, 3) columns of which those of any one axis of two are made, but for what inertia differs between these: `mixed` says how."""
        M = self.inertia
        spring = rate**2 * M, damping * rate * M
        own_mass, own_stiff = (np.einsum("naa->n", x) / x.shape[1] for x in (self.own_mass, self.own_stiff))
        swings = [
            driven(self.source, self.moment[:, i], self.gravity[:, i], own_mass, own_stiff, spring)
            for i in range(self.moment.shape[1])
        ]

        def of(i: int, j: int) -> Array:
            x, ddx = swings[j]
            return self.mass[..., i] * ddx[:, None] + self.stiff[..., i] * x[:, None]

        first = of(0, 0)
        if len(swings) == 1:
            return np.stack([first, np.zeros_like(first), np.zeros_like(first)], axis=-1)
        return np.stack([first, of(0, 1) + of(1, 0), of(1, 1)], axis=-1)


def mixed(angle: float, across: float | None) -> Array:
    """(3,) shares of `Giving.parts` of one axis at ``angle`` [rad]; with an ``across``, of both alike."""
    if across is not None:
        return np.array([1.0, 0.0, 1.0])
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * c, c * s, s * s])
