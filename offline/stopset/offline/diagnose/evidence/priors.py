"""What is known of the arm before the question is asked, and how well."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stopset.offline.diagnose.rows.prepare import Array
from stopset.robot import Robot

SCALES = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0)  # how far the CAD may be off, in units of its tolerance; found by evidence
ROTOR_SCALES = (0.3, 0.6, 1.0)  # likewise of data-sheet inertias, but not beyond: more than the tolerance is a finding


DRIVES = (
    0.058  # of recorded over true torque, all drives alike: data sheets state torque constants to 10 %, 5.8 % in the mean square
)
ROTOR_SHIFT = 0.3  # prior deviation of an inertia that is not the data sheet's, as a share of the one stated


@dataclass(frozen=True, slots=True)
class Tolerance:
    """How well the robot description is known, one standard deviation each."""

    mass: float = 0.036  # of each link's mass: masses 2 to 5 % off are 3.6 % off in the mean square
    centre: float = 0.0018  # [m] of each link's centre of mass along each axis: 3 mm in all
    inertia: float = 0.10  # of each link's inertia
    rotor: float = 0.03  # of each reflected rotor inertia: data sheets 4 % off at most are 2.3 % off in the mean square


@dataclass(frozen=True, slots=True)
class Known:
    """What a model from other recordings adds to the description: then only what has *changed* is asked for.

    ``friction``: (n, 2) Coulomb and viscous coefficients; ``spread``: how far they drift from day to day, relative;
    ``gain``, ``gain_std``: recorded over true torque, common to the drives; ``scales``: how far the rigid body may be off, as `SCALES`.
    """

    friction: Array
    gain: float = 1.0
    gain_std: float = DRIVES
    spread: float = 0.15
    scales: tuple[float, ...] = (0.1, 0.3)


def link_tolerance(robot: Robot, tol: Tolerance) -> Array:
    """(n, 10) standard deviations of the links' standard parameters from the description's tolerance."""
    pi = robot.pi
    m = pi[:, :1]
    first = np.sqrt((tol.mass * pi[:, 1:4]) ** 2 + (tol.centre * m) ** 2)
    size = np.maximum(np.abs(pi[:, [4, 6, 9]]).max(axis=1, keepdims=True), 1e-4)
    return np.concatenate([tol.mass * m, first, np.repeat(tol.inertia * size, 6, axis=1)], axis=1)
