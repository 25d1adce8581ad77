"""Inner functions of the compiled core, called one by one: what tests hold against independent ones, and nothing else calls alone."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stopset.core.library import check, ffi, given, integers, lib, view
from stopset.reach.stops.tube import Parts, Plant, plant_struct
from stopset.robot.rigid import Chain, arm_struct
from stopset.types import Array


def maths(name: str, x: Array) -> Array:
    """``sin``, ``cos``, ``exp``, ``expm1``, ``tanh`` or ``log`` of ``x``, with the core's bits."""
    x = given(x)
    out = np.empty_like(x)
    which = ("sin", "cos", "exp", "expm1", "tanh", "log").index(name)
    check(lib.stopset_maths(which, x.size, view(x), view(out)))
    return out


def point_jacobian(chain: Chain, q: Array, link: int, point: Array) -> tuple[Array, Array]:
    """Position (3,) [m] and Jacobian (3, n) [m/rad] of a ``point`` (3,) of ``link`` at ``q`` (n,); zero for joints beyond it."""
    if q.ndim != 1 or point.shape != (3,) or not 0 <= link < len(q):
        raise ValueError(f"point {point.shape} of link {link} at poses {q.shape}; expected three numbers, a link, one pose")
    arm = arm_struct(chain, None)
    p, J = np.empty(3), np.empty((3, len(q)))
    check(lib.stopset_point(arm, view(given(q)), link, view(given(point)), view(p), view(J)))
    return p, J


def mass_and_bias(chain: Chain, pi: Array, q: Array, dq: Array) -> tuple[Array, Array]:
    """``M`` (n, n) [kg m^2] (links only, no rotor) and ``bias`` (n,) = c(q, dq) + g(q) [N m] at ``q, dq`` (n,).

    ``pi`` (n, 10) standard parameters.
    """
    n = len(pi)
    M, bias = np.empty((n, n)), np.empty(n)
    if q.shape != (n,) or dq.shape != (n,):
        raise ValueError(f"a state of {q.shape} and {dq.shape} for {n} joints")
    check(lib.stopset_sim_mass_and_bias(arm_struct(chain, pi), view(given(q)), view(given(dq)), view(M), view(bias)))
    return M, bias


def solve_inclusion(A: Array, b: Array, plus: Array, minus: Array, mode: NDArray[np.int64], w: Array) -> bool:
    """One step with dry friction as a set: ``A w + p = b``, friction impulses ``p`` full against what slides; True when solved.

    It is the optimality condition of a strictly convex problem, so it has exactly one solution, and sticking joints get
    ``w_i = 0`` to the bit.

    ``A`` (n, n), ``b, plus, minus`` (n,) impulses [N m s], ``plus, minus`` >= 0.  ``mode`` (n,) holds the guess who
    moves which way (-1, 0, 1) and afterwards the answer; ``w`` (n,) [rad/s] gets the velocity.
    """
    n = len(b)
    if A.shape != (n, n) or not plus.shape == minus.shape == mode.shape == w.shape == (n,):
        raise ValueError(f"an inclusion of {A.shape}, {b.shape}, {plus.shape}, {minus.shape}, {mode.shape}, {w.shape}")
    solved = lib.stopset_sim_inclusion(n, *(view(given(x)) for x in (A, b, plus, minus)), integers(mode), view(w))
    check(-min(solved, 0))
    return bool(solved)


def inertia_box(plant: Plant, q: Array, x_lo: Array, x_hi: Array, parts: Parts) -> tuple[Array, Array, Array]:
    """For angles in ``q + [x_lo, x_hi]`` (n,) the inertia is within the first (n, n) +- the second, rotor_half apart; its slopes
    (n, n, n) differ from those at ``q``, of the same payload, by no more than the third."""
    n = len(q)
    struct, _held = plant_struct(plant)
    out = [np.empty(shape) for shape in ((n, n), (n, n), (n, n, n))]
    box, _box = states_struct(q, (x_lo, x_hi))
    check(lib.stopset_inertia_box(struct, box, ffi.new("StopsetParts *", tuple(parts)), *(view(x) for x in out)))
    return out[0], out[1], out[2]


def states_struct(
    q: Array | None, x: tuple[Array, Array], v: tuple[Array, Array] | None = None
) -> tuple[Any, list[Array | None]]:
    """``StopsetBox`` of angles ``q + [x_lo, x_hi]``, speeds in ``v``, and what must live as long."""
    held = [None if a is None else given(a) for a in (q, *x, *(v or (None, None)))]
    return ffi.new("StopsetBox *", tuple(ffi.NULL if a is None else view(a) for a in held)), held


def range_struct(lo: Array, hi: Array) -> tuple[Any, list[Array]]:
    """``StopsetRange``, and what must live as long."""
    held = [given(lo), given(hi)]
    return ffi.new("StopsetRange *", tuple(view(a) for a in held)), held


def largest_energy(plant: Plant, q: Array, x_lo: Array, x_hi: Array, v_lo: Array, v_hi: Array) -> float:
    """Largest ``sqrt(v' M v)`` for speeds in a box and angles in ``q + [x_lo, x_hi]``: convex in v, so at a corner."""
    struct, _held = plant_struct(plant)
    box, _box = states_struct(q, (x_lo, x_hi), (v_lo, v_hi))
    return float(lib.stopset_largest_energy(struct, box))
