"""How fast a point can be for the energy that the arm has: no body has more of it than all of them (Lemma 14 of the stop notes of the project)."""

from __future__ import annotations

from stopset.core.library import given, lib, view
from stopset.reach.stops.tube import Plant, plant_struct
from stopset.types import Array


def swiftness(plant: Plant, link: int, point: Array) -> float:
    """[kg^-1/2] no point (3,) [m] of a link is faster than this times sqrt(v' M v), whatever the pose, v and the payload; 0: not known.

    Parameters that no body can have, which identification may leave, say nothing, and no more does a link without a mass.
    """
    (struct, _held), at = plant_struct(plant), given(point)
    if at.shape != (3,):
        raise ValueError(f"a point {at.shape}; expected (3,)")
    return float(lib.stopset_swiftness(struct, link, view(at)))
