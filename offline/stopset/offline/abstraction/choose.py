"""Which abstraction: the one that predicts recorded motion best, since a higher order is not a better model (Table I).

Source: Liu & Althoff (2018), Table I (not monotone in p).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stopset.artifact import Abstraction
from stopset.errors import StopsetError
from stopset.offline.abstraction.metrics import STOP_TIME
from stopset.reach.nonlinear import nominal
from stopset.types import Array

WINDOWS = 60
TIE = 0.02  # relative difference below which the simpler model is taken


@dataclass(frozen=True, slots=True)
class ModelCandidate:
    """An abstraction and its error on held-out motion: RMS over windows, ages and joints [rad]; inf: it diverged."""

    abstraction: Abstraction
    error: float

    @property
    def label(self) -> str:
        return f"model {self.abstraction.kind}, order {self.abstraction.order}"


def prediction_error(abstraction: Abstraction, trials: Sequence[tuple[Array, Array]], dt: float, horizon: float) -> float:
    """RMS [rad] of open-loop predictions up to ``horizon`` [s] ahead, from about `WINDOWS` starts over ``trials``.

    ``trials``: states (N, 2n) and inputs (N, n) every ``dt`` [s].  Velocities count as the way they go in `STOP_TIME`.
    """
    n = abstraction.n
    H = min(round(horizon / dt), min(len(x) for x, _ in trials) - 1)
    if H < 1:
        raise StopsetError(f"trials of {min(len(x) for x, _ in trials)} samples are too short to compare models; expected 2")
    total = sum(len(x) - H for x, _ in trials)
    stride = max(1, total // WINDOWS)
    where = [(k, s) for k, (x, _) in enumerate(trials) for s in range((k * 7) % stride, len(x) - H, stride)] or [(0, 0)]
    x0 = np.array([trials[k][0][s] for k, s in where])
    u = np.array([trials[k][1][s : s + H] for k, s in where])
    seen = np.array([trials[k][0][s : s + H + 1] for k, s in where])
    with np.errstate(over="ignore", invalid="ignore"):
        e = nominal(abstraction, x0, u, dt) - seen
        e[:, :, n:] *= STOP_TIME
        mean = float(np.sqrt(np.mean(e**2)))
    return mean if np.isfinite(mean) else float("inf")


def ranked(
    models: Sequence[Abstraction], trials: Sequence[tuple[Array, Array]], dt: float, horizon: float = 1.0
) -> list[ModelCandidate]:
    """``models`` by their error on held-out ``trials``, best first; within `TIE` the simpler one (kind, then order)
    leads.

    Raises `StopsetError` when all of them diverge.
    """
    return best_first([ModelCandidate(m, prediction_error(m, trials, dt, horizon)) for m in models], horizon)


def best_first(found: Sequence[ModelCandidate], horizon: float = 1.0) -> list[ModelCandidate]:
    """Candidates by their error, see `ranked`. Raises `StopsetError` when all of them diverge within ``horizon`` [s]."""
    best = min(c.error for c in found)
    if not np.isfinite(best):
        raise StopsetError(
            f"all {len(found)} models diverge within {horizon} s of held-out motion; expected at least one that follows it: "
            "check the torque's sign and unit, or identify the nominal model again"
        )
    return sorted(found, key=lambda c: (c.error > best * (1 + TIE), c.error if c.error > best * (1 + TIE) else 0.0, _simple(c)))


def _simple(c: ModelCandidate) -> tuple[int, int]:
    return c.abstraction.kind, c.abstraction.order
