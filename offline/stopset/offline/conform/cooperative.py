"""The uncertainty sets of model 1 with any friction curve, joint by joint, by the exact two-simulation hull (trap P22).

The upper corner of ``X0`` and ``U`` alone decides the upper side of the tube, the lower corner the lower side.  The
sets of least cost are found by cutting planes: simulate both corners for many window starts, linearise the worst ages
along the corner solution, solve the small linear program, repeat.  Then every window start is simulated, and one common
scaling about the sets' centres, found by bisection, encloses what is still outside: growing is monotone, so that is
sound. The paper's binary search per dimension depends on the order of the dimensions (trap P19) and is kept for
comparison.

Source: Liu & Althoff (2018), Sec. IV-C.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.optimize import linprog

from stopset.artifact import Abstraction, ActiveBound
from stopset.errors import NotConformant
from stopset.offline.conform.linear import Fit
from stopset.offline.conform.program import STOP_TIME, age_weights
from stopset.reach.flowpipe import responses
from stopset.reach.nonlinear import corner_step, parts
from stopset.sets import Box

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Trial = tuple[Array, Array]  # states (N, 2n) on the grid, inputs (N, n)

BUDGET = 2_000_000  # simulated steps per pass while searching; the final check takes every start
ROUNDS = 60  # of cutting planes
CUTS = 12  # ages per side and state that give a plane in one round
# what is still outside after the search, relative to the tube's size, is left to the scaling
SETTLED = 1e-6
LARGEST = 1e3  # scaling beyond which the data contradict the model
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

    ``noise``: (2,) half-widths of the reading's noise; ``both``: must velocities be enclosed too; ``cost``: (8,) price
    of each unknown [rad].
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


def _program(problem: JointProblem, rows: list[Array], rhs: list[float]) -> Array:
    """Cheapest sets that satisfy all planes; X0 inside -V (trap P12), velocity noise at least ``noise``."""
    a, b = problem.noise
    order = [(Q_LO, Q_HI), (V_LO, V_HI), (U_LO, U_HI)]
    limits = []
    for low, high in order:
        row = np.zeros(8)
        row[low], row[high] = 1.0, -1.0
        limits.append(row)
    for x, noise in ((V_HI, NOISE_LO), (V_LO, NOISE_HI)):  # V_hi <= -NOISE_lo, V_lo >= -NOISE_hi
        row = np.zeros(8)
        row[[x, noise]] = 1.0 if x == V_HI else -1.0
        limits.append(row)
    wide = np.inf if problem.both else b
    bounds = [(-a, a), (None, None), (-a, a), (None, None), (-wide, -b), (b, wide), (None, None), (None, None)]
    # a vanishing charge on every width, and unit size of every row, as for the linear sets
    sign = np.array([-1.0, -1.0, 1.0, 1.0, -1.0, 1.0, -1.0, 1.0])
    cost = problem.cost + 1e-9 * np.abs(problem.cost).max() * sign
    G, h = np.array(rows).reshape(-1, 8), np.array(rhs)
    scale = np.maximum(np.abs(G).max(axis=1, initial=0.0), 1e-12)
    A = np.vstack([-G / scale[:, None], np.array(limits)])
    result = linprog(cost, A_ub=A, b_ub=np.concatenate([-h / scale, np.zeros(len(limits))]), bounds=bounds, method="highs-ds")
    if result.status != 0:
        raise NotConformant(
            f"no sets make joint {problem.name} conformant ({result.message.splitlines()[0].strip()}); expected a friction "
            "curve that holds at the recorded speeds: identify it again or take the linear model (--order 1)"
        )
    return np.asarray(result.x)


def search(problem: JointProblem) -> Array:
    """Sets of least cost over a sub-sample of window starts, to within `SETTLED`."""
    which = [problem.starts(len(x), problem.stride) for x in problem.x]
    rows: list[Array] = []
    rhs: list[float] = []
    z = np.zeros(8)
    z[NOISE_LO], z[NOISE_HI] = -problem.noise[1], problem.noise[1]
    for _ in range(ROUNDS):
        worst = 0.0
        for sign in (1.0, -1.0):
            more, need, over = problem.planes(z, sign, which)
            rows, rhs, worst = rows + more, rhs + need, max(worst, over)
        if worst <= SETTLED * (problem.noise.max() + float(np.abs(z).max())):
            break
        z = _program(problem, rows, rhs)
    return z


def scaled(problem: JointProblem, z: Array, factor: float) -> Array:
    """All sets grown about their centres, X0 no further than -V; a set of no width gets a millionth of the largest."""
    out = z.copy()
    least = 1e-6 * float(np.abs(z).max())
    for low, high in ((Q_LO, Q_HI), (V_LO, V_HI), (NOISE_LO, NOISE_HI), (U_LO, U_HI)):
        centre, radius = 0.5 * (z[low] + z[high]), max(0.5 * (z[high] - z[low]), least)
        out[low] = min(z[low], centre - factor * radius)
        out[high] = max(z[high], centre + factor * radius)
    out[[Q_LO, Q_HI]] = np.clip(out[[Q_LO, Q_HI]], -problem.noise[0], problem.noise[0])
    out[[V_LO, V_HI]] = np.clip(out[[V_LO, V_HI]], -out[NOISE_HI], -out[NOISE_LO])
    return out


def verified(problem: JointProblem, z: Array) -> tuple[Array, float]:
    """``z`` with the smallest common factor (>= 1, by bisection to 1e-4) under which every window start is enclosed."""
    every = [problem.starts(len(x), 1) for x in problem.x]
    flags = [a | b for a, b in zip(*(problem.excess(z, sign, every)[2] for sign in (1.0, -1.0)), strict=True)]
    left = [s[f] for s, f in zip(every, flags, strict=True)]  # what is inside stays inside while the sets grow
    if not any(len(s) for s in left):
        return z, 1.0
    low, high = 1.0, 1.0 + 1e-4
    while not problem.conformant(scaled(problem, z, high), left):
        low, high = high, 1.0 + 2.0 * (high - 1.0)
        if high > LARGEST:
            raise NotConformant(
                f"joint {problem.name}: even sets {LARGEST:g} times as large do not enclose the data; the model contradicts them"
            )
    while high - low > 1e-4:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if problem.conformant(scaled(problem, z, middle), left) else (middle, high)
    out = scaled(problem, z, high)
    assert problem.conformant(out, left)
    return out, high


def problems(
    trials: Sequence[Trial], abstraction: Abstraction, joints: Sequence[str], noise: Box, dt: float, horizon: int,
    conform: str = "all", windows: str = "sliding",
) -> list[JointProblem]:  # fmt: skip
    """One problem per joint; a torque's and a start's price are those of the model linearised at rest."""
    n = abstraction.n
    horizon = min(horizon, max(len(x) for x, _ in trials) - 1)
    linear = replace(abstraction, order=1, viscous=np.maximum(abstraction.viscous[:, :1], 0.0))
    R = responses(linear, dt, horizon)
    importance = age_weights(horizon, dt)
    speed = np.max([np.abs(x[:, n:]).max(axis=0) for x, _ in trials], axis=0) + 1.0
    out = []
    for j in range(n):
        cost = np.zeros(8)
        for i, weight in ((j, 1.0), (n + j, STOP_TIME if conform == "all" else 0.0)):
            q, v = importance @ np.abs(R.E1[1:, i, j]), importance @ np.abs(R.E1[1:, i, n + j])
            torque = importance @ (R.plus[1:, i, j] - R.minus[1:, i, j])
            own = float(i == n + j)
            cost += weight * np.array([-q, -v, q, v, -own, own, -torque, torque])
        out.append(
            JointProblem(
                joints[j], [np.ascontiguousarray(x[:, [j, n + j]]) for x, _ in trials],
                [np.ascontiguousarray(u[:, j]) for _, u in trials], float(abstraction.Minv[j, j]), abstraction.viscous[j].copy(),
                dt, horizon, parts(abstraction, dt, speed), windows == "sliding", noise.hi[[j, n + j]], conform == "all", cost,
            )
        )  # fmt: skip
    return out


def fit_cooperative(
    trials: Sequence[Trial], abstraction: Abstraction, joints: Sequence[str], noise: Box, dt: float, horizon: int,
    conform: str = "all", windows: str = "sliding", labels: Sequence[str] = (),
) -> tuple[Fit, Array]:  # fmt: skip
    """Sets of a decoupled model 1 with any friction curve, and the scaling each joint needed in the final check (n,).

    ``trials``: states (N, 2n) and inputs (N, n) every ``dt`` [s]; ``noise``: symmetric box (2n,); ``horizon`` in steps;
    ``labels`` of the trials: to say what fixes each bound.  Raises `NotConformant`.
    """
    n = abstraction.n
    z = np.empty((n, 8))
    factor = np.ones(n)
    active: list[ActiveBound] = []
    cost = 0.0
    for j, problem in enumerate(problems(trials, abstraction, joints, noise, dt, horizon, conform, windows)):
        z[j], factor[j] = verified(problem, search(problem))
        cost += float(problem.cost @ z[j]) + 2.0 * float(problem.noise[0])
        if labels:
            active += touched(problem, z[j], labels)
    return replace(packed(z, noise, cost, conform), active=tuple(active)), factor


def touched(problem: JointProblem, z: Array, labels: Sequence[str]) -> list[ActiveBound]:
    """The reading nearest to each side of the tube: it fixes that bound of U, with what the start and the noise leave."""
    every = [problem.starts(len(x), 1) for x in problem.x]
    out = []
    for sign, side in ((-1.0, "lo"), (1.0, "hi")):
        best, at, _ = problem.excess(z, sign, every)
        over = np.where(np.isneginf(best), -np.inf, best - problem.room(z, sign))
        age, state = np.unravel_index(int(np.argmax(over[1:])), over[1:].shape)
        trial, start = at[age + 1, state]
        name = f"{'dq' if state else 'q'}_{problem.name}"
        out.append(ActiveBound(f"U[{problem.name}].{side}", labels[trial], start * problem.dt, (age + 1) * problem.dt, name))
    return out


def needed_factor(
    fit: Fit, trials: Sequence[Trial], abstraction: Abstraction, joints: Sequence[str], noise: Box, dt: float, horizon: int,
    windows: str = "sliding",
) -> float:  # fmt: skip
    """Smallest factor (>= 1, to 1e-4) about the sets' centres that encloses ``trials``, worst joint."""
    n, worst = abstraction.n, 1.0
    for j, problem in enumerate(problems(trials, abstraction, joints, noise, dt, horizon, fit.conform, windows)):
        z = np.empty(8)
        z[[Q_LO, V_LO, Q_HI, V_HI]] = fit.X0.lo[j], fit.X0.lo[n + j], fit.X0.hi[j], fit.X0.hi[n + j]
        z[[NOISE_LO, NOISE_HI, U_LO, U_HI]] = fit.V.lo[n + j], fit.V.hi[n + j], fit.U.lo[j], fit.U.hi[j]
        # angles are read to within V, which a margin may have widened
        worst = max(worst, verified(replace(problem, noise=fit.V.hi[[j, n + j]]), z)[1])
    return worst


def packed(z: Array, noise: Box, cost: float, conform: str) -> Fit:
    """The joints' unknowns (n, 8) as boxes."""
    half = noise.hi[: len(z)]
    X0 = Box(np.concatenate([z[:, Q_LO], z[:, V_LO]]), np.concatenate([z[:, Q_HI], z[:, V_HI]]))
    V = Box(np.concatenate([-half, z[:, NOISE_LO]]), np.concatenate([half, z[:, NOISE_HI]]))
    return Fit(X0, Box(z[:, U_LO].copy(), z[:, U_HI].copy()), V, cost, (), conform)


def binary_search(z: Array, conformant: Callable[[Array], bool], order: Sequence[int], rounds: int = 30) -> Array:
    """The paper's way, for comparison: shrink one bound after the other towards 0 as far as the data allow.

    ``z``: sets that enclose the data.  The answer depends on ``order`` (trap P19): whichever bound comes first gives
    way most.
    """
    out = z.copy()
    for k in order:
        low, high = 0.0, 1.0
        for _ in range(rounds):
            middle = 0.5 * (low + high)
            trial = out.copy()
            trial[k] = middle * out[k]
            low, high = (low, middle) if conformant(trial) else (middle, high)
        out[k] *= high
    return out
