"""Stops of the simulated arm, the truth that bounds are tested on: power off, brakes close, joints slide, then stick.

    M(q) dv/dt + c(q, v) + g(q) + D v + f = u(t),   f_i in (F_i + B_i(t)) Sgn(v_i),   M with rotor inertia,

``B_i(t)`` zero until the brake's delay is over, then a ramp to its torque.  Time stepping after Moreau, of second order
in smooth phases (midpoint for the rigid body, trapezoid for viscous friction, exact impulse of the brake's ramp); a
step in which a joint comes to rest or turns round is split at that moment, so that events do not cost the order.

Source: Moreau (1988); Acary & Brogliato (2008), Numerical Methods for Nonsmooth Dynamical Systems, ch. 10.
"""

from __future__ import annotations

import numpy as np

from stopset.core.library import check, ffi, given, lib, view
from stopset.robot.rigid import Chain, arm_struct
from stopset.types import Array


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
    n = len(pi)
    rows = [given(x) for x in (rotor, fc, fv, brake_torque, brake_delay, brake_rise, q0, v0)]
    if any(x.shape != (n,) for x in rows) or disturbance.ndim != 2 or disturbance.shape[1] != n:
        raise ValueError(f"a stop of {[x.shape for x in rows]} with disturbance {disturbance.shape} for {n} joints")
    arm = arm_struct(chain, pi)
    plant = ffi.new("StopsetSimStop *", (arm[0], *(view(x) for x in rows[:6])))
    q, v, u = np.empty((steps + 1, n)), np.empty((steps + 1, n)), given(disturbance)
    check(lib.stopset_sim_stop(plant, view(rows[6]), view(rows[7]), dt, steps, len(u), view(u), view(q), view(v)))
    return q, v
