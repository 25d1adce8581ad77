"""From joint tubes to space: how far a point of the arm can get, how fast, and what a link can sweep.

For a point p of link l, ``d2 p/dq_i dq_k = z_a x (z_b x (p - o_b))`` with ``b = max(i, k)``: its length is at most R_b,
the largest distance of p from axis b.  So around the middle ``c`` of a box of joint displacements

    p(q0 + d) - p(q0)  in  p(q + c) - p(q) + J(q + c) [-r, r]  +  ball(curved part),

and the largest length over the box of the linear part sits at a corner.  Time is cut into slices of equal travel.

Source: stop notes of the project, section on Cartesian bounds.
"""

from __future__ import annotations

from typing import NamedTuple

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
    """

    t: Array
    d_lo: Array
    d_hi: Array
    v_lo: Array
    v_hi: Array
    near_lo: Array | None = None
    near_hi: Array | None = None
    left: Array | None = None


def slices(tube: Tube, count: int) -> Slices:
    """Cut a tube into at most ``count`` stretches of about equal travel of its middle."""
    K, n = len(tube.t) - 1, tube.d_lo.shape[1]
    held = [given(x) for x in (tube.d_lo, tube.d_hi, tube.v_lo, tube.v_hi, tube.e_lo, tube.e_hi, tube.t, tube.travel_left)]
    border, work, out = np.zeros(count + 1), np.empty(K + 1), np.zeros((7, count, n))
    made = lib.stopset_slices(K, n, *(view(x) for x in held), count, view(border), view(work), *(view(x) for x in out))
    return Slices(border[: made + 1], *out[:, :made])


def point_sets(
    chain: Chain, q: Array, q_radius: Array, parts: Slices, link: int, point: Array
) -> tuple[Array, Array, Array, Array]:
    """Sets that hold a point's displacement and velocity during each slice, as centre + generators [-1, 1] + ball.

    ``q +- q_radius``: the angles at the cut; ``point``: (3,) in the link's frame [m]. Returns displacement (S, 3, n + 1) with
    the centre first [m] and the balls' radii (S,), and the same for the velocity [m/s]; all in base coordinates.
    """
    S, n = parts.d_lo.shape
    if not 0 <= link < n or q.shape != (n,) or q_radius.shape != (n,) or point.shape != (3,):
        raise ValueError(f"a point {point.shape} of link {link} at {q.shape} +- {q_radius.shape} for {n} joints")
    travel, pace, balls = np.empty((S, 3, n + 1)), np.empty((S, 3, n + 1)), np.empty((2, S))
    pose = [view(given(x)) for x in (q, q_radius)]
    box = [ffi.NULL if x is None else view(given(x)) for x in parts[1:]]
    arm = arm_struct(chain, None)
    check(
        lib.stopset_point_sets(arm, *pose, S, *box, link, view(given(point)), view(travel), view(balls[0]), view(pace), view(balls[1]))
    )  # fmt: skip
    return travel, balls[0], pace, balls[1]


def point_motion(chain: Chain, q: Array, q_radius: Array, parts: Slices, link: int, point: Array) -> tuple[float, float, Array]:
    """How far and how fast a point of ``link`` can move from where it was: length [m], speed [m/s], box (3, 2) [m].

    Arguments as for `point_sets`; the box is in base coordinates.  However far joints turn, no point leaves the ball about the
    first one that the arm reaches.
    """
    travel, travel_ball, pace, pace_ball = point_sets(chain, q, q_radius, parts, link, point)
    far, fast, box = ffi.new("double *"), ffi.new("double *"), np.empty((3, 2))
    arm, at, sets = arm_struct(chain, None), given(point), [view(x) for x in (travel, travel_ball, pace, pace_ball)]
    lib.stopset_point_motion(arm, len(travel), link, view(at), *sets, far, fast, view(box))
    return far[0], fast[0], box


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
    held = [given(x) for x in (q, q_radius, cut.d_lo, cut.d_hi, capsules)]
    pose, radius, lo, hi, own = (view(x) for x in held)
    check(lib.stopset_swept_capsules(arm_struct(chain, None), pose, radius, S, lo, hi, own, view(out)))
    return out
