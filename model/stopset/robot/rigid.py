"""Rigid-body dynamics of a serial arm of revolute joints, compiled.

Newton and Euler's equations about each link frame's origin are linear in the ten *standard parameters* of a link
``[m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz]`` (inertia about the link frame's origin; pinocchio's order), so one
pass serves torque, mass matrix and regressor alike.  Compiled by numba, because the simulator, the stop bounds and the
monitor call these some 10^5 times a second, where a Python binding's call alone would cost more than the arithmetic,
and because the monitor's host should not carry a 380 MB library.  The tests hold every function here to pinocchio.

Frames: link frame ``i`` moves with joint ``i``; ``chain.R[i], chain.p[i]`` place it in link ``i-1`` at ``q_i = 0``;
``chain.axis[i]`` is the joint axis in link frame ``i``.  SI units throughout.

Source: Featherstone, Rigid Body Dynamics Algorithms (2008), ch. 5 and 6; Liu & Althoff (2018), eq. (3).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Chain(NamedTuple):
    """Geometry of a serial arm with ``n`` revolute joints."""

    R: Array  # (n, 3, 3) link frame i in link frame i-1 at q = 0
    p: Array  # (n, 3) [m]
    axis: Array  # (n, 3) unit vectors
    gravity: Array  # (3,) [m/s^2] in the base frame, e.g. (0, 0, -9.81)


@njit(cache=True, inline="always")
def _cross(a: Array, b: Array) -> Array:
    out = np.empty(3)
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]
    return out


@njit(cache=True, inline="always")
def _mv(R: Array, v: Array) -> Array:
    out = np.empty(3)
    for r in range(3):
        out[r] = R[r, 0] * v[0] + R[r, 1] * v[1] + R[r, 2] * v[2]
    return out


@njit(cache=True, inline="always")
def _mtv(R: Array, v: Array) -> Array:
    out = np.empty(3)
    for r in range(3):
        out[r] = R[0, r] * v[0] + R[1, r] * v[1] + R[2, r] * v[2]
    return out


@njit(cache=True, nogil=True)
def turn(R0: Array, axis: Array, angle: float, out: Array) -> None:
    """``out`` (3, 3): the rotation ``R0`` followed by one about ``axis`` by ``angle`` [rad] (Rodrigues)."""
    s, c = np.sin(angle), np.cos(angle)
    x, y, z = axis[0], axis[1], axis[2]
    d = 1.0 - c
    for r in range(3):
        a0, a1, a2 = R0[r, 0], R0[r, 1], R0[r, 2]
        out[r, 0] = a0 * (c + x * x * d) + a1 * (y * x * d + z * s) + a2 * (z * x * d - y * s)
        out[r, 1] = a0 * (x * y * d - z * s) + a1 * (c + y * y * d) + a2 * (z * y * d + x * s)
        out[r, 2] = a0 * (x * z * d + y * s) + a1 * (y * z * d - x * s) + a2 * (c + z * z * d)


@njit(cache=True)
def _joint_rotations(chain: Chain, q: Array) -> Array:
    """(n, 3, 3): rotation of link frame i in link frame i-1 at ``q``."""
    n = q.shape[0]
    out = np.empty((n, 3, 3))
    for i in range(n):
        turn(chain.R[i], chain.axis[i], q[i], out[i])
    return out


@njit(cache=True)
def _motion(chain: Chain, Rj: Array, dq: Array, ddq: Array, gravity: Array) -> tuple[Array, Array, Array]:
    """Angular velocity, angular acceleration and (gravity-free) acceleration of each link frame's origin, (n, 3) each."""
    n = dq.shape[0]
    w, dw, a = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3))
    wp, dwp, ap = np.zeros(3), np.zeros(3), -gravity
    for i in range(n):
        ao = ap + _cross(dwp, chain.p[i]) + _cross(wp, _cross(wp, chain.p[i]))
        wi, dwi, ai = _mtv(Rj[i], wp), _mtv(Rj[i], dwp), _mtv(Rj[i], ao)
        rel = chain.axis[i] * dq[i]
        dwi = dwi + _cross(wi, rel) + chain.axis[i] * ddq[i]
        wi = wi + rel
        w[i], dw[i], a[i] = wi, dwi, ai
        wp, dwp, ap = wi, dwi, ai
    return w, dw, a


@njit(cache=True)
def _inertia_times(P: Array, v: Array) -> Array:
    """Rotational inertia of one link's ten parameters times a vector."""
    out = np.empty(3)
    out[0] = P[4] * v[0] + P[5] * v[1] + P[7] * v[2]
    out[1] = P[5] * v[0] + P[6] * v[1] + P[8] * v[2]
    out[2] = P[7] * v[0] + P[8] * v[1] + P[9] * v[2]
    return out


