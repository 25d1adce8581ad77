"""What the arm carries during a stop: the rigid body's parameters over a range of payloads, and what its gears bear."""

from __future__ import annotations

import numpy as np

from stopset.artifact import Model
from stopset.effects.base import Effect, Fitted
from stopset.effects.bound import SIGMAS, uncovered
from stopset.effects.registry import get
from stopset.errors import EffectError, NotCovered
from stopset.robot.arm import standard_parameters
from stopset.types import Array

SAME_PLACE = 1e-6  # [m]


def effect_of(f: Fitted) -> Effect:
    """What a model's effect is. Raises `NotCovered` for one that is not installed here: it may weigh, rub or push."""
    try:
        return get(f.effect)
    except EffectError as e:
        raise NotCovered(uncovered(f.label, "it is in no catalogue that is installed here")) from e


def weighed(model: Model, given: Array | None) -> tuple[float, Array]:
    """How far the mass of identified payloads may be off [kg], and where a payload's mass sits (3,) [m] in the last link's frame.

    Its place is ``given``, or the identified payloads' centre, or the flange.
    """
    mass, mass_uncertainty, moment = 0.0, 0.0, np.zeros(3)
    for f in model.effects:
        effect = effect_of(f)
        if effect.carried:
            m, *first = (t.symbol for t in effect.terms[:4])
            mass, mass_uncertainty = mass + f.values.get(m, 0.0), mass_uncertainty + SIGMAS * f.std.get(m, 0.0)
            moment += [f.values.get(x, 0.0) for x in first]
    com = moment / mass if mass > mass_uncertainty else model.robot.tip
    return mass_uncertainty, np.asarray(com if given is None else given, float)


def bodies(model: Model, payload: tuple[float, float], com: Array) -> tuple[Array, Array]:
    """(n, 10) standard parameters in the middle of the ``payload`` range [kg], and half of what they change by over it.

    ``com``: (3,) [m] its centre in the last link.  ``model.robot.pi`` holds what the arm carried when it was identified, a
    payload found as an effect included; so only what is on top of that is added, and what that was weighed wrongly by: a gain
    of the drives is in the mass and in every reading of the torque, so ``U`` does not show it.  It was weighed wrongly where it is, whatever
    ``com`` says of the rest. Raises `NotCovered` where two masses at two places are known as ranges: no proof holds both.
    """
    carried, off = np.zeros_like(model.robot.pi), np.zeros_like(model.robot.pi)
    (lo, hi), (mass_uncertainty, own) = payload, weighed(model, None)
    if lo < hi and mass_uncertainty > 0.0 and float(np.linalg.norm(com - own)) > SAME_PLACE:
        raise NotCovered(
            f"a payload of {lo:g} to {hi:g} kg at {np.round(com, 4).tolist()} m beside one weighed by its torque to +- {mass_uncertainty:.3g} kg "
            f"at {np.round(own, 4).tolist()} m; expected both at one place: leave the centre out, or describe what the arm carries and identify again"
        )
    carried[-1], off[-1] = per_kg(com), per_kg(own)
    return model.robot.pi + 0.5 * (lo + hi) * carried, 0.5 * (hi - lo) * carried + mass_uncertainty * off


def per_kg(com: Array) -> Array:
    """(10,) standard parameters of the last link that a kilogram of payload at ``com`` (3,) [m] adds."""
    return np.asarray(standard_parameters(1.0, com, np.zeros((3, 3))))


def largest_gravity(model: Model, payload: float, com: Array) -> Array:
    """(n,) [N m] gravity loads the gear of joint i with no more than this in any pose, ``payload`` [kg] included."""
    robot, n = model.robot, model.n
    out = np.zeros(n)
    mass = payload + weighed(model, com)[0]
    moment = mass * float(np.linalg.norm(com))
    for i in range(n - 1, -1, -1):
        p = float(np.linalg.norm(robot.chain.p[i + 1])) if i + 1 < n else 0.0
        moment += float(np.linalg.norm(robot.pi[i, 1:4])) + (mass * p if i + 1 < n else 0.0)
        mass += abs(float(robot.pi[i, 0]))
        out[i] = moment * float(np.linalg.norm(robot.chain.gravity))
    return out
