"""From joint tubes to space: how far a point of the arm can get, how fast, and what a link can sweep.

For a point p of link l, ``d2 p/dq_i dq_k = z_a x (z_b x (p - o_b))`` with ``b = max(i, k)``: its length is at most R_b,
the largest distance of p from axis b.  So around the middle ``c`` of a box of joint displacements

    p(q0 + d) - p(q0)  in  p(q + c) - p(q) + J(q + c) [-r, r]  +  ball(curved part),

and the largest length over the box of the linear part sits at a corner.  Time is cut into slices of equal travel.

Source: stop notes of the project, section on Cartesian bounds.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from stopset.core.library import check, ffi, given, lib, view
from stopset.reach.stops.tube import Tube
from stopset.robot.rigid import Chain, arm_struct
from stopset.types import Array

SLICES: int = lib.STOPSET_STOP_SLICES


class Slices(NamedTuple):
    """Displacement and speed boxes that hold during whole stretches of time, (S, n); ``t``: (S + 1,) their borders.

    ``near_lo, near_hi, left`` (S, n), where known: the joints were in this box before, and all they have gone since, each divided by
    ``left`` [rad], adds up to 1 at most (what the brakes take is torque times way).
    ``begin_lo, begin_hi`` (S, n), ``energy, path`` (S,), where known: the box at its beginning; what sqrt(v' M v) is at most on it, and its
    integral from the cut to its end.
    """

    t: Array
    d_lo: Array
    d_hi: Array
    v_lo: Array
    v_hi: Array
    near_lo: Array | None = None
    near_hi: Array | None = None
    left: Array | None = None
    begin_lo: Array | None = None
    begin_hi: Array | None = None
    energy: Array | None = None
    path: Array | None = None


def slices(tube: Tube, count: int) -> Slices:
    """Cut a tube into at most ``count`` stretches of about equal travel of its middle."""
    K, n = len(tube.t) - 1, tube.d_lo.shape[1]
    held = {
        name: given(getattr(tube, name))
        for name in ("t", "d_lo", "d_hi", "v_lo", "v_hi", "e_lo", "e_hi", "travel_left", "energy")
    }
    border, work, out, whole = np.zeros(count + 1), np.empty(K + 1), np.zeros((9, count, n)), np.zeros((2, count))
    lines = ffi.new("StopsetTube *", {name: view(x) for name, x in held.items()})
    cut = ffi.new("StopsetSlices *", (count, view(border), *(view(x) for x in (*out, *whole))))
    lib.stopset_slices(lines, K, n, view(work), cut)
    return Slices(border[: cut.count + 1], *out[:, : cut.count], *whole[:, : cut.count])


def slices_struct(parts: Slices) -> tuple[Any, list[Array | None]]:
    """``StopsetSlices`` to be read, and what must live as long."""
    held = [None if x is None else given(x) for x in parts[1:]]
    boxes = [ffi.NULL if x is None else view(x) for x in held]
    return ffi.new("StopsetSlices *", (len(parts.d_lo), ffi.NULL, *boxes)), held


class Reached(NamedTuple):
    """Where a point gets during a stop: largest displacement [m], speed [m/s], box of displacements (3, 2) [m], all in base coordinates.

    Sets that hold displacement and velocity during each slice, as centre + generators [-1, 1] + ball: ``travel``, ``pace`` (S, 3, n + 1)
    with the centre first [m, m/s], ``travel_ball``, ``pace_ball`` (S,) the balls' radii.
    """

    far: float
    fast: float
    box: Array
    travel: Array
    travel_ball: Array
    pace: Array
    pace_ball: Array


def reached(
    chain: Chain,
    q: Array,
    q_radius: Array,
    parts: Slices,
    links: Sequence[int],
    points: Sequence[Array],
    swift: Array | None = None,
) -> list[Reached]:
    """Where points of links get, each ``points[k]`` (3,) [m] in the frame of ``links[k]``; ``q +- q_radius``: the angles at the cut;
    ``swift`` (k,) [kg^-1/2] their `swiftness`, where known.

    However far joints turn, no point leaves the ball about the first one that the arm reaches.
    """
    S, n = parts.d_lo.shape
    at = np.array([*points], float)
    if not all(0 <= x < n for x in links) or q.shape != (n,) or q_radius.shape != (n,) or at.shape != (len(links), 3):
        raise ValueError(f"points {at.shape} of links {list(links)} at {q.shape} +- {q_radius.shape} for {n} joints")
    count, held = len(links), [given(x) for x in (q, q_radius)]
    cut, _held = slices_struct(parts)
    pose = [view(x) for x in held]
    sets, balls, boxes = np.empty((count, 2, S, 3, n + 1)), np.empty((count, 2, S)), np.empty((count, 3, 2))
    arm, most = arm_struct(chain, None), ffi.new("double[2]")
    x, s, b, hull = (ffi.cast("double *", view(a)) for a in (at, sets, balls, boxes))
    out, size = [], S * 3 * (n + 1)
    for k, link in enumerate(links):
        own = ffi.new("StopsetPointSets *", (s + 2 * k * size, b + 2 * k * S, s + (2 * k + 1) * size, b + (2 * k + 1) * S))
        point = ffi.new("StopsetPoint *", (link, x + 3 * k, 0.0 if swift is None else swift[k]))
        check(lib.stopset_point_sets(arm, *pose, cut, point, own))
        lib.stopset_point_motion(arm, point, S, own, most, most + 1, hull + 6 * k)
        out.append(Reached(most[0], most[1], boxes[k], sets[k, 0], balls[k, 0], sets[k, 1], balls[k, 1]))
    return out


def swept_capsules(chain: Chain, q: Array, q_radius: Array, tube: Tube, capsules: Array, pieces: int = 4) -> Array:
    """Capsules that contain what the links sweep during the stop: (pieces, n, 7): both ends [m], radius [m].

    ``capsules``: (n, 7) [m] around each link, in its frame.  Each point of a capsule's axis is the same mixture of its two ends at
    all times, so it stays within the mixture of the ends' balls around their middle positions; the link's own radius comes on top.
    """
    cut = slices(tube, pieces)
    S, n = cut.d_lo.shape
    if q.shape != (n,) or q_radius.shape != (n,) or capsules.shape != (n, 7):
        raise ValueError(f"a pose {q.shape} +- {q_radius.shape}, capsules {capsules.shape} for {n} joints")
    out = np.empty((S, n, 7))
    held = [given(x) for x in (q, q_radius, capsules)]
    pose, radius, own = (view(x) for x in held)
    boxes, _held = slices_struct(cut)
    check(lib.stopset_swept_capsules(arm_struct(chain, None), pose, radius, boxes, own, view(out)))
    return out
