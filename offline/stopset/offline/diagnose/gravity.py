"""Gravity of every row at once: what it does to each joint, however the base is tilted, and how that changes with position.

Gravity's moment about joint ``j`` is ``z_j x h_j`` times the gravity vector, ``h_j`` being the first moment of all links beyond
the joint.  These moments do not depend on gravity itself, so one pass gives gravity torques, their derivatives by a tilt of
the base, and their derivatives by every joint's position, which turns gravity the other way for all that lies beyond.

Source: Featherstone, Rigid Body Dynamics Algorithms (2008), ch. 2.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from stopset.robot import rigid
from stopset.robot.rigid import Chain
from stopset.types import Array


class GravityMoments(NamedTuple):
    """Of each row and joint: ``axis`` (N, n, 3) in the base frame, ``moment`` (N, n, 3) = axis x first moment [kg m]."""

    axis: Array
    moment: Array

    def torque(self, gravity: Array) -> Array:
        """(N, n) torque that holds the arm against ``gravity`` (3,) [m/s^2], in N m."""
        out: Array = -(self.moment @ gravity)
        return out

    def stiffness(self, gravity: Array, joint: int) -> Array:
        """(N, n) derivative of every joint's gravity torque by the position of ``joint`` [N m/rad]."""
        turned = np.cross(self.axis, gravity)  # (N, n, 3): -d gravity / d position, seen from beyond each joint
        out: Array = np.empty(self.axis.shape[:2])
        out[:, joint:] = np.einsum("kic,kc->ki", self.moment[:, joint:], turned[:, joint])
        out[:, :joint] = np.einsum("kic,kc->ki", turned[:, :joint], self.moment[:, joint])
        return out


def gravity_moments(chain: Chain, pi: Array, q: Array) -> GravityMoments:
    """Of the positions ``q`` (N, n) [rad] for the links' standard parameters ``pi`` (n, 10)."""
    return GravityMoments(*rigid.moment_arms(chain, pi, q))
