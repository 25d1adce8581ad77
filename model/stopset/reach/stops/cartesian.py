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
from numba import njit

from stopset.reach.stops.tube import Tube
from stopset.robot.jit import link_frames
from stopset.robot.rigid import Array, Chain

SLICES = 10


class Slices(NamedTuple):
    """Displacement and speed boxes that hold during whole stretches of time, (S, n); ``t``: (S + 1,) their borders."""

    t: Array
    d_lo: Array
    d_hi: Array
    v_lo: Array
    v_hi: Array


@njit(cache=True)
def slices(tube: Tube, count: int) -> Slices:
    """Cut a tube into at most ``count`` stretches of about equal travel of its middle."""
    t, d_lo, d_hi, v_lo, v_hi, e_lo, e_hi = tube.t, tube.d_lo, tube.d_hi, tube.v_lo, tube.v_hi, tube.e_lo, tube.e_hi
    K, n = t.shape[0] - 1, d_lo.shape[1]
    way = np.zeros(K + 1)
    for k in range(K):
        s = 0.0
        for i in range(n):
            s += 0.5 * abs(d_lo[k + 1, i] + d_hi[k + 1, i] - d_lo[k, i] - d_hi[k, i])
        way[k + 1] = way[k] + s
    border = np.zeros(count + 1)
    out_dl, out_dh = np.zeros((count, n)), np.zeros((count, n))
    out_vl, out_vh = np.zeros((count, n)), np.zeros((count, n))
    begin, made = 0, 0
    for s in range(count):
        end = begin + 1
        while end < K and (s == count - 1 or way[end] < way[K] * (s + 1) / count):
            end += 1
        if begin >= K:
            break
        for i in range(n):
            dl, dh = np.inf, -np.inf
            vl, vh = np.inf, -np.inf
            for k in range(begin, end + 1):
                dl, dh = min(dl, d_lo[k, i]), max(dh, d_hi[k, i])
                vl, vh = min(vl, v_lo[k, i]), max(vh, v_hi[k, i])
                if k < end:
                    vl, vh = min(vl, e_lo[k, i]), max(vh, e_hi[k, i])
                    # a displacement bound that turns round within a step bulges out by less than half of it
                    h = t[k + 1] - t[k]
                    if v_hi[k, i] > 0.0 and e_hi[k, i] <= 0.0:
                        dh = max(dh, d_hi[k, i] + 0.5 * h * v_hi[k, i])
                    if v_lo[k, i] < 0.0 and e_lo[k, i] >= 0.0:
                        dl = min(dl, d_lo[k, i] + 0.5 * h * v_lo[k, i])
            out_dl[s, i], out_dh[s, i], out_vl[s, i], out_vh[s, i] = dl, dh, vl, vh
        made = s + 1
        border[made] = t[end]
        begin = end
    return Slices(border[: made + 1], out_dl[:made], out_dh[:made], out_vl[:made], out_vh[:made])


@njit(cache=True)
def _point(chain: Chain, q: Array, link: int, point: Array) -> tuple[Array, Array, Array]:
    """Position (3,), Jacobian (3, n) and distance from each axis (n,) of a point of ``link``, zero for joints beyond."""
    n = q.shape[0]
    R, o = link_frames(chain, q)
    p = o[link] + R[link] @ point
    J, dist = np.zeros((3, n)), np.zeros(n)
    for i in range(link + 1):
        z, a = R[i] @ chain.axis[i], p - o[i]
        J[0, i] = z[1] * a[2] - z[2] * a[1]
        J[1, i] = z[2] * a[0] - z[0] * a[2]
        J[2, i] = z[0] * a[1] - z[1] * a[0]
        dist[i] = np.sqrt(J[0, i] ** 2 + J[1, i] ** 2 + J[2, i] ** 2)
    return p, J, dist


@njit(cache=True)
def _reach(dist: Array, radius: Array, link: int) -> Array:
    """Largest distance from each axis while the angles stay within ``radius``: tip to base, it moves by the joints beyond."""
    out = np.zeros(dist.shape[0])
    beyond = 0.0
    for i in range(link, -1, -1):
        out[i] = dist[i] + beyond
        beyond += out[i] * radius[i]
    return out


@njit(cache=True)
def _curved(reach: Array, r: Array, s: Array, link: int) -> float:
    total = 0.0
    for i in range(link + 1):
        for k in range(link + 1):
            total += reach[max(i, k)] * r[i] * s[k]
    return total


@njit(cache=True)
def _longest(start: Array, J: Array, radius: Array, link: int) -> float:
    """Largest length of ``start + J [-radius, radius]``: at a corner, since a length is convex; Gray code over corners."""
    p = start.copy()
    sign = np.ones(link + 1)
    for i in range(link + 1):
        p += J[:, i] * radius[i]
    best = p[0] ** 2 + p[1] ** 2 + p[2] ** 2
    for c in range(1, 1 << (link + 1)):
        i = 0
        while (c >> i) & 1 == 0:
            i += 1
        sign[i] = -sign[i]
        for r in range(3):
            p[r] += 2.0 * sign[i] * radius[i] * J[r, i]
        best = max(best, p[0] ** 2 + p[1] ** 2 + p[2] ** 2)
    return float(np.sqrt(best))


