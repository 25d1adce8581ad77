"""The uncertainty sets of model 1 with any friction curve, joint by joint, by the exact two-simulation hull (trap P22).

The upper corner of ``X0`` and ``U`` alone decides the upper side of the tube, the lower corner the lower side.  The
sets of least cost are found by cutting planes: simulate both corners for many window starts, linearise the worst ages
along the corner solution, solve the small linear program, repeat.  Then every window start is simulated, and one common
scaling about the sets' centres, found by bisection, encloses what is still outside: growing is monotone, so that is
sound. The paper's binary search per dimension depends on the order of the dimensions (trap P19).

Source: Liu & Althoff (2018), Sec. IV-C.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stopset.artifact import ActiveBound
from stopset.errors import NotConformant
from stopset.offline.abstraction.grid import Trial
from stopset.offline.abstraction.metrics import STOP_TIME
from stopset.offline.conform.corners import NOISE_HI, NOISE_LO, Q_HI, Q_LO, U_HI, U_LO, V_HI, V_LO, JointProblem
from stopset.offline.conform.linear_program import FittedSets
from stopset.offline.conform.problem import SetProblem
from stopset.offline.conform.program import age_weights, solved
from stopset.reach.flowpipe import responses
from stopset.reach.nonlinear import parts
from stopset.sets import Box
from stopset.types import Array

ROUNDS = 60  # of cutting planes
# what is still outside after the search, relative to the tube's size, is left to the scaling
SETTLED = 1e-6
LARGEST = 1e3  # scaling beyond which the data contradict the model


def _program(problem: JointProblem, rows: list[Array], rhs: list[float]) -> Array:
    """Cheapest sets that satisfy all planes; X0 inside -V (trap P12), velocity noise between ``noise`` and ``most``."""
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
    wide = problem.most if problem.both else b
    bounds = [(-a, a), (None, None), (-a, a), (None, None), (-wide, -b), (b, wide), (None, None), (None, None)]
    # a vanishing charge on every width, and unit size of every row, as for the linear sets
    sign = np.array([-1.0, -1.0, 1.0, 1.0, -1.0, 1.0, -1.0, 1.0])
    cost = problem.cost + 1e-9 * np.abs(problem.cost).max() * sign
    G, h = np.array(rows).reshape(-1, 8), np.array(rhs)
    scale = np.maximum(np.abs(G).max(axis=1, initial=0.0), 1e-12)
    A = np.vstack([-G / scale[:, None], np.array(limits)])
    none = "expected a friction curve that holds at the recorded speeds: identify it again or take the linear model (--order 1)"
    return solved(cost, A, np.concatenate([-h / scale, np.zeros(len(limits))]), bounds, f"joint {problem.name}", none)


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
    flags = [a | b for a, b in zip(*(problem.excess(z, sign, every).outside for sign in (1.0, -1.0)), strict=True)]
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


def problems(trials: Sequence[Trial], asked: SetProblem) -> list[JointProblem]:
    """One problem per joint; a torque's and a start's price are those of the model linearised at rest."""
    abstraction, readings, dt, every = asked.abstraction, asked.readings, asked.dt, asked.options.conform == "all"
    n = abstraction.n
    horizon = min(asked.steps, max(len(x) for x, _ in trials) - 1)
    linear = replace(abstraction, order=1, viscous=np.maximum(abstraction.viscous[:, :1], 0.0))
    R = responses(linear, dt, horizon)
    importance = age_weights(horizon, dt)
    speed = np.max([np.abs(x[:, n:]).max(axis=0) for x, _ in trials], axis=0) + 1.0
    out = []
    for j in range(n):
        cost = np.zeros(8)
        for i, weight in ((j, 1.0), (n + j, STOP_TIME if every else 0.0)):
            q, v = importance @ np.abs(R.E1[1:, i, j]), importance @ np.abs(R.E1[1:, i, n + j])
            torque = importance @ (R.plus[1:, i, j] - R.minus[1:, i, j])
            own = float(i == n + j)
            cost += weight * np.array([-q, -v, q, v, -own, own, -torque, torque])
        out.append(
            JointProblem(
                asked.joints[j], [np.ascontiguousarray(x[:, [j, n + j]]) for x, _ in trials],
                [np.ascontiguousarray(u[:, j]) for _, u in trials], float(abstraction.Minv[j, j]), abstraction.viscous[j].copy(),
                dt, horizon, parts(abstraction, dt, speed), asked.options.windows == "sliding", readings.least.hi[[j, n + j]],
                float(readings.most.hi[n + j]), every, cost,
            )
        )  # fmt: skip
    return out


def fit_cooperative(trials: Sequence[Trial], asked: SetProblem, labels: Sequence[str] = ()) -> tuple[FittedSets, Array]:
    """Sets of a decoupled model 1 with any friction curve, and the scaling each joint needed in the final check (n,).

    ``trials``: states (N, 2n) and inputs (N, n) on the grid; ``labels`` of the trials: to say what fixes each bound.
    Raises `NotConformant`.
    """
    n = asked.abstraction.n
    z = np.empty((n, 8))
    factor = np.ones(n)
    active: list[ActiveBound] = []
    cost = 0.0
    for j, problem in enumerate(problems(trials, asked)):
        z[j], factor[j] = verified(problem, search(problem))
        cost += float(problem.cost @ z[j]) + 2.0 * float(problem.noise[0])
        if labels:
            active += touched(problem, z[j], labels)
    return replace(packed(z, asked.readings.least.hi[:n], cost, asked.options.conform), active=tuple(active)), factor


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


def needed_factor(fit: FittedSets, trials: Sequence[Trial], asked: SetProblem) -> float:
    """Smallest factor (>= 1, to 1e-4) about the sets' centres that encloses ``trials``, worst joint."""
    n, worst = asked.abstraction.n, 1.0
    for j, problem in enumerate(problems(trials, asked.asking(fit.conform))):
        z = np.empty(8)
        z[[Q_LO, V_LO, Q_HI, V_HI]] = fit.X0.lo[j], fit.X0.lo[n + j], fit.X0.hi[j], fit.X0.hi[n + j]
        z[[NOISE_LO, NOISE_HI, U_LO, U_HI]] = fit.V.lo[n + j], fit.V.hi[n + j], fit.U.lo[j], fit.U.hi[j]
        # angles are read to within V, which a margin may have widened
        worst = max(worst, verified(replace(problem, noise=fit.V.hi[[j, n + j]]), z)[1])
    return worst


def packed(z: Array, half: Array, cost: float, conform: str) -> FittedSets:
    """The joints' unknowns (n, 8) as boxes; ``half`` (n,): error of an angle."""
    X0 = Box(np.concatenate([z[:, Q_LO], z[:, V_LO]]), np.concatenate([z[:, Q_HI], z[:, V_HI]]))
    V = Box(np.concatenate([-half, z[:, NOISE_LO]]), np.concatenate([half, z[:, NOISE_HI]]))
    return FittedSets(X0, Box(z[:, U_LO].copy(), z[:, U_HI].copy()), V, cost, (), conform)
