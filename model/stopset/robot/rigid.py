"""Rigid-body dynamics of a serial arm of revolute joints, by the compiled core.

Newton and Euler's equations about each link frame's origin are linear in the ten *standard parameters* of a link
``[m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz]`` (inertia about the link frame's origin; pinocchio's order), so one
pass serves torque, mass matrix and regressor alike.  The tests hold every function here to pinocchio.

Frames: link frame ``i`` moves with joint ``i``; ``chain.R[i], chain.p[i]`` place it in link ``i-1`` at ``q_i = 0``;
``chain.axis[i]`` is the joint axis in link frame ``i``.  SI units throughout.

Source: Featherstone, Rigid Body Dynamics Algorithms (2008), ch. 5 and 6; Liu & Althoff (2018), eq. (3).
"""

from __future__ import annotations

from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from stopset.core.library import check, ffi, given, lib, view
from stopset.types import Array

_ARM = ffi.typeof("StopsetArm *")
_recent: list[tuple[tuple[Any, ...], ...]] = [()]  # the last four in one tuple: threads ask while others add
_copied: WeakKeyDictionary[Any, Any] = WeakKeyDictionary()


class Chain(NamedTuple):
    """Geometry of a serial arm with ``n`` revolute joints."""

    R: Array  # (n, 3, 3) link frame i in link frame i-1 at q = 0
    p: Array  # (n, 3) [m]
    axis: Array  # (n, 3) unit vectors
    gravity: Array  # (3,) [m/s^2] in the base frame, e.g. (0, 0, -9.81)


def arm_struct(chain: Chain, pi: Array | None) -> Any:
    """The C struct of an arm; what it points at lives as long as it does."""
    for its_chain, its_pi, struct, _ in _recent[0]:  # most calls are about the arm of the call before
        if its_chain is chain and its_pi is pi:
            return struct
    n = len(chain.p)
    if chain.R.shape != (n, 3, 3) or chain.axis.shape != (n, 3) or chain.gravity.shape != (3,):
        raise ValueError(f"chain of {n} joints with R {chain.R.shape}, axis {chain.axis.shape}, gravity {chain.gravity.shape}")
    if pi is not None and pi.shape != (n, 10):
        raise ValueError(f"standard parameters {pi.shape} for {n} joints; expected ({n}, 10)")
    parts = [*chain] if pi is None else [*chain, pi]
    held = [given(x) for x in parts]
    views = [view(x) for x in held]
    arm = ffi.new(_ARM, (n, *views))
    if all(x is y for x, y in zip(parts, held, strict=True)):  # a copy would not see what is written into the original
        _recent[0] = ((chain, pi, arm, views), *_recent[0][:3])
    else:
        _copied[arm] = views
    return arm


def _rows(chain: Chain, *arrays: Array) -> tuple[list[Array], int]:
    """The arrays as the core reads them, and how many rows they have."""
    n, shape = len(chain.p), arrays[0].shape
    if shape[-1] != n or any(x.shape != shape for x in arrays):
        raise ValueError(f"rows of shapes {[x.shape for x in arrays]} for {n} joints; expected one shape, {n} columns")
    return [given(x) for x in arrays], arrays[0].size // n


def torques(chain: Chain, pi: Array, q: Array, dq: Array, ddq: Array) -> Array:
    """Inverse dynamics ``M(q) ddq + c(q, dq) + g(q)`` [N m] of every row of ``q, dq, ddq`` (N, n), links only (no rotor inertia).

    ``pi``: (n, 10) standard parameters.  Source: Liu & Althoff (2018), eq. (3).
    """
    (q, dq, ddq), N = _rows(chain, q, dq, ddq)
    arm = arm_struct(chain, pi)
    out = np.empty(q.shape)
    check(lib.stopset_torques(arm, N, view(q), view(dq), view(ddq), view(out)))
    return out


def torque(chain: Chain, pi: Array, q: Array, dq: Array, ddq: Array) -> Array:
    """`torques` of one state, (n,) each."""
    return torques(chain, pi, q, dq, ddq)


