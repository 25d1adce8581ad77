"""Problems of uncertainty sets in few words, and the searches that ours are held against."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from stopset.artifact import Abstraction, UncertaintySets
from stopset.offline.abstraction.grid import GRID, Trial, coarser
from stopset.offline.campaign.reading_error import ReadingError
from stopset.offline.conform.monotone_sets import fit_cooperative
from stopset.offline.conform.nonlinear import WINDOWS, fit_windows, starts, windows_of
from stopset.offline.conform.problem import Options, SetProblem
from stopset.offline.conform.zonotopes import Template
from stopset.types import Array


def problem(
    abstraction: Abstraction, readings: ReadingError, dt: float, steps: int, conform: str = "all", template: Template | None = None,
    margin: float | None = None,
) -> SetProblem:  # fmt: skip
    """Sets over ``steps`` of ``dt`` [s] from every sample; joints are a, b, c."""
    joints = tuple("abcdef"[: abstraction.n])
    return SetProblem(abstraction, joints, readings, dt, steps * dt, Options(conform, margin=margin), template)


def fit_nonlinear(trials: Sequence[Trial], asked: SetProblem) -> UncertaintySets:
    """Sets of any abstraction from open-loop trials, without margin or guarantee."""
    every = 1 if asked.abstraction.decoupled else max(1, round(GRID / asked.dt))
    coarse, dt = coarser(trials, every) if every > 1 else list(trials), asked.dt * every
    steps = min(round(asked.horizon / dt), max(len(x) for x, _ in coarse) - 1)
    asked = replace(asked, dt=dt, horizon=steps * dt)
    if asked.abstraction.decoupled:
        fit, factors = fit_cooperative(coarse, asked)
        factor = float(factors.max())
    else:
        fit, factor = fit_windows(list(windows_of(coarse, asked, starts(coarse, asked.options.windows, WINDOWS))), asked)
    return UncertaintySets(fit.X0, fit.U, fit.V, dt, steps * dt, asked.options.conform, asked.options.windows, factor)


def binary_search(z: Array, conformant: Callable[[Array], bool], order: Sequence[int], rounds: int = 30) -> Array:
    """The paper's search: shrink one bound after the other towards 0 as far as the data allow.

    ``z``: sets that enclose the data.  The answer depends on ``order`` (trap P19): whichever bound comes first gives
    way most.
    """
    out = np.array(z)
    for k in order:
        low, high = 0.0, 1.0
        for _ in range(rounds):
            middle = 0.5 * (low + high)
            trial = out.copy()
            trial[k] = middle * out[k]
            low, high = (low, middle) if conformant(trial) else (middle, high)
        out[k] *= high
    return out
