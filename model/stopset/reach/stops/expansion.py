"""Inertia, gravity and Christoffel symbols near a pose: value and exact slope there, and a bound of everything beyond.

Every entry of ``M(q)`` is a trigonometric polynomial of degree <= 2 in each angle, of ``g(q)`` of degree <= 1.  So the
slope follows exactly from a few values (M. Riesz's interpolation formula), and Bernstein's inequality bounds the second
derivatives by the size of the part that moves: with ``m = max(i, j, k, l)`` only the composite body behind joint ``m``
enters ``d2 M_ij / dq_k dq_l``, through its inertia and its first moment times the levers to joints i and j.  The sizes
are triangle-inequality bounds over all poses, good for any parameters, physically consistent or not.

Source: M. Riesz (1914) on Bernstein's inequality.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from stopset.robot.rigid import Array, Chain, gravity_torque, mass_matrix

# f'(x) = sum_k RIESZ[k] f(x + SHIFT[k]), exact for degree 2
SHIFT = np.pi / 4.0 * np.array([1.0, 3.0, 5.0, 7.0])
RIESZ = np.array([1.0, -1.0, 1.0, -1.0]) / (8.0 * np.sin(SHIFT / 2.0) ** 2)


class Curvature(NamedTuple):
    """Bounds over all poses: ``|d2 M_ij/dq_k dq_l|`` (n, n, n, n), ``|d2 g_i/dq_k dq_l|`` (n, n, n), and the slope of the
    Christoffel symbols ``|d Gamma_ikl/dq_m|`` (n, n, n, n)."""

    M: Array
    g: Array
    Gamma: Array


class Expansion(NamedTuple):
    """At the pose ``q`` (n,): inertia of the middle payload and of half the payload's range, slopes ``d./dq_k`` last index."""

    q: Array
    M: Array  # (n, n), with rotor inertia
    dM: Array  # (n, n, n)
    Mp: Array  # (n, n): half range, M in M +- |Mp|
    dMp: Array
    g: Array
    dg: Array  # (n, n)
    gp: Array
    dgp: Array
    Gamma: Array  # (n, n, n): c_i = sum Gamma_ikl v_k v_l
    Gammap: Array


def curvature(chain: Chain, pi: Array) -> Curvature:
    """`Curvature` of an arm with parameters bounded by ``|pi|`` (n, 10)."""
    n = pi.shape[0]
    size = np.abs(pi)
    mass, moment, inertia = np.zeros(n + 1), np.zeros(n + 1), np.zeros(n + 1)
    lever = np.zeros((n + 1, n + 1))  # |o_j - o_i| at most
    for i in range(n - 1, -1, -1):
        ixx, ixy, iyy, ixz, iyz, izz = size[i, 4:]
        tensor = np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
        p = float(np.linalg.norm(chain.p[i + 1])) if i + 1 < n else 0.0
        mass[i] = size[i, 0] + mass[i + 1]
        moment[i] = np.linalg.norm(size[i, 1:4]) + moment[i + 1] + mass[i + 1] * p
        # the norm of a matrix of absolute values is no smaller than the matrix's own
        inertia[i] = np.linalg.norm(tensor, 2) + inertia[i + 1] + 2.0 * moment[i + 1] * p + mass[i + 1] * p * p
        for j in range(i + 1, n):
            lever[i, j] = p + lever[i + 1, j]
    weight = float(np.linalg.norm(chain.gravity))
    KM, Kg, KG = np.zeros((n, n, n, n)), np.zeros((n, n, n)), np.zeros((n, n, n, n))
    for i in range(n):
        for k in range(n):
            for m in range(n):
                Kg[i, k, m] = weight * moment[max(i, k, m)]
            for j in range(n):
                for m in range(n):
                    if min(k, m) <= min(i, j) and (k <= min(i, j) or m <= min(i, j)):
                        continue  # turning the whole arm, or all of it from joint min(i, j) on, changes no inertia M_ij
                    b = max(i, j, k, m)
                    KM[i, j, k, m] = 4.0 * (inertia[b] + moment[b] * (lever[i, b] + lever[j, b]))
    for i in range(n):
        for k in range(n):
            for j in range(n):
                KG[i, k, j] = 0.5 * (KM[i, k, j] + KM[i, j, k] + KM[k, j, i])
    return Curvature(KM, Kg, KG)


@njit(cache=True)
def _inertia_slope(chain: Chain, pi: Array, q: Array, M: Array, dM: Array) -> None:
    n = q.shape[0]
    M[:, :] = mass_matrix(chain, pi, q)
    x = q.copy()
    dM[:, :, :] = 0.0
    for k in range(1, n):  # M does not depend on the first angle
        for s in range(4):
            x[k] = q[k] + SHIFT[s]
            value = mass_matrix(chain, pi, x)
            for i in range(k):  # M_ij depends on q_k only if min(i, j) < k
                for j in range(i, n):
                    dM[i, j, k] += RIESZ[s] * value[i, j]
        x[k] = q[k]
        for i in range(k):
            for j in range(i, n):
                dM[j, i, k] = dM[i, j, k]


@njit(cache=True)
def _gravity_slope(chain: Chain, pi: Array, q: Array, g: Array, dg: Array) -> None:
    n = q.shape[0]
    g[:] = gravity_torque(chain, pi, q)
    x = q.copy()
    for k in range(n):
        x[k] = q[k] + 0.5 * np.pi
        up = gravity_torque(chain, pi, x)
        x[k] = q[k] - 0.5 * np.pi
        down = gravity_torque(chain, pi, x)
        x[k] = q[k]
        for i in range(n):
            dg[i, k] = 0.5 * (up[i] - down[i])


@njit(cache=True)
def _christoffel(dM: Array, out: Array) -> None:
    n = dM.shape[0]
    for i in range(n):
        for k in range(n):
            for j in range(n):
                out[i, k, j] = 0.5 * (dM[i, k, j] + dM[i, j, k] - dM[k, j, i])


@njit(cache=True)
def expand(chain: Chain, pi: Array, pi_half: Array, rotor: Array, q: Array) -> Expansion:
    """The local expansion at ``q``; ``pi``: middle of the payload's range, ``pi_half``: half its width, both (n, 10)."""
    n = q.shape[0]
    M, dM, Mp, dMp = np.zeros((n, n)), np.zeros((n, n, n)), np.zeros((n, n)), np.zeros((n, n, n))
    g, dg, gp, dgp = np.zeros(n), np.zeros((n, n)), np.zeros(n), np.zeros((n, n))
    Gamma, Gammap = np.zeros((n, n, n)), np.zeros((n, n, n))
    _inertia_slope(chain, pi, q, M, dM)
    _gravity_slope(chain, pi, q, g, dg)
    _christoffel(dM, Gamma)
    if np.any(pi_half != 0.0):
        _inertia_slope(chain, pi_half, q, Mp, dMp)
        _gravity_slope(chain, pi_half, q, gp, dgp)
        _christoffel(dMp, Gammap)
    for i in range(n):
        M[i, i] += rotor[i]
    return Expansion(q.copy(), M, dM, Mp, dMp, g, dg, gp, dgp, Gamma, Gammap)
