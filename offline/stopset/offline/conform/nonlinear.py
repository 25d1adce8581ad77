"""The uncertainty sets of nonlinear abstractions, by the algorithm that suits the model.

A decoupled model 1 with any friction curve: the exact two-simulation hull (`cooperative`).  Everything else (models 2
and 3, a model 1 with coupled joints): along the nominal solution of every window the deviations obey a linear
time-varying equation, whose box hull *defines* the prediction set, in identification and at run time alike (trap P18).
It is linear in the unknown bounds, so a linear program over a sub-sample of windows and ages finds the cheapest sets,
and one common scaling about their centres, the smallest that encloses every window and age of the check, finishes.  The
hull is exactly affine in the scaling, so its root is taken in closed form where bisection would end.

What the linearisation leaves out is second order in the deviation; `leak` measures it by sampling.

Source: Liu & Althoff (2018), Sec. IV-C.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stopset.artifact import ActiveBound
from stopset.errors import NotConformant
from stopset.offline.abstraction.grid import Trial
from stopset.offline.abstraction.metrics import STOP_TIME
from stopset.offline.campaign.reading_error import ReadingError
from stopset.offline.conform.corners import RUNAWAY
from stopset.offline.conform.linear_program import FittedSets
from stopset.offline.conform.problem import SetProblem
from stopset.offline.conform.program import Bounds, age_weights, cheapest, price, sides, tight
from stopset.reach.flowpipe import Responses
from stopset.reach.nonlinear import along, nominal
from stopset.sets import Box
from stopset.types import Array

WINDOWS = 160  # of the check; the program sees every other one
AGES = 14  # of a window that give rows in the program, evenly in the logarithm
BATCH = 64  # nominal solutions integrated at once
NEAREST = 0.5  # [s] predictions of a model that runs away are shortened down to this


class Diverges(NotConformant):
    """The nominal solution runs away within the horizon, so that no set about it says anything."""


@dataclass(frozen=True, slots=True)
class DeviationWindow:
    """Deviation ``d`` (H + 1, 2n) of the readings from the nominal solution that starts at one of them, and its responses."""

    trial: int
    start: int
    d: Array
    R: Responses


def starts(trials: Sequence[Trial], windows: str, number: int) -> list[tuple[int, int]]:
    """(trial, start sample), about ``number`` of them evenly over all samples and one in every trial; or every trial's first."""
    stride = stride_of(sum(len(x) - 1 for x, _ in trials), number)
    return [(k, s) for k, (x, _) in enumerate(trials) for s in starts_in(k, len(x), windows, stride)]


