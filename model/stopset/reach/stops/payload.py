"""What the arm carries during a stop: the rigid body's parameters over a range of payloads, and what its gears bear."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stopset.artifact import Model
from stopset.effects.bound import SIGMAS
from stopset.robot.arm import standard_parameters

Array = NDArray[np.float64]


def bodies(model: Model, payload: tuple[float, float], com: Array) -> tuple[Array, Array]:
    """(n, 10) standard parameters in the middle of the ``payload`` range [kg], and half of what they change by over it.

    ``com``: (3,) [m] its centre in the last link.  ``model.robot.pi`` holds what the arm carried when it was identified, a
    payload found as an effect included; so only what is on top of that is added, and how far its mass may be off.
    """
    per_kg = np.zeros_like(model.robot.pi)
    per_kg[-1] = standard_parameters(1.0, com, np.zeros((3, 3)))
    lo, hi = payload
    return model.robot.pi + 0.5 * (lo + hi) * per_kg, (0.5 * (hi - lo) + payload_doubt(model)) * per_kg


def payload_doubt(model: Model) -> float:
    """[kg] by which the mass of a payload found as an effect may be off; 0 where none was."""
    return sum(SIGMAS * (f.std.get("m", 0.0) or 0.0) for f in model.effects if f.effect == "payload")


def place_of(model: Model, given: Array | None) -> Array:
    """(3,) [m] where a payload sits in the last link: ``given``, else the centre of one found as an effect, else the flange."""
    if given is not None:
        return np.asarray(given, float)
    found = [f.values for f in model.effects if f.effect == "payload"]
    mass = sum(v.get("m", 0.0) for v in found)
    if mass <= payload_doubt(model):
        return np.asarray(model.robot.tip, float)
    return np.array([sum(v.get(k, 0.0) for v in found) for k in ("mx", "my", "mz")]) / mass


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