class Bend(NamedTuple):
    """A joint whose link is off its encoder by ``x, dx, ddx`` (N,) [rad, rad/s, rad/s^2]."""

    joint: int
    x: Array
    dx: Array
    ddx: Array


def bent_torques(chain: Chain, pi: Array, states: tuple[Array, Array, Array], bend: Bend, lowest: int, out: Array) -> None:
    """`torques` (N, n) of ``q, dq, ddq`` with a joint bent, into ``out``: only those of the joints from ``lowest`` on."""
    (q, dq, ddq), N = _rows(chain, *states)
    joint, *by = bend
    if out.shape != q.shape or any(v.shape != (N,) for v in by) or not 0 <= lowest < q.shape[1]:
        raise ValueError(f"bend {[v.shape for v in by]} of joints from {lowest} for rows {q.shape}, into {out.shape}")
    arm = arm_struct(chain, pi)
    held = [given(v) for v in by]
    bent = ffi.new("StopsetBend *", (joint, lowest, *map(view, held)))
    check(lib.stopset_bent_torques(arm, N, view(q), view(dq), view(ddq), bent, view(out)))


def gravity_torques(chain: Chain, pi: Array, q: Array) -> Array:
    """Gravity torque ``g(q)`` [N m] of every row of ``q`` (N, n)."""
    (q,), N = _rows(chain, q)
    arm = arm_struct(chain, pi)
    out = np.empty(q.shape)
    check(lib.stopset_gravity_torques(arm, N, view(q), view(out)))
    return out


def gravity_torque(chain: Chain, pi: Array, q: Array) -> Array:
    """`gravity_torques` of one pose, (n,)."""
    return gravity_torques(chain, pi, q)


def mass_matrices(chain: Chain, pi: Array, q: Array) -> Array:
    """Link-side mass matrix ``M(q)`` [kg m^2], (N, n, n), without rotor inertia, of every row of ``q`` (N, n)."""
    (q,), N = _rows(chain, q)
    arm = arm_struct(chain, pi)
    out = np.empty((*q.shape, q.shape[-1]))
    check(lib.stopset_mass_matrices(arm, N, view(q), view(out)))
    return out


def mass_matrix(chain: Chain, pi: Array, q: Array) -> Array:
    """`mass_matrices` of one pose, (n, n)."""
    return mass_matrices(chain, pi, q)


def regressors(chain: Chain, q: Array, dq: Array, ddq: Array) -> Array:
    """Joint-torque regressor of every row, (N, n, 10 n): ``torques = regressors @ pi.ravel()``.

    Source: Atkeson, An & Hollerbach (1986); the same equations as `torques`, one standard parameter at a time.
    """
    (q, dq, ddq), N = _rows(chain, q, dq, ddq)
    arm = arm_struct(chain, None)
    out = np.empty((*q.shape, 10 * q.shape[-1]))
    check(lib.stopset_regressors(arm, N, view(q), view(dq), view(ddq), view(out)))
    return out


def link_frames(chain: Chain, q: Array) -> tuple[Array, Array]:
    """Rotation (..., n, 3, 3) and origin (..., n, 3) [m] of every link frame in the base frame, for poses ``q`` (..., n)."""
    (q,), N = _rows(chain, q)
    arm = arm_struct(chain, None)
    R, o = np.empty((*q.shape, 3, 3)), np.empty((*q.shape, 3))
    check(lib.stopset_link_frames(arm, N, view(q), view(R), view(o)))
    return R, o


def moment_arms(chain: Chain, pi: Array, q: Array) -> tuple[Array, Array]:
    """Joint axes, and axis x first moment of all beyond [kg m], (N, n, 3) each, in the base frame, of poses ``q`` (N, n)."""
    (q,), N = _rows(chain, q)
    arm = arm_struct(chain, pi)
    axis, moment_arm = np.empty((*q.shape, 3)), np.empty((*q.shape, 3))
    check(lib.stopset_moment_arms(arm, N, view(q), view(axis), view(moment_arm)))
    return axis, moment_arm