@njit(cache=True)
def _torque(chain: Chain, pi: Array, Rj: Array, dq: Array, ddq: Array, gravity: Array) -> Array:
    n = dq.shape[0]
    w, dw, a = _motion(chain, Rj, dq, ddq, gravity)
    tau = np.empty(n)
    F, N = np.zeros(3), np.zeros(3)
    for i in range(n - 1, -1, -1):
        P = pi[i]
        h = P[1:4]
        f = P[0] * a[i] + _cross(dw[i], h) + _cross(w[i], _cross(w[i], h))
        m = _inertia_times(P, dw[i]) + _cross(w[i], _inertia_times(P, w[i])) + _cross(h, a[i])
        F = F + f
        N = N + m
        tau[i] = chain.axis[i, 0] * N[0] + chain.axis[i, 1] * N[1] + chain.axis[i, 2] * N[2]
        F = _mv(Rj[i], F)
        N = _mv(Rj[i], N) + _cross(chain.p[i], F)
    return tau


@njit(cache=True)
def torque(chain: Chain, pi: Array, q: Array, dq: Array, ddq: Array) -> Array:
    """Inverse dynamics ``M(q) ddq + c(q, dq) + g(q)`` [N m], (n,), links only (no rotor inertia).

    ``pi``: (n, 10) standard parameters; ``q, dq, ddq``: (n,).  Source: Liu & Althoff (2018), eq. (3).
    """
    return _torque(chain, pi, _joint_rotations(chain, q), dq, ddq, chain.gravity)


@njit(cache=True)
def gravity_torque(chain: Chain, pi: Array, q: Array) -> Array:
    """Gravity torque ``g(q)`` [N m], (n,)."""
    z = np.zeros(q.shape[0])
    return _torque(chain, pi, _joint_rotations(chain, q), z, z, chain.gravity)


@njit(cache=True)
def mass_matrix(chain: Chain, pi: Array, q: Array) -> Array:
    """Link-side mass matrix ``M(q)`` [kg m^2], (n, n), without rotor inertia: composite bodies, tip to base."""
    n = q.shape[0]
    Rj = _joint_rotations(chain, q)
    M = np.zeros((n, n))
    m = 0.0
    h = np.zeros(3)
    inertia = np.zeros((3, 3))
    F, N = np.empty(3), np.empty(3)
    for i in range(n - 1, -1, -1):
        P = pi[i]
        m += P[0]
        h = h + P[1:4]
        inertia[0, 0] += P[4]
        inertia[0, 1] += P[5]
        inertia[1, 0] += P[5]
        inertia[1, 1] += P[6]
        inertia[0, 2] += P[7]
        inertia[2, 0] += P[7]
        inertia[1, 2] += P[8]
        inertia[2, 1] += P[8]
        inertia[2, 2] += P[9]
        # a unit acceleration of joint i alone moves the composite body i
        F = _cross(chain.axis[i], h)
        N = _mv(inertia, chain.axis[i])
        f, t = F.copy(), N.copy()
        for j in range(i, -1, -1):
            M[i, j] = chain.axis[j, 0] * t[0] + chain.axis[j, 1] * t[1] + chain.axis[j, 2] * t[2]
            M[j, i] = M[i, j]
            f = _mv(Rj[j], f)
            t = _mv(Rj[j], t) + _cross(chain.p[j], f)
        # express the composite body in the parent's frame: I_o = R I R' + terms of the shift p (parallel axes, via h)
        hr = _mv(Rj[i], h)
        p = chain.p[i]
        Ir = Rj[i] @ inertia @ np.ascontiguousarray(Rj[i].T)
        hp = hr[0] * p[0] + hr[1] * p[1] + hr[2] * p[2]
        pp = p[0] * p[0] + p[1] * p[1] + p[2] * p[2]
        for r in range(3):
            for k in range(3):
                inertia[r, k] = Ir[r, k] - hr[r] * p[k] - p[r] * hr[k] - m * p[r] * p[k]
            inertia[r, r] += 2.0 * hp + m * pp
        h = hr + m * p
    return M


