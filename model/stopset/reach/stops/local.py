"""Inertia and torques while angles and speeds stay in a box, from the local expansion of a pose."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from stopset.reach.stops.expansion import Curvature, Expansion
from stopset.robot.rigid import Array


class Parts(NamedTuple):
    """How much of each part of the bound is taken: all of it. The tests take less, to show that each part is needed."""

    coupling: float = 1.0  # off-diagonal inertia
    christoffel: float = 1.0
    gravity_slope: float = 1.0
    whole_step: float = 1.0  # 0: brakes and speeds taken at the end of each step only


ALL_PARTS = Parts()


class Local(NamedTuple):
    """Over a box: inertia ``M +- M_rad`` for the middle payload and ``Mp +- Mp_rad`` for half its range.

    ``h``: Coriolis and gravity torque; ``e``: ``1/2 v' dM/dq_i v - g_i``, the momentum's rate without input.
    """

    M: Array
    M_rad: Array
    Mp: Array
    Mp_rad: Array
    dM: Array  # all uncertainty of M: M_rad + |Mp| + Mp_rad
    h_lo: Array
    h_hi: Array
    e_lo: Array
    e_hi: Array
    turn: Array  # (n, n, n) how much dM_ij/dq_k can differ from its value at the pose of expansion


@njit(cache=True)
def empty_local(n: int) -> Local:
    """A `Local` to fill."""
    return Local(
        np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n)),
        np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros((n, n, n)),
    )  # fmt: skip


@njit(cache=True)
def box_terms(
    E: Expansion, K: Curvature, x_lo: Array, x_hi: Array, w_lo: Array, w_hi: Array, parts: Parts, out: Local, work: Array
) -> None:
    """Fill ``out`` for angles ``E.q + [x_lo, x_hi]`` and speeds ``[w_lo, w_hi]``; ``work``: (6, n)."""
    n = x_lo.shape[0]
    mid, rad, far, vc, vr, va = work[0], work[1], work[2], work[3], work[4], work[5]
    for k in range(n):
        mid[k], rad[k] = 0.5 * (x_lo[k] + x_hi[k]), 0.5 * (x_hi[k] - x_lo[k])
        far[k] = max(abs(x_lo[k]), abs(x_hi[k]))
        vc[k], vr[k] = 0.5 * (w_lo[k] + w_hi[k]), 0.5 * (w_hi[k] - w_lo[k])
        va[k] = abs(vc[k]) + vr[k]
    _inertia(E, K, mid, rad, far, parts.coupling, out)
    turn = out.turn
    for i in range(n):
        g, r = E.g[i], abs(E.gp[i])
        for k in range(n):
            g += parts.gravity_slope * E.dg[i, k] * mid[k]
            second = 0.0
            for o in range(n):
                second += K.g[i, k, o] * far[o]
            r += parts.gravity_slope * (
                abs(E.dg[i, k]) * rad[k] + (abs(E.dgp[i, k]) + 0.5 * second) * far[k]
            )  # fmt: skip
        c, cr, e, er = 0.0, 0.0, 0.0, 0.0
        for k in range(n):
            for o in range(k, n):
                twice = 1.0 if k == o else 2.0
                product = twice * vc[k] * vc[o]
                spread = twice * (abs(vc[k]) * vr[o] + vr[k] * abs(vc[o]) + vr[k] * vr[o])
                largest = twice * va[k] * va[o]
                G = E.Gamma[i, k, o]
                beyond = abs(E.Gammap[i, k, o]) + 0.5 * (turn[i, k, o] + turn[i, o, k] + turn[k, o, i])
                c += G * product
                cr += abs(G) * spread + beyond * largest
                if k < i:
                    d = 0.5 * E.dM[k, o, i]
                    e += d * product
                    er += abs(d) * spread + 0.5 * (abs(E.dMp[k, o, i]) + turn[k, o, i]) * largest
        share = parts.christoffel
        out.h_lo[i], out.h_hi[i] = g - r + share * (c - cr), g + r + share * (c + cr)
        out.e_lo[i], out.e_hi[i] = share * (e - er) - g - r, share * (e + er) - g + r


@njit(cache=True)
def _inertia(E: Expansion, K: Curvature, mid: Array, rad: Array, far: Array, coupling: float, out: Local) -> None:
    n = mid.shape[0]
    for i in range(n):
        for j in range(i, n):
            m, r, p, pr = E.M[i, j], 0.0, E.Mp[i, j], 0.0
            for k in range(i + 1, n):
                m += E.dM[i, j, k] * mid[k]
                p += E.dMp[i, j, k] * mid[k]
                second = 0.0
                for o in range(i + 1, n):
                    second += K.M[i, j, k, o] * far[o]
                out.turn[i, j, k], out.turn[j, i, k] = second, second
                r += abs(E.dM[i, j, k]) * rad[k] + 0.5 * second * far[k]
                pr += abs(E.dMp[i, j, k]) * rad[k]
            scale = coupling if i != j else 1.0
            out.M[i, j], out.M_rad[i, j], out.Mp[i, j], out.Mp_rad[i, j] = scale * m, scale * r, scale * p, scale * pr
            out.dM[i, j] = scale * (r + abs(p) + pr)
            out.M[j, i], out.M_rad[j, i], out.Mp[j, i] = out.M[i, j], out.M_rad[i, j], out.Mp[i, j]
            out.Mp_rad[j, i], out.dM[j, i] = out.Mp_rad[i, j], out.dM[i, j]