@njit(cache=True)
def point_sets(
    chain: Chain, q: Array, q_radius: Array, parts: Slices, link: int, point: Array
) -> tuple[Array, Array, Array, Array]:
    """Sets that hold a point's displacement and velocity during each slice, as centre + generators [-1, 1] + ball.

    ``q +- q_radius``: the angles at the cut; ``point``: (3,) in the link's frame [m]. Returns displacement (S, 3, n + 1) with
    the centre first [m] and the balls' radii (S,), and the same for the velocity [m/s]; all in base coordinates.
    """
    n, S = q.shape[0], parts.d_lo.shape[0]
    _, J0, _ = _point(chain, q, link, point)
    p0 = _point(chain, q, link, point)[0]
    way, pace = np.zeros((S, 3, n + 1)), np.zeros((S, 3, n + 1))
    way_ball, pace_ball = np.zeros(S), np.zeros(S)
    wide, c, r, vc, vr = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    for s in range(S):
        for i in range(n):
            c[i], r[i] = 0.5 * (parts.d_lo[s, i] + parts.d_hi[s, i]), 0.5 * (parts.d_hi[s, i] - parts.d_lo[s, i])
            vc[i], vr[i] = 0.5 * (parts.v_lo[s, i] + parts.v_hi[s, i]), 0.5 * (parts.v_hi[s, i] - parts.v_lo[s, i])
            wide[i] = r[i] + q_radius[i]
        p, J, dist = _point(chain, q + c, link, point)
        reach = _reach(dist, wide + np.abs(c), link)  # also on the way from q to q + c
        way_ball[s] = 0.5 * _curved(reach, wide, wide, link) + 0.5 * _curved(reach, q_radius, q_radius, link)
        pace_ball[s] = _curved(reach, wide, np.abs(vc) + vr, link)
        for x in range(3):
            way[s, x, 0] = p[x] - p0[x]
        for i in range(link + 1):
            way_ball[s] += q_radius[i] * np.sqrt(np.sum((J[:, i] - J0[:, i]) ** 2))
            for x in range(3):
                way[s, x, i + 1], pace[s, x, i + 1] = J[x, i] * r[i], J[x, i] * vr[i]
                pace[s, x, 0] += J[x, i] * vc[i]
    return way, way_ball, pace, pace_ball


@njit(cache=True)
def point_motion(chain: Chain, q: Array, q_radius: Array, parts: Slices, link: int, point: Array) -> tuple[float, float, Array]:
    """How far and how fast a point of ``link`` can move from where it was: length [m], speed [m/s], box (3, 2) [m].

    Arguments as for `point_sets`; the box is in base coordinates.  However far joints turn, no point leaves the ball about the
    first one that the arm reaches.
    """
    way, way_ball, pace, pace_ball = point_sets(chain, q, q_radius, parts, link, point)
    far, fast = 0.0, 0.0
    reach = np.sqrt(np.sum(point**2))
    for i in range(1, link + 1):
        reach += np.sqrt(np.sum(chain.p[i] ** 2))
    box = np.zeros((3, 2))
    one = np.ones(q.shape[0])
    for s in range(way.shape[0]):
        far = max(far, _longest(way[s, :, 0].copy(), way[s, :, 1:].copy(), one, link) + way_ball[s])
        fast = max(fast, _longest(pace[s, :, 0].copy(), pace[s, :, 1:].copy(), one, link) + pace_ball[s])
        for x in range(3):
            half = way_ball[s]
            for i in range(link + 1):
                half += abs(way[s, x, i + 1])
            box[x, 0] = min(box[x, 0], way[s, x, 0] - half)
            box[x, 1] = max(box[x, 1], way[s, x, 0] + half)
    return min(far, 2.0 * reach), fast, np.minimum(np.maximum(box, -2.0 * reach), 2.0 * reach)


@njit(cache=True)
def swept_capsules(chain: Chain, q: Array, q_radius: Array, tube: Tube, tip: Array, pieces: int = 4) -> Array:
    """Capsules that contain every link's axis during the stop: (pieces, n, 7): both ends [m], radius [m]; add the link's own.

    Each point of a link's axis is the same mixture of its two ends at all times, so it stays within the mixture of the
    ends' balls around their middle positions.
    """
    cut = slices(tube, pieces)
    n, here = q.shape[0], np.zeros(3)
    out = np.zeros((cut.d_lo.shape[0], n, 7))
    for s in range(cut.d_lo.shape[0]):
        c, r = 0.5 * (cut.d_lo[s] + cut.d_hi[s]), 0.5 * (cut.d_hi[s] - cut.d_lo[s]) + q_radius
        for link in range(n):
            far = chain.p[link + 1].copy() if link + 1 < n else tip
            radius = 0.0
            for e in range(2):
                p, J, dist = _point(chain, q + c, link, here if e == 0 else far)
                out[s, link, 3 * e : 3 * e + 3] = p
                ball = 0.5 * _curved(_reach(dist, r, link), r, r, link)
                radius = max(radius, _longest(np.zeros(3), J, r, link) + ball)
            out[s, link, 6] = radius
    return out
