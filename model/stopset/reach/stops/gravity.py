"""Gravity torque over all poses: the largest there is, and bounds of its second slopes (Lemma 10 of docs/stops.md).

Gravity turns joint i by what weighs beside its axis times the sine of the axis' angle to gravity. The angle is decided by the joints before i,
what weighs beside the axis by those behind it, and in which direction it does by joint i: so the largest torque is the product of
the two largest.

The angles that axis i + 1 can have with gravity are those of axis i, a fixed angle more or less. What all behind a joint weighs
beside its axis is found from the tip to the base: the first moment behind joint k can be turned about axis k at will, so all that is
asked of it is its support function over the angle to that axis, held at a grid and from above between.

Source: none needed beyond convexity: a support function of a sum of directions is at most the sum of its values.
"""

from __future__ import annotations

import numpy as np

from stopset.robot.rigid import Chain
from stopset.types import Array

GRID = 90  # intervals of the angle to an axis, 0 to pi, and half those of the angle around it: torques 0.1 % too large on seven joints
OUTWARD = 1e-12  # of sines, of moments by what they are stretched out


def gravity_curvature(chain: Chain, pi: Array) -> tuple[Array, Array]:
    """Over all poses of an arm with parameters ``pi`` (n, 10), no less than ``|d2 g_i/dq_k dq_l|`` (n, n, n) and ``|g_i|`` (n,), N m."""
    n, weight = len(pi), float(np.linalg.norm(chain.gravity))
    slant, beside = _slant(chain), _beside(chain, pi)
    i, k, m = np.ogrid[:n, :n, :n]
    bend = weight * slant[np.minimum(i, np.minimum(k, m))] * beside[np.maximum(i, np.maximum(k, m))]
    return bend, weight * slant * beside


def _angle(a: Array, b: Array) -> float:
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def _slant(chain: Chain) -> Array:
    """(n,) largest sine of the angle between each axis and gravity."""
    out = np.empty(len(chain.axis))
    lo = hi = _angle(chain.R[0] @ chain.axis[0], chain.gravity)
    for i in range(len(out)):
        if i:
            turn = _angle(chain.axis[i - 1], chain.R[i] @ chain.axis[i])
            # the nearest to gravity that it can be, and to gravity's opposite
            lo, hi = max(lo - turn, turn - hi, 0.0), np.pi - max(np.pi - hi - turn, turn - np.pi + lo, 0.0)
        out[i] = 1.0 if lo <= 0.5 * np.pi <= hi else max(np.sin(lo), np.sin(hi))
    return np.minimum(out + OUTWARD, 1.0)


def _beside(chain: Chain, pi: Array) -> Array:
    """(n,) [kg m] largest first moment beside each axis of all that comes behind its joint."""
    n = len(pi)
    out = np.empty(n)
    behind = np.zeros(GRID + 1)  # support function of the first moment behind the next joint, by the angle to its axis
    angle = np.linspace(0.0, np.pi, GRID + 1)[:, None, None]
    around = np.linspace(0.0, 2.0 * np.pi, 2 * GRID, endpoint=False)[:, None]
    bulge = 1.0 / np.cos(0.5 * np.pi / GRID) - 1.0  # of the circle around an axis beyond the polygon of its grid
    mass = reach = 0.0  # behind the joint; and how far its first moment can be from the axis, stretched out
    for i in range(n - 1, -1, -1):
        axis, moment = chain.axis[i], pi[i, 1:4] + (mass * chain.p[i + 1] if i + 1 < n else 0.0)
        stretched = float(np.linalg.norm(np.cross(axis, moment))) + reach
        mass, reach = mass + float(pi[i, 0]), reach + float(np.linalg.norm(moment))
        across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
        across /= np.linalg.norm(across)
        circle = np.cos(around) * across + np.sin(around) * np.cross(axis, across)
        towards = np.cos(angle) * axis + np.sin(angle) * circle  # (angle, around, 3)
        value = towards @ moment
        if i + 1 < n:
            value += _between(behind, towards, chain.R[i + 1] @ chain.axis[i + 1])
        behind = value.max(axis=1) + (2.0 * bulge + OUTWARD) * reach
        out[i] = min(float(behind[GRID // 2]), (1.0 + OUTWARD) * stretched)
    return out


def _between(support: Array, towards: Array, axis: Array) -> Array:
    """A support function known at the grid, in directions ``towards`` (..., 3): a sum of directions is no worse than the sum of theirs."""
    step = np.pi / GRID
    angle = np.arctan2(np.linalg.norm(np.cross(towards, axis), axis=-1), towards @ axis)
    k = np.minimum((angle / step).astype(int), GRID - 1)
    before, after = np.sin((k + 1) * step - angle), np.sin(angle - k * step)
    out: Array = (before * support[k] + after * support[k + 1]) / np.sin(step)
    return out
