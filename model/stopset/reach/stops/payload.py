"""What the arm carries during a stop: the rigid body's parameters over a range of payloads, and what its gears bear."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stopset.artifact import Model
from stopset.robot.arm import standard_parameters

Array = NDArray[np.float64]


def bodies(model: Model, payload: tuple[float, float], com: Array) -> tuple[Array, Array]:
    """(n, 10) standard parameters in the middle of the ``payload`` range [kg], and half of what they change by over it.

    ``com``: (3,) [m] its centre in the last link.  ``model.robot.pi`` holds what the arm carried when it was identified, a
    payload found as an effect included; so only what is on top of that is added.
    """
    per_kg = np.zeros_like(model.robot.pi)
    per_kg[-1] = standard_parameters(1.0, com, np.zeros((3, 3)))
    lo, hi = payload
    return model.robot.pi + 0.5 * (lo + hi) * per_kg, 0.5 * (hi - lo) * per_kg


def largest_gravity(model: Model, payload: float, com: Array) -> Array:
    """(n,) [N m] gravity loads the gear of joint i with no more than this in any pose, ``payload`` [kg] included."""
    robot, n = model.robot, model.n
    out = np.zeros(n)
    mass, moment = payload, payload * float(np.linalg.norm(com))
    for i in range(n - 1, -1, -1):
        p = float(np.linalg.norm(robot.chain.p[i + 1])) if i + 1 < n else 0.0
        moment += float(np.linalg.norm(robot.pi[i, 1:4])) + (mass * p if i + 1 < n else 0.0)
        mass += abs(float(robot.pi[i, 0]))
        out[i] = moment * float(np.linalg.norm(robot.chain.gravity))
    return out
