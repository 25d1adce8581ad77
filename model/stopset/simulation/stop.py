"""Stops of the simulated arm, the truth that bounds are tested on: power off, brakes close, joints slide, then stick.

    M(q) dv/dt + c(q, v) + g(q) + D v + f = u(t),   f_i in (F_i + B_i(t)) Sgn(v_i),   M with rotor inertia,

``B_i(t)`` zero until the brake's delay is over, then a ramp to its torque.  Time stepping after Moreau, of second order
in smooth phases (midpoint for the rigid body, trapezoid for viscous friction, exact impulse of the brake's ramp); a
step in which a joint comes to rest or turns round is split at that moment, so that events do not cost the order.

Source: Moreau (1988); Acary & Brogliato (2008), Numerical Methods for Nonsmooth Dynamical Systems, ch. 10.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from stopset.core.library import check, ffi, given, lib, view
from stopset.robot.rigid import Chain, arm_struct
from stopset.types import Array


class StoppingArm(NamedTuple):
    """An arm whose power is cut, all joint arrays (n,); or several of one chain for `simulate_stops`, all arrays but the chain with
    one more axis in front."""

    chain: Chain  # rigid body of `stopset.robot`
    pi: Array  # (n, 10), with the payload
    rotor: Array  # [kg m^2] reflected rotor inertia
    fc: Array  # [N m] Coulomb friction
    fv: Array  # [N m s/rad] viscous friction
    brake_torque: Array  # [N m]
    brake_delay: Array  # [s] after the cut
    brake_rise: Array  # [s]


def simulate_stop(arm: StoppingArm, q0: Array, v0: Array, dt: float, steps: int, disturbance: Array) -> tuple[Array, Array]:
    """Positions [rad] and velocities [rad/s] of a power-off stop every ``dt`` seconds, (steps + 1, n) each.

    The cut is at t = 0; ``disturbance``: (pieces, n) torque u [N m] on the joints, constant over equal pieces of the horizon
    (one zero row for none).
    """
    one = StoppingArm(arm.chain, *(x[None] for x in arm[1:]))
    q, v = simulate_stops(one, q0[None], v0[None], dt, steps, disturbance[None])
    return q[0], v[0]


def simulate_stops(arms: StoppingArm, q0: Array, v0: Array, dt: float, steps: int, disturbance: Array) -> tuple[Array, Array]:
    """`simulate_stop` of several stops, four of which cost little more than one: (count, steps + 1, n) each, from ``q0, v0``
    (count, n) under ``disturbance`` (count, pieces, n). The same bits as one by one."""
    count, n = len(q0), len(arms.chain.p)
    pi, rows = given(arms.pi), [given(x) for x in (*arms[2:], q0, v0)]
    shapes = [x.shape for x in (*rows, disturbance, pi)]
    if any(x != (count, n) for x in shapes[:-2]) or disturbance.shape[::2] != (count, n) or pi.shape != (count, n, 10):
        raise ValueError(f"stops of {shapes} for {n} joints")
    q, v, u = np.empty((count, steps + 1, n)), np.empty((count, steps + 1, n)), given(disturbance)
    if count:
        body = arm_struct(arms.chain, pi[0])[0]  # the parameters of all stand behind the first
        plants = ffi.new("StopsetSimStops *", (count, body, *(view(x) for x in rows[:6])))
        time = ffi.new("StopsetSimTime *", (dt, steps, u.shape[1], view(u)))
        check(lib.stopset_sim_stops(plants, view(rows[6]), view(rows[7]), time, view(q), view(v)))
    return q, v
