"""Where to, and how fast in a direction: sets of displacements and velocities of a point, one per stretch of time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stopset.errors import NotCovered
from stopset.types import Array


def _support(sets: Array, ball: Array, direction: Array) -> Array:
    """(S,) largest component along the unit vector ``direction`` of each set."""
    along = np.einsum("x,sxg->sg", direction, sets)
    out: Array = along[:, 0] + np.abs(along[:, 1:]).sum(axis=1) + ball
    return out


def _unit(direction: Array) -> Array:
    length = float(np.linalg.norm(direction))
    if direction.shape != (3,) or not np.isfinite(length) or length == 0.0:
        raise NotCovered(f"a direction {direction.tolist()}; expected three finite numbers that are not all zero")
    return direction / length


@dataclass(frozen=True, slots=True)
class PointSets:
    """A point at ``start`` (3,) [m]: sets that hold its displacement [m] and velocity [m/s] during each stretch of a stop.

    ``travel``, ``pace``: (S, 3, 1 + g), centre and generators (each times [-1, 1]); ``travel_ball``, ``pace_ball``: (S,) radius of a
    ball on top. ``start`` is known within ``start_error`` [m].
    """

    start: Array
    start_error: float
    travel: Array
    travel_ball: Array
    pace: Array
    pace_ball: Array

    def distance_along(self, direction: Array) -> float:
        """[m], at least 0: how far the point can get along ``direction`` (3,), of any length but zero.

        Raises `NotCovered` for something that is no direction.
        """
        return max(0.0, float(_support(self.travel, self.travel_ball, _unit(direction)).max()))

    def speed_along(self, direction: Array) -> float:
        """[m/s], at least 0: how fast the point can move along ``direction`` (3,). Raises `NotCovered` as above."""
        return max(0.0, float(_support(self.pace, self.pace_ball, _unit(direction)).max()))

    def speed_towards(self, place: Array) -> float:
        """[m/s], at least 0: how fast the point can come closer to ``place`` (3,) [m].

        The direction turns while the point moves: from a start D away, a point that has moved up to r < D sees the place
        within the angle asin(r / D) of where it was seen first. Raises `NotCovered` for a place that is no point.
        """
        d = place - self.start
        distance = float(np.linalg.norm(d))
        far = (
            np.linalg.norm(self.travel[:, :, 0], axis=1)
            + np.linalg.norm(self.travel[:, :, 1:], axis=1).sum(axis=1)
            + self.travel_ball
        )
        fast = (
            np.linalg.norm(self.pace[:, :, 0], axis=1) + np.linalg.norm(self.pace[:, :, 1:], axis=1).sum(axis=1) + self.pace_ball
        )
        r = far + self.start_error
        if place.shape != (3,) or not np.isfinite(distance):
            raise NotCovered(f"a place {place.tolist()}; expected three finite coordinates in metres")
        if distance == 0.0:
            return float(fast.max())
        # |unit vectors' difference| = 2 sin(angle / 2)
        turn = 2.0 * np.sin(0.5 * np.arcsin(np.minimum(r / distance, 1.0)))
        closing = np.where(r < distance, np.minimum(_support(self.pace, self.pace_ball, d / distance) + turn * fast, fast), fast)
        return max(0.0, float(closing.max()))
