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
    """An arm whose power is cut; all joint arrays are (n,)."""

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
    n = len(arm.pi)
    rows = [given(x) for x in (*arm[2:], q0, v0)]
    if any(x.shape != (n,) for x in rows) or disturbance.ndim != 2 or disturbance.shape[1] != n:
        raise ValueError(f"a stop of {[x.shape for x in rows]} with disturbance {disturbance.shape} for {n} joints")
    body = arm_struct(arm.chain, arm.pi)
    plant = ffi.new("StopsetSimStop *", (body[0], *(view(x) for x in rows[:6])))
    q, v, u = np.empty((steps + 1, n)), np.empty((steps + 1, n)), given(disturbance)
    time = ffi.new("StopsetSimTime *", (dt, steps, len(u), view(u)))
    check(lib.stopset_sim_stop(plant, view(rows[6]), view(rows[7]), time, view(q), view(v)))
    return q, v
