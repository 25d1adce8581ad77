"""Inertia, gravity and Christoffel symbols near a pose: value and exact slope there, and a bound of everything beyond.

Every entry of ``M(q)`` is a trigonometric polynomial of degree <= 2 in each angle, of ``g(q)`` of degree <= 1.  Its slope is
exact, from the composite body behind joint k turning about axis k; Bernstein's inequality bounds the second derivatives by
the size of the part that moves: with ``m = max(i, j, k, l)`` only the composite body behind joint ``m``
enters ``d2 M_ij / dq_k dq_l``, through its inertia and its first moment times the levers to joints i and j.  The sizes
are triangle-inequality bounds over all poses, good for any parameters, physically consistent or not.  Gravity's derivatives
are those of the potential ``-g . sum m r``: turning about joint m moves only what lies beside its axis, and turning the
whole arm about its first axis turns gravity, of which nothing happens to the part along that axis.

Source: Featherstone, Rigid Body Dynamics Algorithms (2008), ch. 2; Bernstein's inequality as in Zygmund,
Trigonometric Series, ch. X.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from stopset.robot.jit import link_frames
from stopset.robot.rigid import Array, Chain


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
    a, b, c, d = np.ogrid[:n, :n, :n, :n]
    last = np.maximum(np.maximum(a, b), np.maximum(c, d))
    KM = 4.0 * (inertia[last] + moment[last] * (lever[a, last] + lever[b, last]))
    # turning the whole arm, or all of it from joint min(i, j) on, changes no inertia M_ij
    KM[np.broadcast_to(np.minimum(c, d) <= np.minimum(a, b), KM.shape)] = 0.0
    KG = 0.5 * (KM + KM.transpose(0, 2, 1, 3) + KM.transpose(2, 0, 1, 3))
    Kg, load = _gravity_bounds(chain, size, mass, moment)
    return Curvature(KM, Kg, KG, inertia[:n].copy(), load)


def gravity_curvature(chain: Chain, pi: Array) -> tuple[Array, Array]:
    """`Curvature.g` (n, n, n) and `Curvature.load` (n,) alone."""
    n, size = pi.shape[0], np.abs(pi)
    mass, moment = np.zeros(n + 1), np.zeros(n + 1)
    for i in range(n - 1, -1, -1):
        p = float(np.linalg.norm(chain.p[i + 1])) if i + 1 < n else 0.0
        mass[i] = size[i, 0] + mass[i + 1]
        moment[i] = np.linalg.norm(size[i, 1:4]) + moment[i + 1] + mass[i + 1] * p
    return _gravity_bounds(chain, size, mass, moment)


def _gravity_bounds(chain: Chain, size: Array, mass: Array, moment: Array) -> tuple[Array, Array]:
    """Of gravity from the ``mass`` and first ``moment`` (n + 1,) of all that comes behind each joint."""
    n = size.shape[0]
    weight = float(np.linalg.norm(chain.gravity))
    turned = float(np.linalg.norm(np.cross(chain.R[0] @ chain.axis[0], chain.gravity)))  # 0 where the first axis is vertical
    beside = np.array([_beside(chain, size, i, mass[i + 1]) + moment[i + 1] for i in range(n)])
    i, k, m = np.ogrid[:n, :n, :n]
    Kg = np.where(np.minimum(i, np.minimum(k, m)) > 0, weight, turned) * beside[np.maximum(i, np.maximum(k, m))]
    load = weight * beside
    load[0] = turned * beside[0]
    return Kg, load


def _beside(chain: Chain, size: Array, i: int, carried: float) -> float:
    """First moment [kg m] beside axis i of link i and of ``carried`` kg at the next joint, at most; ``size`` bounds ``|pi|``."""
    a = np.abs(chain.axis[i])

    def away(x: Array) -> float:
        x = np.abs(x)
        return float(np.linalg.norm([a[1] * x[2] + a[2] * x[1], a[2] * x[0] + a[0] * x[2], a[0] * x[1] + a[1] * x[0]]))

    own = min(away(size[i, 1:4]), float(np.linalg.norm(size[i, 1:4])))
    if i + 1 == len(size):
        return own
    p = chain.p[i + 1]
    return own + carried * min(away(p), float(np.linalg.norm(p)))


@njit(cache=True, inline="always")
def _cross(a0: float, a1: float, a2: float, b0: float, b1: float, b2: float) -> tuple[float, float, float]:
    return a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0


@njit(cache=True)
def _composites(pi: Array, R: Array, o: Array, mass: Array, moment: Array, inertia: Array) -> None:
    """Mass, first moment (n, 3) and inertia (n, 3, 3) about the base origin of everything from joint i on, in base axes."""
    n = pi.shape[0]
    T, A = np.zeros((3, 3)), np.zeros((3, 3))
    for i in range(n - 1, -1, -1):
        P, Ri = pi[i], R[i]
        T[0, 0], T[0, 1], T[1, 1], T[0, 2], T[1, 2], T[2, 2] = P[4], P[5], P[6], P[7], P[8], P[9]
        T[1, 0], T[2, 0], T[2, 1] = P[5], P[7], P[8]
        h0 = Ri[0, 0] * P[1] + Ri[0, 1] * P[2] + Ri[0, 2] * P[3]
        h1 = Ri[1, 0] * P[1] + Ri[1, 1] * P[2] + Ri[1, 2] * P[3]
        h2 = Ri[2, 0] * P[1] + Ri[2, 1] * P[2] + Ri[2, 2] * P[3]
        h = (h0, h1, h2)
        p = (o[i, 0], o[i, 1], o[i, 2])
        hp = 2.0 * (h0 * p[0] + h1 * p[1] + h2 * p[2]) + P[0] * (p[0] ** 2 + p[1] ** 2 + p[2] ** 2)
        for r in range(3):
            for c in range(3):
                A[r, c] = Ri[r, 0] * T[0, c] + Ri[r, 1] * T[1, c] + Ri[r, 2] * T[2, c]
        for r in range(3):
            for c in range(3):
                x = A[r, 0] * Ri[c, 0] + A[r, 1] * Ri[c, 1] + A[r, 2] * Ri[c, 2]
                x -= h[r] * p[c] + p[r] * h[c] + P[0] * p[r] * p[c]
                inertia[i, r, c] = x + (hp if r == c else 0.0)
                if i + 1 < n:
                    inertia[i, r, c] += inertia[i + 1, r, c]
            moment[i, r] = h[r] + P[0] * p[r]
            if i + 1 < n:
                moment[i, r] += moment[i + 1, r]
        mass[i] = P[0] + (mass[i + 1] if i + 1 < n else 0.0)


@njit(cache=True, inline="always")
def _momentum_of(
    m: float, h: Array, inertia: Array, w: tuple[float, float, float], v: tuple[float, float, float]
) -> tuple[float, float, float, float, float, float]:
    """Angular momentum about the base origin and linear momentum of a body that turns with ``w`` and moves with ``v`` there."""
    a = _cross(h[0], h[1], h[2], v[0], v[1], v[2])
    b = _cross(w[0], w[1], w[2], h[0], h[1], h[2])
    return (
        inertia[0, 0] * w[0] + inertia[0, 1] * w[1] + inertia[0, 2] * w[2] + a[0],
        inertia[1, 0] * w[0] + inertia[1, 1] * w[1] + inertia[1, 2] * w[2] + a[1],
        inertia[2, 0] * w[0] + inertia[2, 1] * w[1] + inertia[2, 2] * w[2] + a[2],
        m * v[0] + b[0], m * v[1] + b[1], m * v[2] + b[2],
    )  # fmt: skip


@njit(cache=True, inline="always")
def _along(z: Array, s: Array, f: tuple[float, float, float, float, float, float]) -> float:
    """Power of the wrench ``f`` along the twist (z, s)."""
    return float(z[0] * f[0] + z[1] * f[1] + z[2] * f[2] + s[0] * f[3] + s[1] * f[4] + s[2] * f[5])


@njit(cache=True)
def _slopes(
    pi: Array, gravity: Array, R: Array, o: Array, z: Array, s: Array,
    mass: Array, moment: Array, inertia: Array, M: Array, dM: Array, g: Array, dg: Array, Gamma: Array,
) -> None:  # fmt: skip
    """Exact M, dM/dq_k, g, dg/dq_k and Christoffel symbols, by turning composite bodies about axis k (twists ``z, s``)."""
    n = pi.shape[0]
    _composites(pi, R, o, mass, moment, inertia)
    a = (gravity[0], gravity[1], gravity[2])
    rest = (0.0, 0.0, 0.0)
    for j in range(n):
        zj, sj = (z[j, 0], z[j, 1], z[j, 2]), (s[j, 0], s[j, 1], s[j, 2])
        f = _momentum_of(mass[j], moment[j], inertia[j], zj, sj)
        weight = _momentum_of(mass[j], moment[j], inertia[j], rest, a)
        for i in range(j + 1):
            M[i, j] = _along(z[i], s[i], f)
            M[j, i] = M[i, j]
        g[j] = -_along(z[j], s[j], weight)
        for k in range(1, j + 1):  # the arm from k on turns, with joint j in it: its momentum turns along
            zk, sk = (z[k, 0], z[k, 1], z[k, 2]), (s[k, 0], s[k, 1], s[k, 2])
            x, y = _cross(zk[0], zk[1], zk[2], f[0], f[1], f[2]), _cross(sk[0], sk[1], sk[2], f[3], f[4], f[5])
            p = _cross(zk[0], zk[1], zk[2], f[3], f[4], f[5])
            turned = (x[0] + y[0], x[1] + y[1], x[2] + y[2], p[0], p[1], p[2])
            for i in range(k):
                dM[i, j, k] = _along(z[i], s[i], turned)
                dM[j, i, k] = dM[i, j, k]
        for k in range(n):
            zk, sk = (z[k, 0], z[k, 1], z[k, 2]), (s[k, 0], s[k, 1], s[k, 2])
            b = max(j, k)
            ga = _cross(zk[0], zk[1], zk[2], a[0], a[1], a[2])
            f2 = _momentum_of(mass[b], moment[b], inertia[b], rest, ga)
            dg[j, k] = _along(z[j], s[j], f2)
            if k > j:
                w = _momentum_of(mass[k], moment[k], inertia[k], rest, a)
                x, y = _cross(zk[0], zk[1], zk[2], w[0], w[1], w[2]), _cross(sk[0], sk[1], sk[2], w[3], w[4], w[5])
                p = _cross(zk[0], zk[1], zk[2], w[3], w[4], w[5])
                dg[j, k] -= _along(z[j], s[j], (x[0] + y[0], x[1] + y[1], x[2] + y[2], p[0], p[1], p[2]))
                # the bodies from k on turn under joint j's motion
                f3 = _momentum_of(mass[k], moment[k], inertia[k], zj, sj)
                x, y = _cross(zk[0], zk[1], zk[2], f3[0], f3[1], f3[2]), _cross(sk[0], sk[1], sk[2], f3[3], f3[4], f3[5])
                p = _cross(zk[0], zk[1], zk[2], f3[3], f3[4], f3[5])
                tw = _cross(zk[0], zk[1], zk[2], zj[0], zj[1], zj[2])
                tv1 = _cross(zk[0], zk[1], zk[2], sj[0], sj[1], sj[2])
                tv2 = _cross(sk[0], sk[1], sk[2], zj[0], zj[1], zj[2])
                tv = (tv1[0] + tv2[0], tv1[1] + tv2[1], tv1[2] + tv2[2])
                f4 = _momentum_of(mass[k], moment[k], inertia[k], tw, tv)
                d = (
                    x[0] + y[0] - f4[0], x[1] + y[1] - f4[1], x[2] + y[2] - f4[2],
                    p[0] - f4[3], p[1] - f4[4], p[2] - f4[5],
                )  # fmt: skip
                for i in range(j + 1):
                    dM[i, j, k] = _along(z[i], s[i], d)
                    dM[j, i, k] = dM[i, j, k]
    for i in range(n):
        for k in range(n):
            for j in range(n):
                Gamma[i, k, j] = 0.5 * (dM[i, k, j] + dM[i, j, k] - dM[k, j, i])


class Scratch(NamedTuple):
    """Work arrays of `expand_into`."""

    z: Array
    s: Array
    mass: Array
    moment: Array
    inertia: Array


@njit(cache=True)
def empty_expansion(n: int) -> tuple[Expansion, Scratch]:
    """An expansion to fill, and its scratch."""
    return Expansion(
        np.zeros(n), np.zeros((n, n)), np.zeros((n, n, n)), np.zeros((n, n)), np.zeros((n, n, n)),
        np.zeros(n), np.zeros((n, n)), np.zeros(n), np.zeros((n, n)), np.zeros((n, n, n)), np.zeros((n, n, n)),
    ), Scratch(np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n), np.zeros((n, 3)), np.zeros((n, 3, 3)))  # fmt: skip


@njit(cache=True)
def expand_into(chain: Chain, pi: Array, pi_half: Array, rotor: Array, q: Array, E: Expansion, w: Scratch) -> None:
    """Fill ``E`` with the local expansion at ``q``; ``pi``: middle of the payload's range, ``pi_half``: half its width."""
    n = q.shape[0]
    R, o = link_frames(chain, q)
    for i in range(n):
        E.q[i] = q[i]
        for r in range(3):
            w.z[i, r] = R[i, r, 0] * chain.axis[i, 0] + R[i, r, 1] * chain.axis[i, 1] + R[i, r, 2] * chain.axis[i, 2]
        w.s[i] = _cross(o[i, 0], o[i, 1], o[i, 2], w.z[i, 0], w.z[i, 1], w.z[i, 2])
    _slopes(pi, chain.gravity, R, o, w.z, w.s, w.mass, w.moment, w.inertia, E.M, E.dM, E.g, E.dg, E.Gamma)
    for i in range(n):
        E.M[i, i] += rotor[i]
    if np.any(pi_half[n - 1] != 0.0):
        _slopes(pi_half, chain.gravity, R, o, w.z, w.s, w.mass, w.moment, w.inertia, E.Mp, E.dMp, E.gp, E.dgp, E.Gammap)


@njit(cache=True)
def expand(chain: Chain, pi: Array, pi_half: Array, rotor: Array, q: Array) -> Expansion:
    """The local expansion at ``q``, in arrays of its own."""
    E, w = empty_expansion(q.shape[0])
    expand_into(chain, pi, pi_half, rotor, q, E, w)
    return E
