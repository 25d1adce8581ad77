"""One capsule around each link's collision geometry: what a stop sweeps is then swept by the links, not by the lines between joints.

A capsule is convex, so it holds a body as soon as it holds points whose hull holds the body: a mesh's vertices, a box's corners, and
of round bodies a polyhedron around them.  The radius is the largest distance of any of the points from the capsule's axis, computed
after the axis is chosen; so the choice decides how tight it is, never whether it holds.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np

from stopset.types import Array

ROUND = 32  # corners of the polygon around a circle: 0.5 % too wide
OUTWARD = 1e-9  # of a length: more than the rounding of the distances


def capsule_around(points: Array) -> Array:
    """(7,) [m] both ends and radius of a small capsule that holds ``points`` (m, 3).

    Its volume is made small from three starts, the principal axes of the points.
    """
    from scipy.optimize import minimize  # half a second, for the few descriptions that have meshes

    rough = _corners(points)
    middle = rough.mean(axis=0)
    _, _, axes = np.linalg.svd(rough - middle)
    best, least = np.zeros(6), np.inf
    for axis in axes:
        along = (rough - middle) @ axis
        aside = np.linalg.norm(rough - middle - along[:, None] * axis, axis=1).max()
        lo, hi = min(along.min() + aside, 0.0), max(along.max() - aside, 0.0)
        start = np.concatenate([middle + lo * axis, middle + hi * axis])
        found = minimize(
            _volume,
            start,
            (rough,),
            method="Nelder-Mead",
            options={"maxfev": 2000, "xatol": 1e-5, "fatol": 1e-9, "adaptive": True},
        )
        if found.fun < least:
            best, least = found.x, found.fun
    radius = distance(points, best).max() * (1 + OUTWARD) + OUTWARD * np.abs(points).max()
    return np.append(best, radius)


def distance(points: Array, ends: Array) -> Array:
    """(m,) [m] of ``points`` (m, 3) from the segment between ``ends`` (6,)."""
    return np.asarray(np.sqrt(_distance2(points, ends)))


def _distance2(points: Array, ends: Array) -> Array:
    """(m,) [m^2]."""
    beyond, line = points - ends[:3], ends[3:6] - ends[:3]
    length2 = line @ line
    if length2 > 0:
        share = np.minimum(np.maximum(beyond @ line / length2, 0.0), 1.0)
        beyond = beyond - share[:, None] * line
    return np.asarray(np.add.reduce(beyond * beyond, axis=1))


def _volume(ends: Array, points: Array) -> float:
    """[m^3], asked thousands of times of a body: with as few calls as there are."""
    r, line = float(np.sqrt(np.maximum.reduce(_distance2(points, ends)))), ends[3:] - ends[:3]
    return np.pi * r**2 * (float(np.sqrt(line @ line)) + 4 / 3 * r)


def _corners(points: Array) -> Array:
    """The points that their hull hangs on; all of them where they are flat."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except (QhullError, ValueError):
        return points


def corners_of(geometry: Any) -> Array | None:
    """(m, 3) [m] points whose hull holds a shape of coal, in the shape's frame; None for a shape without end."""
    kind = type(geometry).__name__
    if kind == "Box":
        return _box(np.asarray(geometry.halfSide))
    if kind == "Sphere":
        return _ball(geometry.radius)
    if kind == "Capsule":
        ball, half = _ball(geometry.radius), np.array([0.0, 0.0, geometry.halfLength])
        return np.vstack([ball + half, ball - half])
    if kind == "Cylinder":
        ring, half = _ring(geometry.radius), np.array([0.0, 0.0, geometry.halfLength])
        return np.vstack([ring + half, ring - half])
    if hasattr(geometry, "vertices"):
        return np.asarray(geometry.vertices(), dtype=float).reshape(-1, 3)
    return None


def _box(half: Array) -> Array:
    return np.array(np.meshgrid(*((-h, h) for h in half))).reshape(3, -1).T


def _ring(radius: float) -> Array:
    """Corners of the regular polygon around a circle."""
    angle = np.arange(ROUND) * 2 * np.pi / ROUND
    wide = radius / np.cos(np.pi / ROUND)
    return np.column_stack([wide * np.cos(angle), wide * np.sin(angle), np.zeros(ROUND)])


def _ball(radius: float) -> Array:
    """Corners of a polyhedron around a ball.

    Every direction is within half a step of a corner's in latitude and in longitude, so the hull reaches ``wide`` times the product
    of both cosines in every direction.
    """
    step = np.pi / ROUND
    latitude = np.linspace(-np.pi / 2, np.pi / 2, ROUND + 1)[:, None]
    longitude = np.arange(2 * ROUND) * step
    wide = radius / np.cos(step / 2) ** 2
    flat = np.cos(latitude)
    unit = np.stack([flat * np.cos(longitude), flat * np.sin(longitude), np.sin(latitude) + 0 * longitude], axis=-1)
    return np.asarray(wide * unit.reshape(-1, 3))


def capsules_of(geometry: Any, lines: Array, lacking: Collection[int], tip: Array) -> tuple[Array, tuple[int, ...]]:
    """(n, 7) capsules around the collision geometry that each joint carries, and the places of joints of which it is not known.

    ``lines``: (n, 7) what those get instead; ``lacking``: places of joints that carry a mesh which is not here; the tool point
    ``tip`` is held too.
    """
    out, bare = lines.copy(), []
    for k in range(len(lines)):
        bodies = [_placed(g) for g in geometry.geometryObjects if g.parentJoint == k + 1]
        points = [b for b in bodies if b is not None]
        if k in lacking or not points or len(points) < len(bodies):
            bare.append(k)
        else:
            out[k] = capsule_around(np.vstack([*points, tip[None]] if k == len(lines) - 1 else points))
    return out, tuple(bare)


def _placed(body: Any) -> Array | None:
    corners = corners_of(body.geometry)
    return None if corners is None or not len(corners) else corners @ body.placement.rotation.T + body.placement.translation
