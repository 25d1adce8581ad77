"""One recording as the workbench draws it: the arm over time, and each joint within what was predicted for it.

A recording is held whole, so that any stretch of it can be shown as fine as the screen: what is left out is never an extreme.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from stopset.artifact import Model
from stopset.offline.compare.compare import Comparison, Violation, inputs
from stopset.offline.compare.tubes import around
from stopset.offline.compare.verdict import AT_THE_FLOOR, above, by_failure
from stopset.offline.report.thin import extremes, hulls
from stopset.reach.flowpipe import deviation_tube
from stopset.reach.predict import predict
from stopset.recording import Recording
from stopset.types import Array

FRAMES = 200  # of the arm
POINTS = 600  # per line
LISTED = 200  # recordings to choose from, the worst first


def listed(found: Comparison) -> list[dict[str, Any]]:
    """The recordings, those that leave the sets most first, then those that err most."""
    rows = sorted(
        found.rows, key=lambda r: (-(r.violation.relative if r.violation else 0.0), -float(np.nanmax(r.torque_rms, initial=0.0)))
    )
    return [{"label": r.label, "violates": r.violation is not None, "inside_domain": r.inside_domain} for r in rows[:LISTED]]


@dataclass(frozen=True, slots=True)
class Scene:
    """A recording whole: ``t`` (N,) [s] from its start, ``q`` (N, n) [rad], and the band ``lo, hi`` about it, which may end earlier."""

    label: str
    model: Model
    t: Array
    q: Array
    lo: Array
    hi: Array
    fails: str | None
    violation: Violation | None

    def window(self, begin: float, end: float, before: Scene | None = None) -> dict[str, Any]:
        """What there is to see from ``begin`` to ``end`` [s]; ``before``: the same recording under another model, to compare."""
        a, b = (int(np.searchsorted(self.t, x)) for x in (begin, end))
        a, b = max(0, min(a, len(self.t) - 2)), min(len(self.t), max(b + 1, a + 2))
        at = np.unique(np.linspace(a, b - 1, FRAMES).astype(int))
        v = self.violation
        return {
            "label": self.label, "t": self.t[at].round(4).tolist(), "whole": float(self.t[-1]),
            "arm": [self.model.robot.outline(q).round(3).tolist() for q in self.q[at]],
            "joints": [self._line(k, a, b) for k in range(self.model.n)],
            "before": None if before is None else [before._band(k, a, b) for k in range(self.model.n)],
            "fails": self.fails,
            "violation": None if v is None else {
                "state": v.state, "t": v.start_s + v.age_s, "says": f"{v.state} {v.side} by {v.excess:.3g} {v.unit}",
            },
        }  # fmt: skip

    def _line(self, k: int, a: int, b: int) -> dict[str, Any]:
        """A joint's positions [rad] and the band about them, thinned without losing an extreme."""
        keep = a + extremes(self.q[a:b, k], POINTS)
        return {"t": self.t[keep].round(4).tolist(), "y": self.q[keep, k].round(6).tolist(), **self._band(k, a, b)}

    def _band(self, k: int, a: int, b: int) -> dict[str, Any]:
        lo, hi = self.lo[a:b, k], self.hi[a:b, k]
        if not (len(lo) and np.isfinite(lo).all() and np.isfinite(hi).all()):
            return {"band_t": [], "lo": [], "hi": []}
        at, low, high = hulls(lo, hi, POINTS // 2)
        return {"band_t": self.t[a + at].round(4).tolist(), "lo": low.tolist(), "hi": high.tolist()}


def scene(model: Model, found: Comparison, label: str) -> Scene | None:
    """The recording ``label`` under ``model``; None where there is none of that name."""
    row = next((r for r in found.rows if r.label == label), None)
    pairs = inputs(model, found.trials, found.survey, model.powered.dt)
    trial = next(((r, u) for _, r, u in pairs if r.label == label), None) if row is not None else None
    if row is None or trial is None:
        return None
    lo, hi = _predicted(model, *trial)
    name, worst = by_failure(found)[0]
    fails = name if (above(worst) or 0.0) > AT_THE_FLOOR else None
    r = trial[0]
    return Scene(label, model, r.t - r.t[0], r.q, lo[:, : model.n], hi[:, : model.n], fails, row.violation)


def _predicted(model: Model, r: Recording, u: Array) -> tuple[Array, Array]:
    """Edges (M, 2n) of what was predicted: from the start, and again from the measurement whenever a prediction has reached its end.

    A nonlinear model's is drawn from the start alone: its tube is another one along every stretch.
    """
    if not model.abstraction.linear:
        return around(model, model.powered, [(r, u)])
    sets, x = model.powered, np.hstack([r.q, r.dq])
    tube, steps, N = deviation_tube(model.abstraction, sets), round(sets.horizon / sets.dt), len(r.t)
    lo, hi = np.empty_like(x), np.empty_like(x)
    for a in range(0, N, steps + 1):
        path = predict(model.abstraction, sets.dt, x[a], u[a : a + steps + 1])[: min(steps + 1, N - a)]
        lo[a : a + len(path)], hi[a : a + len(path)] = path + tube.lo[: len(path)], path + tube.hi[: len(path)]
    return lo, hi