def stride_of(steps: int, number: int) -> int:
    """Distance of window starts, about ``number`` of them over so many steps of all trials."""
    return max(1, steps // number)


def starts_in(place: int, samples: int, windows: str, stride: int) -> range:
    """Window starts in one trial, by its place among all."""
    if windows == "start":
        return range(1)
    # trials begin at different places of the stride, so that all ages of a motion are met
    return range((place * 7) % max(1, min(stride, samples - 1)), samples - 1, stride)


def windows_of(trials: Sequence[Trial], asked: SetProblem, where: Sequence[tuple[int, int]]) -> Iterator[DeviationWindow]:
    """The windows at ``where``, one after the other."""
    abstraction, dt, horizon = asked.abstraction, asked.dt, asked.steps
    for first in range(0, len(where), BATCH):
        batch = where[first : first + BATCH]
        last = [min(horizon, len(trials[k][0]) - 1 - s) for k, s in batch]
        u = np.zeros((len(batch), max(last), abstraction.n))
        for row, ((k, s), steps) in enumerate(zip(batch, last, strict=True)):
            u[row, :steps] = trials[k][1][s : s + steps]
        x0 = np.array([trials[k][0][s] for k, s in batch])
        with np.errstate(over="ignore", invalid="ignore"):
            x = nominal(abstraction, x0, u, dt)
        for (k, s), steps, path in zip(batch, last, x, strict=True):
            if not np.all(np.abs(path[: steps + 1]) < RUNAWAY):
                raise Diverges(
                    f"model {abstraction.kind} of order {abstraction.order} diverges from the recorded motion within "
                    f"{steps * dt:.2f} s (trial {k}, {s * dt:.2f} s after its start); expected a bounded solution: take "
                    f"{'--order 1' if abstraction.kind == 1 else 'another order, or --model 1'}"
                )

        def answer(row: int, x: Array = x, u: Array = u, last: list[int] = last) -> Responses:
            return along(abstraction, x[row, : last[row] + 1], u[row, : last[row]], dt)

        with ThreadPoolExecutor(os.cpu_count()) as pool:  # the core releases the interpreter
            for row, R in enumerate(pool.map(answer, range(len(batch)))):
                k, s = batch[row]
                yield DeviationWindow(k, s, trials[k][0][s : s + last[row] + 1] - x[row, : last[row] + 1], R)


def _rows(w: DeviationWindow, ages: NDArray[np.int64], states: int) -> tuple[Array, Array]:
    """Rows ``G z >= h`` of one window (see `program`), upper sides first."""
    E, P, N = (x[ages][:, :states].reshape(-1, x.shape[2]) for x in (w.R.E1, w.R.plus, w.R.minus))
    L = np.tile(w.R.E1[0, :states], (len(ages), 1))
    d = w.d[ages][:, :states].ravel()
    return np.vstack(sides(E, L, P, N)), np.concatenate([d, -d])


def _cost(w: DeviationWindow, dt: float, states: int, n: int) -> Array:
    """Price of the unknowns by one window: mean tube width [rad], velocities counted as the way gone in a stop."""
    E, P, N = (x[1:, :states] for x in (w.R.E1, w.R.plus, w.R.minus))
    weight: Array = np.where(np.arange(states) < n, 1.0, STOP_TIME)
    return price(E, w.R.E1[0, :states], P, N, age_weights(len(w.d) - 1, dt), weight)


def needed(w: DeviationWindow, fit: FittedSets) -> float:
    """Smallest factor about the sets' centres with which one window is enclosed at all its ages; inf if none."""
    states = slice(0, fit.U.dim * (2 if fit.conform == "all" else 1))

    c_lo, c_hi = (x[1:, states] for x in w.R.tube(*(Box.point(b.centre) for b in (fit.X0, fit.inputs, fit.V))))
    lo, hi = (x[1:, states] for x in w.R.tube(fit.X0, fit.inputs, fit.V))
    d = w.d[1:, states]
    with np.errstate(divide="ignore", invalid="ignore"):
        above = np.where(d > c_hi, (d - c_hi) / (hi - c_hi), 0.0)
        below = np.where(d < c_lo, (c_lo - d) / (c_lo - lo), 0.0)
    return float(max(above.max(initial=0.0), below.max(initial=0.0)))


def fit_windows(seen: Sequence[DeviationWindow], asked: SetProblem, labels: Sequence[str] = ()) -> tuple[FittedSets, float]:
    """Cheapest sets that enclose these windows, and the common scaling that the final check over all of them asked for.

    ``labels`` of the trials: to say what fixes each bound.  Raises `NotConformant`.
    """
    readings, dt, conform = asked.readings, asked.dt, asked.options.conform
    m = readings.dim
    n = m // 2
    states = m if conform == "all" else n
    chosen = seen[:: 2 if asked.options.windows == "sliding" else 1]  # the program sees every other one
    ages = [np.unique(np.geomspace(1, len(w.d) - 1, AGES).astype(int)) for w in chosen]
    pairs = [_rows(w, a, states) for w, a in zip(chosen, ages, strict=True)]
    cost = np.sum([_cost(w, dt, states, n) for w in chosen], axis=0)
    G, h = np.vstack([rows for rows, _ in pairs]), np.concatenate([rhs for _, rhs in pairs])
    bounds = Bounds(readings if conform == "all" else ReadingError.exact(readings.least), n)
    z = bounds.tidy(cheapest(G, h, cost / len(chosen), bounds, "this model"))
    x_lo, x_hi, v_lo, v_hi, u_lo, u_hi = bounds.split(z)
    active = []
    if labels:
        origin = [(w, int(age), i) for w, a in zip(chosen, ages, strict=True) for _ in "hl" for age in a for i in range(states)]
        title = [f"{x}_{j}" for x in ("q", "dq") for j in asked.joints]
        inputs = [f"V[{x}]" for x in title] * 2 + [f"U[{j}]" for j in asked.joints] * 2
        side = ["lo"] * m + ["hi"] * m + ["lo"] * n + ["hi"] * n
        for v, r in tight(G, h, z, bounds).items():
            w, age, i = origin[r]
            bound = f"{inputs[v - 2 * m]}.{side[v - 2 * m]}"
            active.append(ActiveBound(bound, labels[w.trial], w.start * dt, age * dt, title[i]))
    fit = FittedSets(Box(x_lo, x_hi), Box(u_lo, u_hi), Box(v_lo, v_hi), float(cost @ z / len(chosen)), tuple(active), conform)
    factor = max(1.0, *(needed(w, fit) for w in seen))
    if not np.isfinite(factor):
        raise NotConformant("no common scaling of the sets encloses the readings; expected noise above 0 in every state")
    # the last rounding of the division, outward
    return (fit.inflated(factor * (1.0 + 1e-9)), factor) if factor > 1.0 else (fit, 1.0)
