"""How fast a point can be for the energy that the arm has: no body has more of it than all of them.

``m |v_c|^2 + w' I_c w <= v' M v`` of a link's body, and ``v_p = v_c + w x r`` of its point r from the centre of mass, so

    |v_p| <= swiftness sqrt(v' M v),   swiftness^2 = lambda_max(1 / m + [r] I_c^-1 [r]')

in every pose: what light wrists may do, whose speeds the energy hardly bounds, moves the mass that they carry no faster.

Source: Featherstone (2008), ch. 2, for a body's inertia; Lemma 14 of the stop notes of the project.
"""

from __future__ import annotations

import numpy as np

from stopset.reach.stops.tube import Plant
from stopset.types import Array

ROUNDED = 1e-12  # of a body's inertia is rounding
FLAT = 1e-9  # an inertia about one axis, over that about another, below which its inverse is not known
MARGIN = 1.0 + 1e-6


def _central_inertia(pi: Array) -> Array:
    """(3, 3) [kg m^2] about the centre of mass, of parameters (10,) with a mass."""
    m, h, (xx, xy, yy, xz, yz, zz) = pi[0], pi[1:4], pi[4:]
    about_origin = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return np.asarray(about_origin - (h @ h * np.eye(3) - np.outer(h, h)) / m)


def _is_body(pi: Array) -> bool:
    """Whether no motion gives these parameters (10,) a negative energy, but for rounding."""
    if pi[0] <= 0.0:
        return not pi.any()
    own = np.linalg.eigvalsh(_central_inertia(pi))
    return bool(own[0] >= -ROUNDED * np.abs(pi[4:]).max())


def swiftness(plant: Plant, link: int, point: Array) -> float:
    """[kg^-1/2] no point (3,) [m] of a link is faster than this times sqrt(v' M v), whatever the pose, v and the payload; 0: not known.

    A body's energy is no more than the arm's: ``m |v_c|^2 + w' I_c w <= v' M v``, and ``v_p = v_c + w x r`` (Lemma 14 of docs/stops.md).
    A payload only adds to it. Parameters that no body can have, which identification may leave, say nothing.
    """
    lightest = plant.pi - plant.pi_half
    if not all(_is_body(x) for x in (*lightest, *plant.pi_half)):
        return 0.0
    own = lightest[link]
    if own[0] <= 0.0:
        return 0.0
    x, y, z = point - own[1:4] / own[0]
    turn, (values, axes) = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]), np.linalg.eigh(_central_inertia(own))
    if not values[0] > FLAT * values[2]:
        return 0.0
    across = turn @ axes / np.sqrt(values)
    return float(np.sqrt(np.linalg.eigvalsh(np.eye(3) / own[0] + across @ across.T)[2]) * MARGIN)
