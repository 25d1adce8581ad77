"""What is believed before any data: the CAD's masses, centres and inertias, and the data sheet's rotors, with doubts.

A CAD is a few per cent wrong in mass and millimetres in the centre; it is a prior with that spread, not a truth.  Where
the data speak they win; where no motion tells, the CAD stays.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stopset.robot import Robot
from stopset.robot.rigid import link_frames
from stopset.types import Array


@dataclass(frozen=True, slots=True)
class Tolerance:
    """How well a robot description is known, one standard deviation each; the one place that says it.

    The diagnosis finds by evidence how many times this a description is off; an identification cannot, and takes `IDENTIFICATION` times.
    """

    mass: float = 0.036  # of each link's mass: masses 2 to 5 % off are 3.6 % off in the mean square
    centre: float = 0.0018  # [m] of each link's centre of mass along each axis: 3 mm in all
    inertia: float = 0.10  # of each link's inertia
    rotor: float = 0.03  # of each reflected rotor inertia: data sheets 4 % off at most are 2.3 % off in the mean square
    rotor_unknown: float = 10.0  # [kg m^2] where the data sheet gives none: as good as no prior, of a `LIGHT` arm

    def times(self, factor: float) -> Tolerance:
        """Errors that many times as large."""
        return Tolerance(factor * self.mass, factor * self.centre, factor * self.inertia, factor * self.rotor, self.rotor_unknown)


# Data win over a wide prior, not over one that is too narrow: on 29 recordings (28 labelled sets, UR10e) twice the tolerance leaves
# the held-out torque error within 1 % of what 4 %, 5 mm, 20 % and 10 % leave; once raises it by up to 19 % (a rotor off its sheet).
IDENTIFICATION = 2.0

# [kg m^2] of an arm stretched from its first joint: a UR10e has 18, a KR 300 1,900, and rotors of up to 840 behind its gears, which a
# prior of 10 held back for the links to make up
LIGHT = 20.0

# A tool or load that the description does not have, one standard deviation: share of the arm's mass, and how far out
CARRIED = 0.2
CARRIED_AT = 0.3  # [m]


@dataclass(frozen=True, slots=True)
class Prior:
    """Gaussian over ``[pi (10 n), rotor (n)]``: ``mean`` (11 n,), ``precision`` (11 n, 11 n).

    ``carried`` (10, 10): covariance of what the last link may carry beside what is described, if it carries anything.
    """

    mean: Array
    precision: Array
    rotor_known: tuple[bool, ...]
    carried: Array
    rotor_unknown: float  # [kg m^2] standard deviation of a rotor that no data sheet gives

    @property
    def last(self) -> slice:
        """Places of the last link's parameters."""
        n = len(self.rotor_known)
        return slice(10 * n - 10, 10 * n)

    @property
    def without_rotors(self) -> Prior:
        """The same links, and rotors of which nothing is known."""
        n = len(self.rotor_known)
        mean, precision, rotors = self.mean.copy(), self.precision.copy(), np.arange(10 * n, 11 * n)
        mean[rotors], precision[rotors, rotors] = 0.0, 1 / self.rotor_unknown**2
        return replace(self, mean=mean, precision=precision, rotor_known=(False,) * n)

    def believed(self, scale: float, *, loaded: bool) -> Array:
        """(11 n, 11 n) precision of a description off by ``scale`` times its tolerance, with or without something carried."""
        out = self.precision / scale**2
        if loaded:
            out[self.last, self.last] = np.linalg.inv(np.linalg.inv(out[self.last, self.last]) + self.carried)
        return out


def tensor(P: Array) -> Array:
    """(3, 3) inertia of ten standard parameters about the link frame's origin."""
    return np.array([[P[4], P[5], P[7]], [P[5], P[6], P[8]], [P[7], P[8], P[9]]])


def prior_of(robot: Robot, tolerance: Tolerance | None = None) -> Prior:
    """The robot description as a prior: independent errors of mass, centre and central inertia of every link.

    ``tolerance``: `IDENTIFICATION` times the usual one if left out.
    """
    tolerance = tolerance or Tolerance().times(IDENTIFICATION)
    n = robot.n
    precision = np.zeros((11 * n, 11 * n))
    for i in range(n):
        s = slice(10 * i, 10 * i + 10)
        precision[s, s] = np.linalg.inv(_link_covariance(robot.pi[i], tolerance))
    rotor = robot.rotor
    unknown = tolerance.rotor_unknown * max(1.0, _stretched(robot) / LIGHT)
    known = tuple(bool(np.isfinite(d.rotor_inertia)) for d in robot.drives)
    for i in range(n):
        sd = max(tolerance.rotor * rotor[i], 1e-4) if known[i] else unknown
        precision[10 * n + i, 10 * n + i] = 1 / sd**2
    mass = CARRIED * float(robot.pi[:, 0].sum())
    carried = mass**2 * np.diag(np.r_[1.0, [CARRIED_AT**2] * 3, [CARRIED_AT**4] * 6])
    return Prior(np.concatenate([robot.pi.ravel(), rotor]), precision, known, carried, unknown)


def _stretched(robot: Robot) -> float:
    """[kg m^2] about the first joint, were all links in one line: what geared drives of that arm have is of its order."""
    _, origins = link_frames(robot.chain, np.zeros(robot.n))
    out = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(origins, axis=0), axis=1))])
    mass = np.maximum(robot.pi[:, 0], 1e-6)
    return float(mass @ (out + np.linalg.norm(robot.pi[:, 1:4], axis=1) / mass) ** 2)


def _link_covariance(P: Array, tolerance: Tolerance) -> Array:
    """(10, 10): errors of (m, c, I_c) carried to the standard parameters, to first order."""
    m = max(P[0], 1e-6)
    c = P[1:4] / m
    central = tensor(P) - m * ((c @ c) * np.eye(3) - np.outer(c, c))
    # a body has some extent even where the CAD calls it a point: two centimetres of gyration radius
    size = max(float(np.trace(central)) / 3, m * 0.02**2)
    sd = np.array([tolerance.mass * m, *([tolerance.centre] * 3), *([tolerance.inertia * size] * 6)])
    J = np.zeros((10, 10))
    J[0, 0] = 1.0
    J[1:4, 0] = c
    J[1:4, 1:4] = m * np.eye(3)
    J[4:, 4:] = np.eye(6)
    pairs = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))
    for row, (a, b) in enumerate(pairs, start=4):
        J[row, 0] = (c @ c) * (a == b) - c[a] * c[b]
        for k in range(3):
            J[row, 1 + k] = m * (2 * c[k] * (a == b) - c[a] * (b == k) - c[b] * (a == k))
    return J @ np.diag(sd**2) @ J.T
