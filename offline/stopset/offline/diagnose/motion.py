"""Rigid-body torques of many rows at once: what `stopset.robot.rigid` gives row by row, without a single allocation.

A diagnosis asks for some millions of them, and numba compiles loops over numbers in a fraction of the time that small arrays
take.  The tests hold every function here to `stopset.robot.rigid`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from stopset.offline.diagnose.rows.prepare import Array
from stopset.robot.rigid import Chain, turn


@njit(cache=True, nogil=True)
def bent_torques(
    chain: Chain, pi: Array, q: Array, dq: Array, ddq: Array,
    joint: int, x: Array, dx: Array, ddx: Array, lowest: int, out: Array,
) -> None:  # fmt: skip
    """Link torques (N, n) [N m] of ``q, dq, ddq`` (N, n), with ``joint`` bent by ``x, dx, ddx`` (N,), into ``out``.

    Only those of the joints from ``lowest`` on; ``pi``: (n, 10) standard parameters of the links.
    """
    N, n = q.shape
    E, w, dw, a = np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3))
    speed, rate = np.empty(n), np.empty(n)
    f, m, v, F, M = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for k in range(N):
        for i in range(n):
            more = 1.0 if i == joint else 0.0
            turn(chain.R[i], chain.axis[i], q[k, i] + more * x[k], E[i])
            speed[i], rate[i] = dq[k, i] + more * dx[k], ddq[k, i] + more * ddx[k]
        _move(chain, E, speed, rate, w, dw, a)
        F[:] = 0.0
        M[:] = 0.0
        for i in range(n - 1, lowest - 1, -1):
            h = pi[i, 1:4]
            _cross(w[i], h, v)
            _cross(w[i], v, f)
            _cross(dw[i], h, v)
            for r in range(3):
                F[r] += f[r] + v[r] + pi[i, 0] * a[i, r]
            _turning(pi[i], w[i], v)
            _cross(w[i], v, m)
            _turning(pi[i], dw[i], v)
            _cross(h, a[i], f)
            for r in range(3):
                M[r] += m[r] + v[r] + f[r]
            out[k, i] = chain.axis[i, 0] * M[0] + chain.axis[i, 1] * M[1] + chain.axis[i, 2] * M[2]
            for r in range(3):
                f[r] = E[i, r, 0] * F[0] + E[i, r, 1] * F[1] + E[i, r, 2] * F[2]
                m[r] = E[i, r, 0] * M[0] + E[i, r, 1] * M[1] + E[i, r, 2] * M[2]
            _cross(chain.p[i], f, v)
            for r in range(3):
                F[r], M[r] = f[r], m[r] + v[r]


def link_torques(chain: Chain, pi: Array, q: Array, dq: Array, ddq: Array) -> Array:
    """(N, n) torque of the links [N m] for ``q, dq, ddq`` (N, n)."""
    out, none = np.empty_like(q), np.zeros(len(q))
    bent_torques(chain, pi, q, dq, ddq, -1, none, none, none, 0, out)
    return out


def mass_matrices(chain: Chain, pi: Array, q: Array) -> Array:
    """(N, n, n) mass matrix of the links [kg m^2]: column by column, the torque of a unit acceleration without gravity."""
    weightless, rest = chain._replace(gravity=np.zeros(3)), np.zeros_like(q)
    units = np.eye(q.shape[1])
    out: Array = np.stack([link_torques(weightless, pi, q, rest, rest + u) for u in units], axis=2)
    return out


@njit(cache=True, nogil=True)
def regressors(chain: Chain, q: Array, dq: Array, ddq: Array) -> Array:
    """(N, n, 10 n) joint-torque regressor: the link torque is ``regressors @ pi.ravel()``.

    Source: Atkeson, An & Hollerbach (1986).
    """
    N, n = q.shape
    Y = np.zeros((N, n, 10 * n))
    E, w, dw, a = np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3))
    # in link frame i: joint j's axis z, and u = z x (origin of i - origin of j): a wrench (f, m) at i gives joint j z.m + u.f
    z, u, s, v = np.empty((n, 3)), np.empty((n, 3)), np.empty(3), np.empty(3)
    for k in range(N):
        for i in range(n):
            turn(chain.R[i], chain.axis[i], q[k, i], E[i])
        _move(chain, E, dq[k], ddq[k], w, dw, a)
        for i in range(n):
            for j in range(i):
                _cross(z[j], chain.p[i], v)
                for r in range(3):
                    v[r] += u[j, r]
                for r in range(3):
                    u[j, r] = E[i, 0, r] * v[0] + E[i, 1, r] * v[1] + E[i, 2, r] * v[2]
                    s[r] = E[i, 0, r] * z[j, 0] + E[i, 1, r] * z[j, 1] + E[i, 2, r] * z[j, 2]
                for r in range(3):
                    z[j, r] = s[r]
            for r in range(3):
                z[i, r], u[i, r] = chain.axis[i, r], 0.0
            for j in range(i + 1):
                _link_row(z[j], u[j], w[i], dw[i], a[i], s, v, Y[k, j, 10 * i : 10 * i + 10])
    return Y


@njit(cache=True, nogil=True)
def _link_row(z: Array, u: Array, w: Array, dw: Array, a: Array, s: Array, v: Array, y: Array) -> None:
    """One link's ten columns ``y`` in one joint's row; ``z, u``: see `regressors`; ``s, v``: room for three numbers each."""
    y[0] = u[0] * a[0] + u[1] * a[1] + u[2] * a[2]
    uw = u[0] * w[0] + u[1] * w[1] + u[2] * w[2]
    ww = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    _cross(a, z, s)
    _cross(u, dw, v)
    for r in range(3):
        y[1 + r] = s[r] + v[r] + uw * w[r] - ww * u[r]
    _cross(z, w, s)
    y[4] = z[0] * dw[0] + s[0] * w[0]
    y[5] = z[0] * dw[1] + z[1] * dw[0] + s[0] * w[1] + s[1] * w[0]
    y[6] = z[1] * dw[1] + s[1] * w[1]
    y[7] = z[0] * dw[2] + z[2] * dw[0] + s[0] * w[2] + s[2] * w[0]
    y[8] = z[1] * dw[2] + z[2] * dw[1] + s[1] * w[2] + s[2] * w[1]
    y[9] = z[2] * dw[2] + s[2] * w[2]


@njit(cache=True, nogil=True)
def _move(chain: Chain, E: Array, speed: Array, rate: Array, w: Array, dw: Array, a: Array) -> None:
    """Angular velocity, angular acceleration and (gravity-free) acceleration of each link frame's origin, (n, 3) each."""
    wp, dwp, ap, ao, v = np.zeros(3), np.zeros(3), -chain.gravity, np.empty(3), np.empty(3)
    for i in range(len(speed)):
        _cross(wp, chain.p[i], v)
        _cross(wp, v, ao)
        _cross(dwp, chain.p[i], v)
        for r in range(3):
            ao[r] += ap[r] + v[r]
        for r in range(3):
            w[i, r] = E[i, 0, r] * wp[0] + E[i, 1, r] * wp[1] + E[i, 2, r] * wp[2]
            dw[i, r] = E[i, 0, r] * dwp[0] + E[i, 1, r] * dwp[1] + E[i, 2, r] * dwp[2]
            a[i, r] = E[i, 0, r] * ao[0] + E[i, 1, r] * ao[1] + E[i, 2, r] * ao[2]
        _cross(w[i], chain.axis[i], v)
        for r in range(3):
            dw[i, r] += v[r] * speed[i] + chain.axis[i, r] * rate[i]
            w[i, r] += chain.axis[i, r] * speed[i]
            wp[r], dwp[r], ap[r] = w[i, r], dw[i, r], a[i, r]


@njit(cache=True, nogil=True)
def _cross(a: Array, b: Array, out: Array) -> None:
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@njit(cache=True, nogil=True)
def _turning(P: Array, v: Array, out: Array) -> None:
    """Rotational inertia of a link's ten parameters times a vector."""
    out[0] = P[4] * v[0] + P[5] * v[1] + P[7] * v[2]
    out[1] = P[5] * v[0] + P[6] * v[1] + P[8] * v[2]
    out[2] = P[7] * v[0] + P[8] * v[1] + P[9] * v[2]
