"""Gravity of every row at once: what it does to each joint, however the base is tilted, and how that changes with position.

Gravity's moment about joint ``j`` is ``z_j x h_j`` times the gravity vector, ``h_j`` being the first moment of all links beyond
the joint.  These levers do not depend on gravity itself, so one pass gives gravity torques, their derivatives by a tilt of
the base, and their derivatives by every joint's position, which turns gravity the other way for all that lies beyond.

Source: Featherstone, Rigid Body Dynamics Algorithms (2008), ch. 2.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from stopset.offline.diagnose.rows.prepare import Array
from stopset.robot.rigid import Chain, turn


class Levers(NamedTuple):
    """Of each row and joint: ``axis`` (N, n, 3) in the base frame, ``lever`` (N, n, 3) = axis x first moment [kg m]."""

    axis: Array
    lever: Array

    def torque(self, gravity: Array) -> Array:
        """(N, n) torque that holds the arm against ``gravity`` (3,) [m/s^2], in N m."""
        out: Array = -(self.lever @ gravity)
        return out

    def stiffness(self, gravity: Array, joint: int) -> Array:
        """(N, n) derivative of every joint's gravity torque by the position of ``joint`` [N m/rad]."""
        turned = np.cross(self.axis, gravity)  # (N, n, 3): -d gravity / d position, seen from beyond each joint
        out: Array = np.empty(self.axis.shape[:2])
        out[:, joint:] = np.einsum("kic,kc->ki", self.lever[:, joint:], turned[:, joint])
        out[:, :joint] = np.einsum("kic,kc->ki", turned[:, :joint], self.lever[:, joint])
        return out


def levers(chain: Chain, pi: Array, q: Array) -> Levers:
    """Levers of the positions ``q`` (N, n) [rad] for the links' standard parameters ``pi`` (n, 10)."""
    return Levers(*_levers(chain.R, chain.p, chain.axis, pi, np.ascontiguousarray(q)))


@njit(cache=True, nogil=True)
def _levers(R0: Array, p: Array, axes: Array, pi: Array, q: Array) -> tuple[Array, Array]:
    N, n = q.shape
    axis, lever = np.empty((N, n, 3)), np.empty((N, n, 3))
    R, E, origin, moment = np.empty((n, 3, 3)), np.empty((3, 3)), np.empty((n, 3)), np.empty((n, 3))
    h = np.empty(3)
    for k in range(N):
        for i in range(n):
            turn(R0[i], axes[i], q[k, i], E)
            for r in range(3):
                origin[i, r] = p[i, r]
                for c in range(3):
                    R[i, r, c] = E[r, c]
            if i > 0:
                for r in range(3):
                    origin[i, r] = origin[i - 1, r]
                    for c in range(3):
                        origin[i, r] += R[i - 1, r, c] * p[i, c]
                        R[i, r, c] = R[i - 1, r, 0] * E[0, c] + R[i - 1, r, 1] * E[1, c] + R[i - 1, r, 2] * E[2, c]
            for r in range(3):
                axis[k, i, r] = moment[i, r] = 0.0
                for c in range(3):
                    axis[k, i, r] += R[i, r, c] * axes[i, c]
                    moment[i, r] += R[i, r, c] * pi[i, 1 + c]
        mass = 0.0
        h[:] = 0.0
        for i in range(n - 1, -1, -1):
            mass += pi[i, 0]
            for r in range(3):
                if i + 1 < n:
                    h[r] += (mass - pi[i, 0]) * (origin[i + 1, r] - origin[i, r])
                h[r] += moment[i, r]
            for r in range(3):
                s, t = (r + 1) % 3, (r + 2) % 3
                lever[k, i, r] = axis[k, i, s] * h[t] - axis[k, i, t] * h[s]
    return axis, lever
