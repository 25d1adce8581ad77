"""One joint's deviations from the two corner simulations that bound it: how far, where, and how they move with the sets.

The upper corner of ``X0`` and ``U`` alone decides the upper side of the tube, the lower corner the lower side (trap P22).

Source: Liu & Althoff (2018), Sec. IV-C.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stopset.errors import NotConformant
from stopset.reach.nonlinear import corner_step

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Trial = tuple[Array, Array]  # states (N, 2n) on the grid, inputs (N, n)

BUDGET = 2_000_000  # simulated steps per pass while searching; the final check takes every start
CUTS = 12  # ages per side and state that give a plane in one round
RUNAWAY = 1e3  # [rad/s] a friction polynomial beyond its range may push: no tube there
# places of one joint's unknowns
Q_LO, V_LO, Q_HI, V_HI, NOISE_LO, NOISE_HI, U_LO, U_HI = range(8)


@njit(cache=True)
def _excess(
    x: Array, w: Array, c: Array, dt: float, cut: int, starts: Index, horizon: int, dq0: float, dv0: float, sign: float,
    limit: Array, best: Array, at: Index, trial: int, outside: NDArray[np.bool_],
) -> None:  # fmt: skip
    """How far readings lie beyond one corner's solutions, per age: maximum into ``best`` (H + 1, 2), where into ``at``.

    ``outside``: set for starts from which a reading lies beyond ``limit`` (2,).
    """
    N = x.shape[0]
    for i in range(starts.shape[0]):
        s = starts[i]
        q, v = x[s, 0] + dq0, x[s, 1] + dv0
        for h in range(1, min(horizon, N - 1 - s) + 1):
            q, v = corner_step(q, v, w[s + h - 1], c, dt, cut)
            if not abs(v) < RUNAWAY:
                if sign * v < 0:  # gone the wrong way: nothing is enclosed
                    best[h, 0] = best[h, 1] = np.inf
                    outside[i] = True
                break
            e = sign * (x[s + h, 0] - q)
            if e > best[h, 0]:
                best[h, 0], at[h, 0, 0], at[h, 0, 1] = e, trial, s
            if e > limit[0]:
                outside[i] = True
            e = sign * (x[s + h, 1] - v)
            if e > best[h, 1]:
                best[h, 1], at[h, 1, 0], at[h, 1, 1] = e, trial, s
            if e > limit[1]:
                outside[i] = True


@njit(cache=True)
def _sensitivity(q: float, v: float, w: Array, c: Array, dt: float, cut: int) -> tuple[float, float, Array]:
    """End (q, v) after ``w`` (h,) and its derivatives (2, 3) by start angle, start speed and a constant added to ``w``."""
    d = dt / cut
    S = np.zeros((2, 3))
    S[0, 0] = S[1, 1] = 1.0
    for k in range(w.shape[0]):
        for _ in range(cut):
            before = v
            q, v = corner_step(q, v, w[k], c, d, 1)
            middle, a = 0.5 * (before + v), 0.0
            for i in range(c.shape[0]):
                a += (i + 1) * c[i] * middle**i
            z = a * d
            decay = np.exp(-z)
            # integrals over the step of e^-at, and of that again; series where the difference would cancel
            one = d * (1.0 - z / 2.0 + z * z / 6.0) if abs(z) < 1e-4 else (1.0 - decay) / a
            two = d * d * (0.5 - z / 6.0) if abs(z) < 1e-4 else (d - one) / a
            S[0, 1] += S[1, 1] * one
            S[1, 1] *= decay
            S[0, 2] += S[1, 2] * one + two
            S[1, 2] = S[1, 2] * decay + one
    return q, v, S


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

    def excess(self, z: Array, sign: float, which: Sequence[Index]) -> tuple[Array, Index, list[NDArray[np.bool_]]]:
        """Worst reading beyond one side per age (H + 1, 2), where it is, and which of the starts are outside."""
        best = np.full((self.horizon + 1, 2), -np.inf)
        at = np.zeros((self.horizon + 1, 2, 2), np.int64)
        dq0, dv0, torque = self.corner(z, sign)
        room, c = self.room(z, sign), self.gain * self.viscous
        outside = []
        for k, (x, u, s) in enumerate(zip(self.x, self.u, which, strict=True)):
            flags = np.zeros(len(s), np.bool_)
            w = self.gain * (u + torque)
            _excess(x, w, c, self.dt, self.cut, s, self.horizon, dq0, dv0, sign, room, best, at, k, flags)
            outside.append(flags)
        return best, at, outside

    def conformant(self, z: Array, which: Sequence[Index] | None = None) -> bool:
        """Whether every reading from these starts (all, if left out) lies inside."""
        chosen = [self.starts(len(x), 1) for x in self.x] if which is None else which
        return not any(flags.any() for sign in (1.0, -1.0) for flags in self.excess(z, sign, chosen)[2])

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
