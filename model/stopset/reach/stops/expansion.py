"""Inertia, gravity and Christoffel symbols near a pose: value and exact slope there, and a bound of everything beyond.

Every entry of ``M(q)`` is a trigonometric polynomial of degree <= 2 in each angle, of ``g(q)`` of degree <= 1.  Its slope is
exact, from the composite body behind joint k turning about axis k.  So are the second slopes of M that the tube uses; its third
ones are bounded near the pose by the roots of inertia of what moves (Lemma 4 of docs/stops.md).  Over all poses Bernstein's inequality
bounds second derivatives by the size of the part that moves: with ``m = max(i, j, k, l)`` only the composite body behind joint ``m``
enters ``d2 M_ij / dq_k dq_l``, through its inertia and its first moment times the distances to joints i and j.  The sizes
are triangle-inequality bounds over all poses, good for any parameters, physically consistent or not.

Source: Featherstone, Rigid Body Dynamics Algorithms (2008), ch. 2; Bernstein's inequality as in Zygmund,
Trigonometric Series, ch. X.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from stopset.core.library import check, ffi, given, lib, view
from stopset.reach.stops.gravity import gravity_curvature
from stopset.robot.rigid import Chain, arm_struct
from stopset.types import Array


class Curvature(NamedTuple):
    """Bounds over all poses: ``|d2 M_ij/dq_k dq_l|`` (n, n, n, n), ``|d2 g_i/dq_k dq_l|`` (n, n, n), and the slope of the
    Christoffel symbols ``|d Gamma_ikl/dq_m|`` (n, n, n, n); and of ``M_ii`` without rotor and ``|g_i|`` themselves (n,)."""

    M: Array
    g: Array
    Gamma: Array
    size: Array
    load: Array


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
    """`Curvature` of an arm with parameters ``pi`` (n, 10)."""
    n = pi.shape[0]
    size = np.abs(pi)
    mass, moment, inertia = np.zeros(n + 1), np.zeros(n + 1), np.zeros(n + 1)
    distance = np.zeros((n + 1, n + 1))  # |o_j - o_i| at most
    for i in range(n - 1, -1, -1):
        ixx, ixy, iyy, ixz, iyz, izz = size[i, 4:]
        tensor = np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
        p = float(np.linalg.norm(chain.p[i + 1])) if i + 1 < n else 0.0
        mass[i] = size[i, 0] + mass[i + 1]
        moment[i] = np.linalg.norm(size[i, 1:4]) + moment[i + 1] + mass[i + 1] * p
        # the norm of a matrix of absolute values is no smaller than the matrix's own
        inertia[i] = np.linalg.norm(tensor, 2) + inertia[i + 1] + 2.0 * moment[i + 1] * p + mass[i + 1] * p * p
        for j in range(i + 1, n):
            distance[i, j] = p + distance[i + 1, j]
    a, b, c, d = np.ogrid[:n, :n, :n, :n]
    last = np.maximum(np.maximum(a, b), np.maximum(c, d))
    KM = 4.0 * (inertia[last] + moment[last] * (distance[a, last] + distance[b, last]))
    # turning the whole arm, or all of it from joint min(i, j) on, changes no inertia M_ij
    KM[np.broadcast_to(np.minimum(c, d) <= np.minimum(a, b), KM.shape)] = 0.0
    KG = 0.5 * (KM + KM.transpose(0, 2, 1, 3) + KM.transpose(2, 0, 1, 3))
    Kg, load = gravity_curvature(chain, pi)
    return Curvature(KM, Kg, KG, inertia[:n].copy(), load)


def expand(chain: Chain, pi: Array, pi_half: Array, rotor: Array, q: Array) -> Expansion:
    """The local expansion at ``q``; ``pi``: middle of the payload's range, ``pi_half``: half its width."""
    n = len(q)
    if q.shape != (n,) or rotor.shape != (n,) or pi_half.shape != (n, 10):
        raise ValueError(f"a pose {q.shape} with rotors {rotor.shape}, half a payload {pi_half.shape}")
    one, two, three = (n,), (n, n), (n, n, n)
    shapes = (two, three, two, three, one, two, one, two, three, three)
    M, dM, Mp, dMp, g, dg, gp, dgp, Gamma, Gammap = out = [np.empty(s) for s in shapes]
    held = [given(x) for x in (pi_half, rotor, q)]
    middle, half = (
        ffi.new("StopsetExpansion *", tuple(view(x) for x in part))
        for part in ((M, dM, g, dg, Gamma), (Mp, dMp, gp, dgp, Gammap))
    )
    check(lib.stopset_expand(arm_struct(chain, pi), *(view(x) for x in held), middle, half))
    return Expansion(q.copy(), *out)