@njit(cache=True)
def regressor(chain: Chain, q: Array, dq: Array, ddq: Array) -> Array:
    """Joint-torque regressor, (n, 10 n): ``torque = regressor @ pi.ravel()``.

    Source: Atkeson, An & Hollerbach (1986); the same equations as `torque`, one standard parameter at a time.
    """
    n = q.shape[0]
    Rj = _joint_rotations(chain, q)
    w, dw, a = _motion(chain, Rj, dq, ddq, chain.gravity)
    Y = np.zeros((n, 10 * n))
    f, t = np.empty((10, 3)), np.empty((10, 3))
    e = np.zeros(3)
    P = np.zeros(10)
    zero = np.zeros(3)
    for i in range(n):
        f[0], t[0] = a[i], zero
        for k in range(3):
            e[:] = 0.0
            e[k] = 1.0
            f[1 + k] = _cross(dw[i], e) + _cross(w[i], _cross(w[i], e))
            t[1 + k] = _cross(e, a[i])
        for k in range(4, 10):
            P[:] = 0.0
            P[k] = 1.0
            f[k] = zero
            t[k] = _inertia_times(P, dw[i]) + _cross(w[i], _inertia_times(P, w[i]))
        for j in range(i, -1, -1):
            for k in range(10):
                Y[j, 10 * i + k] = chain.axis[j, 0] * t[k, 0] + chain.axis[j, 1] * t[k, 1] + chain.axis[j, 2] * t[k, 2]
            if j > 0:
                for k in range(10):
                    f[k] = _mv(Rj[j], f[k])
                    t[k] = _mv(Rj[j], t[k]) + _cross(chain.p[j], f[k])
    return Y


@njit(cache=True)
def link_frames(chain: Chain, q: Array) -> tuple[Array, Array]:
    """Rotation (n, 3, 3) and origin (n, 3) [m] of every link frame in the base frame."""
    n = q.shape[0]
    Rj = _joint_rotations(chain, q)
    R, o = np.empty((n, 3, 3)), np.empty((n, 3))
    Rp, op = np.eye(3), np.zeros(3)
    for i in range(n):
        op = op + _mv(Rp, chain.p[i])
        Rp = Rp @ Rj[i]
        R[i], o[i] = Rp, op
    return R, o


@njit(cache=True)
def torques(chain: Chain, pi: Array, q: Array, dq: Array, ddq: Array) -> Array:
    """`torque` of every row of ``q, dq, ddq`` (N, n) -> (N, n)."""
    out = np.empty_like(q)
    for k in range(q.shape[0]):
        out[k] = torque(chain, pi, q[k], dq[k], ddq[k])
    return out


@njit(cache=True, nogil=True)
def gravity_torques(chain: Chain, pi: Array, q: Array) -> Array:
    """`gravity_torque` of every row of ``q`` (N, n) -> (N, n), without allocations: a campaign has millions of rows."""
    N, n = q.shape
    out = np.empty_like(q)
    E, a = np.empty((n, 3, 3)), np.empty((n, 3))  # rotations, and gravity's reaction in each link's frame
    F, M, f = np.empty(3), np.empty(3), np.empty(3)
    for k in range(N):
        for i in range(n):
            turn(chain.R[i], chain.axis[i], q[k, i], E[i])
            for r in range(3):
                a[i, r] = 0.0
                for c in range(3):
                    a[i, r] += E[i, c, r] * (a[i - 1, c] if i > 0 else -chain.gravity[c])
        F[:], M[:] = 0.0, 0.0
        for i in range(n - 1, -1, -1):
            P, p = pi[i], chain.p[i]
            for r in range(3):
                s, t = (r + 1) % 3, (r + 2) % 3
                F[r] += P[0] * a[i, r]
                M[r] += P[1 + s] * a[i, t] - P[1 + t] * a[i, s]
            out[k, i] = chain.axis[i, 0] * M[0] + chain.axis[i, 1] * M[1] + chain.axis[i, 2] * M[2]
            for r in range(3):
                f[r] = E[i, r, 0] * M[0] + E[i, r, 1] * M[1] + E[i, r, 2] * M[2]
            M[:] = f
            for r in range(3):
                f[r] = E[i, r, 0] * F[0] + E[i, r, 1] * F[1] + E[i, r, 2] * F[2]
            F[:] = f
            for r in range(3):
                s, t = (r + 1) % 3, (r + 2) % 3
                M[r] += p[s] * F[t] - p[t] * F[s]
    return out


@njit(cache=True)
def regressors(chain: Chain, q: Array, dq: Array, ddq: Array) -> Array:
    """`regressor` of every row of ``q, dq, ddq`` (N, n) -> (N, n, 10 n)."""
    N, n = q.shape
    out = np.empty((N, n, 10 * n))
    for k in range(N):
        out[k] = regressor(chain, q[k], dq[k], ddq[k])
    return out
