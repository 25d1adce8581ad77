"""Mass matrix and bias torque of an arm in one pass, for loops that need both ten thousand times a second.

Everything is written about the base's origin in base coordinates: there the momenta of links add up without being
shifted or turned from frame to frame, so one outward and one inward pass of a few hundred products per link give
``M(q)`` and ``c(q, dq) + g(q)`` in a tenth of the time of the two general functions of `stopset.robot.rigid`, to which
the tests hold this one.

Source: Featherstone, Rigid Body Dynamics Algorithms (2008), ch. 2.10 (acceleration), 5.3 and 6.2, in base coordinates.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from stopset.robot.rigid import Array, Chain

# columns of the scratch: joint screw (6); mass, first moment (3), inertia (6), force (3), moment (3), summed
WORK = 22


@njit(cache=True)
def mass_and_bias(chain: Chain, pi: Array, q: Array, dq: Array, work: Array, M: Array, bias: Array) -> None:
    """Fill ``M`` (n, n) [kg m^2] (links only, no rotor) and ``bias`` (n,) = c(q, dq) + g(q) [N m].

    ``pi`` (n, 10) standard parameters, ``q, dq`` (n,), ``work`` (n, WORK) scratch.
    """
    n = q.shape[0]
    R = np.eye(3)
    Q = np.empty((3, 3))
    E = np.empty((3, 3))
    ox = oy = oz = 0.0
    wx = wy = wz = 0.0  # angular velocity
    ux = uy = uz = 0.0  # velocity of the body's point at the base's origin
    ex = ey = ez = 0.0  # spatial acceleration, angular part
    ax, ay, az = -chain.gravity[0], -chain.gravity[1], -chain.gravity[2]
    for i in range(n):
        p = chain.p[i]
        ox += R[0, 0] * p[0] + R[0, 1] * p[1] + R[0, 2] * p[2]
        oy += R[1, 0] * p[0] + R[1, 1] * p[1] + R[1, 2] * p[2]
        oz += R[2, 0] * p[0] + R[2, 1] * p[1] + R[2, 2] * p[2]
        for r in range(3):
            for k in range(3):
                Q[r, k] = R[r, 0] * chain.R[i, 0, k] + R[r, 1] * chain.R[i, 1, k] + R[r, 2] * chain.R[i, 2, k]
        s, c = np.sin(q[i]), np.cos(q[i])
        d = 1.0 - c
        x, y, z = chain.axis[i, 0], chain.axis[i, 1], chain.axis[i, 2]
        E[0, 0], E[0, 1], E[0, 2] = c + x * x * d, x * y * d - z * s, x * z * d + y * s
        E[1, 0], E[1, 1], E[1, 2] = y * x * d + z * s, c + y * y * d, y * z * d - x * s
        E[2, 0], E[2, 1], E[2, 2] = z * x * d - y * s, z * y * d + x * s, c + z * z * d
        for r in range(3):
            for k in range(3):
                R[r, k] = Q[r, 0] * E[0, k] + Q[r, 1] * E[1, k] + Q[r, 2] * E[2, k]
        # joint screw: axis and velocity of the point at the base's origin
        zx = R[0, 0] * x + R[0, 1] * y + R[0, 2] * z
        zy = R[1, 0] * x + R[1, 1] * y + R[1, 2] * z
        zz = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z
        sx, sy, sz = oy * zz - oz * zy, oz * zx - ox * zz, ox * zy - oy * zx
        # the screw turns with the links before it
        v = dq[i]
        cx, cy, cz = wy * zz - wz * zy, wz * zx - wx * zz, wx * zy - wy * zx
        ax += v * ((wy * sz - wz * sy) + (uy * zz - uz * zy))
        ay += v * ((wz * sx - wx * sz) + (uz * zx - ux * zz))
        az += v * ((wx * sy - wy * sx) + (ux * zy - uy * zx))
        ex, ey, ez = ex + v * cx, ey + v * cy, ez + v * cz
        wx, wy, wz = wx + v * zx, wy + v * zy, wz + v * zz
        ux, uy, uz = ux + v * sx, uy + v * sy, uz + v * sz
        # the link's mass, first moment and inertia about the base's origin
        P = pi[i]
        m = P[0]
        gx = R[0, 0] * P[1] + R[0, 1] * P[2] + R[0, 2] * P[3]
        gy = R[1, 0] * P[1] + R[1, 1] * P[2] + R[1, 2] * P[3]
        gz = R[2, 0] * P[1] + R[2, 1] * P[2] + R[2, 2] * P[3]
        for r in range(3):
            Q[r, 0] = R[r, 0] * P[4] + R[r, 1] * P[5] + R[r, 2] * P[7]
            Q[r, 1] = R[r, 0] * P[5] + R[r, 1] * P[6] + R[r, 2] * P[8]
            Q[r, 2] = R[r, 0] * P[7] + R[r, 1] * P[8] + R[r, 2] * P[9]
        t = 2.0 * (gx * ox + gy * oy + gz * oz) + m * (ox * ox + oy * oy + oz * oz)
        jxx = Q[0, 0] * R[0, 0] + Q[0, 1] * R[0, 1] + Q[0, 2] * R[0, 2] - 2.0 * gx * ox - m * ox * ox + t
        jyy = Q[1, 0] * R[1, 0] + Q[1, 1] * R[1, 1] + Q[1, 2] * R[1, 2] - 2.0 * gy * oy - m * oy * oy + t
        jzz = Q[2, 0] * R[2, 0] + Q[2, 1] * R[2, 1] + Q[2, 2] * R[2, 2] - 2.0 * gz * oz - m * oz * oz + t
        jxy = Q[0, 0] * R[1, 0] + Q[0, 1] * R[1, 1] + Q[0, 2] * R[1, 2] - gx * oy - gy * ox - m * ox * oy
        jxz = Q[0, 0] * R[2, 0] + Q[0, 1] * R[2, 1] + Q[0, 2] * R[2, 2] - gx * oz - gz * ox - m * ox * oz
        jyz = Q[1, 0] * R[2, 0] + Q[1, 1] * R[2, 1] + Q[1, 2] * R[2, 2] - gy * oz - gz * oy - m * oy * oz
        hx, hy, hz = gx + m * ox, gy + m * oy, gz + m * oz
        # momentum (linear, about the origin), then force = I a + v x* (I v)
        px, py, pz = m * ux + wy * hz - wz * hy, m * uy + wz * hx - wx * hz, m * uz + wx * hy - wy * hx
        lx = jxx * wx + jxy * wy + jxz * wz + hy * uz - hz * uy
        ly = jxy * wx + jyy * wy + jyz * wz + hz * ux - hx * uz
        lz = jxz * wx + jyz * wy + jzz * wz + hx * uy - hy * ux
        W = work[i]
        W[0], W[1], W[2], W[3], W[4], W[5] = zx, zy, zz, sx, sy, sz
        W[6], W[7], W[8], W[9] = m, hx, hy, hz
        W[10], W[11], W[12], W[13], W[14], W[15] = jxx, jyy, jzz, jxy, jxz, jyz
        W[16] = m * ax + ey * hz - ez * hy + wy * pz - wz * py
        W[17] = m * ay + ez * hx - ex * hz + wz * px - wx * pz
        W[18] = m * az + ex * hy - ey * hx + wx * py - wy * px
        W[19] = jxx * ex + jxy * ey + jxz * ez + hy * az - hz * ay + wy * lz - wz * ly + uy * pz - uz * py
        W[20] = jxy * ex + jyy * ey + jyz * ez + hz * ax - hx * az + wz * lx - wx * lz + uz * px - ux * pz
        W[21] = jxz * ex + jyz * ey + jzz * ez + hx * ay - hy * ax + wx * ly - wy * lx + ux * py - uy * px
    for i in range(n - 1, -1, -1):
        W = work[i]
        if i < n - 1:
            for k in range(6, WORK):
                W[k] += work[i + 1, k]
        zx, zy, zz, sx, sy, sz = W[0], W[1], W[2], W[3], W[4], W[5]
        bias[i] = zx * W[19] + zy * W[20] + zz * W[21] + sx * W[16] + sy * W[17] + sz * W[18]
        m, hx, hy, hz = W[6], W[7], W[8], W[9]
        px, py, pz = m * sx + zy * hz - zz * hy, m * sy + zz * hx - zx * hz, m * sz + zx * hy - zy * hx
        lx = W[10] * zx + W[13] * zy + W[14] * zz + hy * sz - hz * sy
        ly = W[13] * zx + W[11] * zy + W[15] * zz + hz * sx - hx * sz
        lz = W[14] * zx + W[15] * zy + W[12] * zz + hx * sy - hy * sx
        for j in range(i, -1, -1):
            V = work[j]
            M[i, j] = V[0] * lx + V[1] * ly + V[2] * lz + V[3] * px + V[4] * py + V[5] * pz
            M[j, i] = M[i, j]


@njit(cache=True)
def motor_torques(chain: Chain, pi: Array, rotor: Array, q: Array, dq: Array, ddq: Array) -> Array:
    """(K, n) torque [N m] of rigid body and rotors for every row of ``q, dq, ddq`` (K, n)."""
    K, n = q.shape
    out, M, bias, work = np.empty((K, n)), np.empty((n, n)), np.empty(n), np.empty((n, WORK))
    for k in range(K):
        mass_and_bias(chain, pi, q[k], dq[k], work, M, bias)
        for i in range(n):
            out[k, i] = bias[i] + rotor[i] * ddq[k, i]
            for j in range(n):
                out[k, i] += M[i, j] * ddq[k, j]
    return out
