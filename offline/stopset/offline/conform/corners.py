"""One joint's deviations from the two corner simulations that bound it: how far, where, and how they move with the sets.

The upper corner of ``X0`` and ``U`` alone decides the upper side of the tube, the lower corner the lower side (trap P22).

Source: Liu & Althoff (2018), Sec. IV-C.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stopset.core.library import ffi, given, integers, lib, view
from stopset.core.library import flags as flags_of
from stopset.errors import NotConformant
from stopset.reach.nonlinear import joint_struct
from stopset.types import Array, Index

BUDGET = 2_000_000  # simulated steps per pass while searching; the final check takes every start
CUTS = 12  # ages per side and state that give a plane in one round
RUNAWAY = 1e3  # [rad/s], [rad] no arm gets there; a friction polynomial beyond its range may push: no tube there
# places of one joint's unknowns
Q_LO, V_LO, Q_HI, V_HI, NOISE_LO, NOISE_HI, U_LO, U_HI = range(8)


def _sensitivity(q: float, v: float, w: Array, c: Array, dt: float, cut: int) -> tuple[float, float, Array]:
    """End (q, v) after ``w`` (h,) and its derivatives (2, 3) by start angle, start speed and a constant added to ``w``."""
    S, end_q, end_v = np.empty((2, 3)), ffi.new("double *", q), ffi.new("double *", v)
    joint, _held = joint_struct(c, dt, cut)
    lib.stopset_corner_sensitivity(joint, end_q, end_v, len(w), view(given(w)), view(S))
    return end_q[0], end_v[0], S


class Beyond(NamedTuple):
    """Readings beyond one side of the tube: the worst per age and state (H + 1, 2), where it is, and which starts are outside."""

    worst: Array
    at: Index
    outside: list[NDArray[np.bool_]]


@dataclass(frozen=True, slots=True)
class JointProblem:
    """One joint's data: ``x``: states (N, 2) per trial, ``u``: inputs (N,), held over each step of ``dt`` [s].

    ``noise``: (2,) half-widths that the reading's error has at least, of an angle exactly; ``most``: of a speed at most;
    ``both``: must velocities be enclosed too; ``cost``: (8,) price of each unknown [rad].
    """

    name: str
    x: Sequence[Array]
    u: Sequence[Array]
    gain: float
    viscous: Array
    dt: float
    horizon: int
    cut: int
    every_start: bool
    noise: Array
    most: float
    both: bool
    cost: Array

    def starts(self, N: int, stride: int) -> Index:
        """Window starts in a trial of N samples."""
        return np.arange(0, N - 1, stride) if self.every_start else np.zeros(1, np.int64)

    @property
    def stride(self) -> int:
        """Every how many starts the search looks."""
        steps = sum(min(self.horizon, len(x)) * len(x) for x in self.x) if self.every_start else 1
        return int(max(1, steps // BUDGET))

    def corner(self, z: Array, sign: float) -> tuple[float, float, float]:
        """Start angle, start speed and torque of one side."""
        return (z[Q_HI], z[V_HI], z[U_HI]) if sign > 0 else (z[Q_LO], z[V_LO], z[U_LO])

    def room(self, z: Array, sign: float) -> Array:
        """(2,) noise on one side; infinite where nothing is promised."""
        speed = z[NOISE_HI] if sign > 0 else -z[NOISE_LO]
        return np.array([self.noise[0], speed if self.both else np.inf])

    def excess(self, z: Array, sign: float, which: Sequence[Index]) -> Beyond:
        """Worst reading beyond one side per age (H + 1, 2), where it is, and which of the starts are outside."""
        best = np.full((self.horizon + 1, 2), -np.inf)
        at = np.zeros((self.horizon + 1, 2, 2), np.int64)
        dq0, dv0, torque = self.corner(z, sign)
        room, (joint, _held) = self.room(z, sign), joint_struct(self.gain * self.viscous, self.dt, self.cut)
        corner = ffi.new("StopsetCorner *", (joint[0], dq0, dv0, sign, RUNAWAY, self.horizon, room.tolist()))
        outside = []
        for k, (x, u, s) in enumerate(zip(self.x, self.u, which, strict=True)):
            flags = np.zeros(len(s), np.bool_)
            w = given(self.gain * (u + torque))
            if x.shape[1] != 2 or len(w) < len(x) - 1 or (len(s) and not 0 <= s.min() <= s.max() < len(x)):
                raise ValueError(f"windows in states {x.shape} under {len(w)} inputs; expected (N, 2) and N, starts within")
            readings, start = given(x), np.ascontiguousarray(s)
            trial = ffi.new("StopsetTrial *", (k, len(x), view(readings), view(w), len(s), integers(start)))
            lib.stopset_corner_excess(corner, trial, ffi.new("StopsetExcess *", (view(best), integers(at), flags_of(flags))))
            outside.append(flags)
        return Beyond(best, at, outside)

    def conformant(self, z: Array, which: Sequence[Index] | None = None) -> bool:
        """Whether every reading from these starts (all, if left out) lies inside."""
        chosen = [self.starts(len(x), 1) for x in self.x] if which is None else which
        return not any(flags.any() for sign in (1.0, -1.0) for flags in self.excess(z, sign, chosen).outside)

    def planes(self, z: Array, sign: float, which: Sequence[Index]) -> tuple[list[Array], list[float], float]:
        """Rows ``a . z' >= b`` from the worst ages of one side at ``z``, and by how much it is outside."""
        best, at, _ = self.excess(z, sign, which)
        if np.isposinf(best).any():
            raise NotConformant(
                f"joint {self.name}: its friction curve {self.viscous.tolist()} drives the model away from the recorded motion; "
                "expected one that brakes at all recorded speeds: identify it again or take the linear model (--order 1)"
            )
        over = best - np.where(np.isneginf(best), 0.0, self.room(z, sign))
        dq0, dv0, torque = self.corner(z, sign)
        rows, rhs = [], []
        for state in range(2 if self.both else 1):
            for h in np.argsort(-over[:, state])[:CUTS]:
                if not over[h, state] > 0.0:
                    break
                k, s = at[h, state]
                x, w = self.x[k], self.gain * (self.u[k][s : s + h] + torque)
                q, v, S = _sensitivity(x[s, 0] + dq0, x[s, 1] + dv0, w, self.gain * self.viscous, self.dt, self.cut)
                g = S[state] * np.array([1.0, 1.0, self.gain])
                a = np.zeros(8)
                a[[Q_HI, V_HI, U_HI] if sign > 0 else [Q_LO, V_LO, U_LO]] = sign * g
                need = sign * (x[s + h, state] - (q, v)[state]) + sign * float(g @ [dq0, dv0, torque])
                if state == 1:
                    a[NOISE_HI if sign > 0 else NOISE_LO] = sign
                else:
                    need -= self.noise[0]
                rows.append(a)
                rhs.append(need)
        limit = over[:, : 2 if self.both else 1]
        return rows, rhs, float(limit.max(initial=0.0))
