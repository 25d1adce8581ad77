"""Stops of the simulated arm, the truth that bounds are tested on: power off, brakes close, joints slide, then stick.

    M(q) dv/dt + c(q, v) + g(q) + D v + f = u(t),   f_i in (F_i + B_i(t)) Sgn(v_i),   M with rotor inertia,

``B_i(t)`` zero until the brake's delay is over, then a ramp to its torque.  Time stepping after Moreau, of second order
in smooth phases (midpoint for the rigid body, trapezoid for viscous friction, exact impulse of the brake's ramp); a
step in which a joint comes to rest or turns round is split at that moment, so that events do not cost the order.

Source: Moreau (1988); Acary & Brogliato (2008), Numerical Methods for Nonsmooth Dynamical Systems, ch. 10.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from stopset.robot.rigid import Array, Chain
from stopset.simulation.dynamics import WORK, mass_and_bias
from stopset.simulation.inclusion import first_crossing, solve_inclusion

SPLITS_PER_JOINT = 4  # events in one step before the rest of it is taken unsplit: Moreau's step handles any chatter
SMALLEST_PIECE = 1e-6  # of a step: what is closer than this happens now


@njit(cache=True)
def brake_impulse(t: float, h: float, delay: float, rise: float, level: float) -> float:
    """Impulse a brake can give from ``t`` to ``t + h`` [N m s]: the exact integral of its torque ramp."""
    s, e = t - delay, t + h - delay
    total = 0.0
    if e > 0.0:
        total = e - 0.5 * rise if e >= rise else 0.5 * e * e / rise
    if s > 0.0:
        total -= s - 0.5 * rise if s >= rise else 0.5 * s * s / rise
    return level * total


@njit(cache=True)
def simulate_stop(
    chain: Chain, pi: Array, rotor: Array, fc: Array, fv: Array,
    brake_torque: Array, brake_delay: Array, brake_rise: Array,
    q0: Array, v0: Array, dt: float, steps: int, disturbance: Array,
) -> tuple[Array, Array]:  # fmt: skip
    """Positions [rad] and velocities [rad/s] of a power-off stop every ``dt`` seconds, (steps + 1, n) each.

    ``chain, pi``: rigid body of `stopset.robot` (payload inside ``pi``); ``rotor``: reflected rotor inertia [kg m^2];
    ``fc, fv``: Coulomb [N m] and viscous [N m s/rad] friction; ``brake_torque`` [N m], ``brake_delay``, ``brake_rise``
    [s] after the cut at t = 0; ``disturbance``: (pieces, n) torque u [N m] on the joints, constant over equal pieces of
    the horizon (one zero row for none).  All joint arrays are (n,).
    """
    n = q0.shape[0]
    qs, vs = np.empty((steps + 1, n)), np.empty((steps + 1, n))
    q, v, w, rate = q0.copy(), v0.copy(), np.zeros(n), np.zeros(n)
    qs[0], vs[0] = q, v
    A, L, b, bias = np.empty((n, n)), np.zeros((n, n)), np.empty(n), np.empty(n)
    plus, minus, mode = np.empty(n), np.empty(n), np.zeros(n, np.int64)
    middle, speed, work = np.empty(n), np.empty(n), np.empty((n, WORK))
    for k in range(steps):
        u = disturbance[k * disturbance.shape[0] // steps]
        t, left, splits = k * dt, dt, 0
        while left > 0.0:
            h, event = left, -1
            while True:
                for i in range(n):
                    middle[i] = q[i] + 0.5 * h * v[i]
                    speed[i] = v[i] + 0.5 * h * rate[i]
                mass_and_bias(chain, pi, middle, speed, work, A, bias)
                for i in range(n):
                    A[i, i] += rotor[i]
                    b[i] = h * (u[i] - bias[i] - 0.5 * fv[i] * v[i])
                    for j in range(n):
                        b[i] += A[i, j] * v[j]
                    plus[i] = h * fc[i] + brake_impulse(t, h, brake_delay[i], brake_rise[i], brake_torque[i])
                    minus[i] = plus[i]
                    mode[i] = 1 if v[i] > 0.0 else (-1 if v[i] < 0.0 else mode[i])
                for i in range(n):
                    A[i, i] += 0.5 * h * fv[i]
                solve_inclusion(A, b, plus, minus, mode, w, L)
                if event >= 0 or splits >= SPLITS_PER_JOINT * n or not crosses(v, w, plus, minus):
                    break
                share, event = first_crossing(A, b, plus, minus, v, w, L, mode)
                splits = splits + 1 if event >= 0 else SPLITS_PER_JOINT * n
                h = max(share, SMALLEST_PIECE) * left
            if event >= 0:  # this joint is at rest at the end of the piece, exactly
                w[event], mode[event] = 0.0, 0
            for i in range(n):
                q[i] += 0.5 * h * (v[i] + w[i])
                rate[i] = (w[i] - v[i]) / h
                v[i] = w[i]
            t += h
            left = 0.0 if left - h < SMALLEST_PIECE * dt else left - h
        qs[k + 1], vs[k + 1] = q, v
    return qs, vs


@njit(cache=True)
def crosses(v: Array, w: Array, plus: Array, minus: Array) -> bool:
    """Does a coordinate with dry friction that moves at ``v`` end the step at rest or the other way round?"""
    found = False
    for i in range(v.shape[0]):
        found = found or (v[i] != 0.0 and w[i] * v[i] <= 0.0 and plus[i] + minus[i] > 0.0)
    return found
