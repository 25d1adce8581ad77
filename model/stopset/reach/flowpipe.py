"""The reachable set of the linear model as a box hull, and the deviation tube that measurements are held against.

Identification and monitor use these same arrays (trap P18).  Inputs may vary in time within ``U`` (trap P4), and signs
of the response decide which corner counts (trap P1)::

    sup x(t) = E1+ X0.hi + E1- X0.lo + (int K+) U.hi + (int K-) U.lo,    K(t) = e^{At} B,  E1 = e^{At}

Source: Liu & Althoff (2018), eq. (17)-(20), with the corrections named above.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from stopset.artifact import Abstraction, UncertaintySets
from stopset.core.library import check, ffi, given, lib, view
from stopset.errors import NotCovered
from stopset.sets import Box
from stopset.types import Array


def expm(X: Array) -> Array:
    """Matrix exponential: scaling by a power of two, Taylor to full precision, squaring (small matrices, norm decides)."""
    squarings = max(0, int(np.ceil(np.log2(max(float(np.abs(X).sum(axis=1).max()), 1e-300)))) + 2)
    Y = X / 2.0**squarings  # norm <= 1/4: the 20th term is below 1/4^20/20! < 1e-30
    term, out = np.eye(X.shape[0]), np.eye(X.shape[0])
    for k in range(1, 20):
        term = term @ Y / k
        out = out + term
    for _ in range(squarings):
        out = out @ out
    return out


def _linear(abstraction: Abstraction) -> tuple[Array, Array]:
    if not abstraction.linear:
        raise NotCovered(
            f"this is model {abstraction.kind} of order {abstraction.order}; the constant tube that is watched live and exported "
            "belongs to a linear model: identify with --model 1 --order 1"
        )
    return abstraction.A, abstraction.B


def discretise(abstraction: Abstraction, dt: float) -> tuple[Array, Array]:
    """``Ad`` (2n, 2n), ``Bd`` (2n, n): exact step of ``dt`` [s] with the input held (zero-order hold)."""
    A, _ = _linear(abstraction)
    n = abstraction.n
    Ad, Bd = np.empty((2 * n, 2 * n)), np.empty((2 * n, n))
    check(lib.stopset_discretise(n, view(given(A[n:, n:])), view(given(abstraction.Minv)), dt, view(Ad), view(Bd)))
    return Ad, Bd


@dataclass(frozen=True, slots=True)
class Responses:
    """Responses on the grid ``k dt``, k = 0..H: ``E1`` (H+1, r, 2n), ``plus`` and ``minus`` (H+1, r, m).

    Of all states (r = 2n, the first ``E1`` is the identity) or of combinations of them, to a torque at each joint (m = n) or
    along given directions.  ``plus`` is an upper bound of the integral of ``max(K, 0)``, ``minus`` a lower bound of that of
    ``min(K, 0)``; where K keeps its sign within a step (always, for a decoupled model) both are exact.
    """

    dt: float
    E1: Array
    plus: Array
    minus: Array

    def hull(self, X0_lo: Array, X0_hi: Array, U_lo: Array, U_hi: Array) -> tuple[Array, Array]:
        """Lower and upper bounds (H+1, r) of ``E1 X0 + convolution of K with U``."""
        ages, rows, states = self.E1.shape
        if X0_lo.shape != (states,) or X0_hi.shape != (states,) or not U_lo.shape == U_hi.shape == self.plus.shape[2:]:
            raise ValueError(f"sets of {X0_lo.size} states and {U_lo.size} torques; expected {states} and {self.plus.shape[2]}")
        lo, hi = np.empty((ages, rows)), np.empty((ages, rows))
        sets, _held = _sets(Box(X0_lo, X0_hi), Box(U_lo, U_hi), Box(X0_lo, X0_hi))
        struct, _arrays = self.struct()
        lib.stopset_hulls(struct, sets, view(lo), view(hi))
        return lo, hi

    def struct(self) -> tuple[Any, list[Array]]:
        """``StopsetResponses``, and what must live as long."""
        held = [given(x) for x in (self.E1, self.plus, self.minus)]
        return ffi.new("StopsetResponses *", (*self.E1.shape, self.plus.shape[2], *(view(x) for x in held))), held

    def tube(self, X0: Box, U: Box, V: Box) -> tuple[Array, Array]:
        """The same for readings, whose own noise ``V`` (2n,) comes on top."""
        lo, hi = self.hull(X0.lo, X0.hi, U.lo, U.hi)
        Lp, Ln = np.maximum(self.E1[0], 0.0), np.minimum(self.E1[0], 0.0)
        return lo + (Lp @ V.lo + Ln @ V.hi), hi + (Lp @ V.hi + Ln @ V.lo)


def responses(
    abstraction: Abstraction, dt: float, steps: int, torques: Array | None = None, rows: Array | None = None
) -> Responses:
    """`Responses` of a linear abstraction for ages ``0, dt, ..., steps dt``.

    ``torques``: (n, m) directions in the joints' torques that inputs act along, ``rows``: (r, 2n) combinations of states
    that are looked at; without them every joint and every state by itself.
    """
    A, _ = _linear(abstraction)
    n = abstraction.n
    signed = torques is None and rows is None and _signed(abstraction)
    looked, inputs = 2 * n if rows is None else len(rows), n if torques is None else torques.shape[1]
    held = [None if x is None else given(x) for x in (A[n:, n:], abstraction.Minv, torques, rows)]
    pointers = [ffi.NULL if x is None else view(x) for x in held]
    linear = ffi.new("StopsetLinear *", (n, looked, inputs, *pointers, int(signed)))
    step, work = np.empty(lib.stopset_step_room(linear)), np.empty(lib.stopset_response_room(linear))
    E1 = np.empty((steps + 1, looked, 2 * n))
    plus, minus = np.empty((steps + 1, looked, inputs)), np.empty((steps + 1, looked, inputs))
    out = Responses(dt, E1, plus, minus)
    struct, _held = out.struct()
    check(lib.stopset_responses(linear, dt, view(step), view(work), struct))
    return out


def _sets(X0: Box, U: Box, V: Box, *, position_only: bool = False) -> tuple[Any, list[Array]]:
    """``StopsetSets``, and what must live as long."""
    held = [given(x) for b in (X0, U, V) for x in (b.lo, b.hi)]
    return ffi.new("StopsetSets *", (*(view(x) for x in held), int(position_only))), held


def _signed(abstraction: Abstraction) -> bool:
    """A decoupled joint with non-negative damping has ``K >= 0`` throughout: ``(1 - e^{-at})/v`` and ``e^{-at}/J``."""
    return abstraction.decoupled and bool(np.all(abstraction.viscous[:, 0] >= 0) and np.all(np.diag(abstraction.Minv) > 0))


@dataclass(frozen=True, slots=True)
class DeviationTube:
    """What a measured state may differ from the nominal prediction at each age: ``lo``, ``hi`` (H+1, 2n) over (q, dq)."""

    ages: Array  # (H+1,) [s]
    lo: Array
    hi: Array


def deviation_tube(abstraction: Abstraction, sets: UncertaintySets, across: Array | None = None) -> DeviationTube:
    """Tube of measured deviations for all ages up to the sets' horizon: the start's and the reading's noise included.

    ``across``: (k, n) directions in the joints; the tube is then that of their positions and speeds (2k columns), else that
    of every joint.  Where the torque set is a zonotope the directions it was found in are held by the recordings, others
    are not.  For ``conform == 'position'`` the velocity columns are unbounded (infinite): nothing was promised about them.
    """
    steps = round(sets.horizon / sets.dt)
    rows = None if across is None else along_joints(across)
    torques, U = torque_set(sets)
    R = responses(abstraction, sets.dt, steps, torques, rows)
    lo, hi = np.empty(R.E1.shape[:2]), np.empty(R.E1.shape[:2])
    responded, _arrays = R.struct()
    struct, _held = _sets(sets.X0, U, sets.V, position_only=sets.conform == "position")
    look = ffi.NULL if rows is None else view(given(rows))
    lib.stopset_tubes(responded, look, struct, view(lo), view(hi))
    return DeviationTube(np.asarray(sets.dt * np.arange(steps + 1)), lo, hi)


def torque_set(sets: UncertaintySets) -> tuple[Array | None, Box]:
    """The torque set as a box along directions (n, m): the joints (None), or, of a zonotope, these for its centre, then its
    generators from -1 to 1."""
    if sets.zonotope is None:
        return None, sets.U
    G, c = sets.zonotope.generators, sets.zonotope.centre
    ones = np.ones(G.shape[1])
    return np.hstack([np.eye(len(c)), G]), Box(np.concatenate([c, -ones]), np.concatenate([c, ones]))


def along_joints(directions: Array) -> Array:
    """Rows (2k, 2n) that read positions, then speeds, along ``directions`` (k, n) of the joints."""
    none = np.zeros_like(directions)
    return np.block([[directions, none], [none, directions]])


def between_samples(abstraction: Abstraction, dt: float, lo: Array, hi: Array, u: Box) -> tuple[Array, Array]:
    """Bounds (N - 1, 2n) of all states *between* samples, from bounds ``lo``, ``hi`` (N, 2n) at the samples (trap P3).

    ``u`` (n,): all inputs of the linear model that may act meanwhile, at any time.  An angle leaves the chord between two
    samples by at most ``a_max dt^2 / 8``, a speed by ``a_max dt / 2``; whatever is compared with a limit needs that on top of
    the samples' hull.
    """
    A, _ = _linear(abstraction)
    n = abstraction.n
    drag, gain = np.abs(A[n:, n:]), np.abs(abstraction.Minv)
    push = gain @ np.maximum(np.abs(u.lo), np.abs(u.hi))
    ends = np.maximum(np.abs(lo[:, n:]), np.abs(hi[:, n:]))
    # no speed within the step is larger: |dq'| <= drag |dq| + push
    speed = (np.maximum(ends[:-1], ends[1:]) + dt * push) @ expm(drag * dt).T
    a_max = speed @ drag.T + push
    out = np.hstack([a_max * dt**2 / 8.0, a_max * dt / 2.0]) * (1.0 + 2.0**-40)
    return np.minimum(lo[:-1], lo[1:]) - out, np.maximum(hi[:-1], hi[1:]) + out
