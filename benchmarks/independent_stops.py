"""Stops of the independent arm: set-valued friction and brakes, sharing no code with stopset.

    M(q) dv/dt + c + g + D v + f = u(t),   f_i in (F_i + B_i(t)) Sgn(v_i)

Moreau's time stepping with the rigid body of `independent_arm`: the speeds at a step's end minimise a strictly convex sum of a
quadratic form and absolute values, found joint by joint until nothing changes.  First order in time: 0.1 ms err by a few mrad/s.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from independent_arm import Arm, about_origin, frames, mass_matrix, newton_euler, read_arm
from numba import njit

import stopset.robot
from stopset.types import Array

DT = 1e-4  # [s]
SWEEPS = 400  # of the joints, at most
SHIPPED = Path(stopset.robot.__file__).with_name("arms") / "lwa4p"  # its description only


def shipped_arm(rotor: Array) -> Arm:
    """The arm in the box, with other rotors."""
    return replace(read_arm(SHIPPED), rotor=rotor)


def carrying(arm: Arm, mass: float, at: Array) -> Arm:
    """The arm with a point mass [kg] ``at`` (3,) [m] in its last link."""
    pi = arm.pi.copy()
    pi[-1] += about_origin(mass, at, np.zeros((3, 3)))
    return replace(arm, pi=pi)


@njit(cache=True)
def _given(t, h, delay, rise, level):  # type: ignore[no-untyped-def]
    """Impulse a brake can give from t to t + h."""
    total, pieces = 0.0, 4
    for k in range(pieces):
        x = (t + h * (k + 0.5) / pieces - delay) / rise
        total += level * min(max(x, 0.0), 1.0) * h / pieces
    return total


@njit(cache=True)
def _steps(R0, p, axis, pi, rotor, gravity, F, D, B, delay, rise, q0, v0, u, dt, steps):  # type: ignore[no-untyped-def]
    n = len(q0)
    qs, vs = np.empty((steps + 1, n)), np.empty((steps + 1, n))
    q, v, w, none = q0.copy(), v0.copy(), v0.copy(), np.zeros(n)
    R, W, X = np.empty_like(R0), np.empty((10 + 2 * n, 3)), np.empty((n, 10))
    M, bias, b, c = np.empty((n, n)), np.empty(n), np.empty(n), np.empty(n)
    qs[0], vs[0] = q, v
    for k in range(steps):
        now = u[k * len(u) // steps]
        frames(R0, axis, q + 0.5 * dt * v, R)
        mass_matrix(R, p, axis, pi, M, W, X)
        newton_euler(R, p, axis, pi, gravity, v, none, bias, W)
        for i in range(n):
            M[i, i] += rotor[i] + dt * D[i]
            c[i] = dt * F[i] + _given(k * dt, dt, delay[i], rise[i], B[i])
            b[i] = dt * (now[i] - bias[i] - D[i] * v[i])
            for j in range(n):
                b[i] += M[i, j] * v[j]
        for _ in range(SWEEPS):
            change = 0.0
            for i in range(n):
                r = b[i]
                for j in range(n):
                    if j != i:
                        r -= M[i, j] * w[j]
                new = (r - c[i]) / M[i, i] if r > c[i] else ((r + c[i]) / M[i, i] if r < -c[i] else 0.0)
                change = max(change, abs(new - w[i]))
                w[i] = new
            if change < 1e-12:
                break
        for i in range(n):
            q[i] += 0.5 * dt * (v[i] + w[i])
            v[i] = w[i]
        qs[k + 1], vs[k + 1] = q, v
    return qs, vs


def stopped(
    arm: Arm, F: Array, D: Array, B: Array, delay: Array, rise: Array, q: Array, dq: Array, lasts: float, u: Array | None = None,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Times (K,) [s], angles and speeds (K, n) after the power is off, ``lasts`` seconds long; ``u`` (pieces, n) [N m]."""
    steps = int(np.ceil(lasts / DT))
    push = np.zeros((1, arm.n)) if u is None else u
    qs, vs = _steps(
        arm.R0, arm.p, arm.axis, arm.pi, arm.rotor, arm.gravity, F, D, B, delay, rise, np.asarray(q, float), np.asarray(dq, float),
        push, DT, steps,
    )  # fmt: skip
    return np.arange(steps + 1) * DT, qs, vs


def rested(t: Array, v: Array, slow: float | Array = 0.0) -> Array:
    """(n,) [s]: when each joint has come to rest for good."""
    moving = np.abs(v) > slow
    last = np.where(moving.any(axis=0), len(t) - 1 - np.argmax(moving[::-1], axis=0), -1)
    return np.asarray(t[np.minimum(last + 1, len(t) - 1)])


def gravity_load(arm: Arm, q: Array) -> Array:
    """(n,) [N m] what a joint has to hold."""
    out, R, W = np.empty(arm.n), np.empty_like(arm.R0), np.empty((10 + 2 * arm.n, 3))
    frames(arm.R0, arm.axis, np.asarray(q, float), R)
    newton_euler(R, arm.p, arm.axis, arm.pi, arm.gravity, np.zeros(arm.n), np.zeros(arm.n), out, W)
    return out
