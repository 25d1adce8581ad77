"""One recording as the workbench draws it: the arm over time, and each joint within what was predicted from the trial's start."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from stopset.artifact import Model
from stopset.offline.compare.compare import Comparison, inputs
from stopset.offline.compare.tubes import around
from stopset.offline.compare.verdict import AT_THE_FLOOR, above, by_failure
from stopset.offline.report.thin import extremes, hulls
from stopset.types import Array

FRAMES = 200  # of the arm, and points per line
LISTED = 200  # recordings to choose from, the worst first


def listed(found: Comparison) -> list[dict[str, Any]]:
    """The recordings, those that leave the sets most first, then those that err most."""
    rows = sorted(
        found.rows, key=lambda r: (-(r.violation.relative if r.violation else 0.0), -float(np.nanmax(r.torque_rms, initial=0.0)))
    )
    return [{"label": r.label, "violates": r.violation is not None, "inside_domain": r.inside_domain} for r in rows[:LISTED]]


def scene(model: Model, found: Comparison, paths: Sequence[str | Path], label: str) -> dict[str, Any] | None:
    """What there is to see of the recording ``label``; None where there is none of that name."""
    row = next((r for r in found.rows if r.label == label), None)
    pairs = inputs(model, paths, found.survey, model.powered.dt)
    trial = next(((r, u) for _, r, u in pairs if r.label == label), None) if row is not None else None
    if row is None or trial is None:
        return None
    r, _ = trial
    lo, hi = around(model, model.powered, [trial])
    t = r.t - r.t[0]
    at = np.unique(np.linspace(0, len(t) - 1, FRAMES).astype(int))
    name, worst = by_failure(found)[0]
    v = row.violation
    return {
        "label": label, "t": t[at].round(4).tolist(), "arm": [model.robot.outline(q).round(3).tolist() for q in r.q[at]],
        "joints": [_line(t, r.q[:, k], lo[:, k], hi[:, k]) for k in range(model.n)],
        "fails": name if (above(worst) or 0.0) > AT_THE_FLOOR else None,
        "violation": None if v is None else {"state": v.state, "t": v.start_s + v.age_s, "says": f"{v.state} {v.side} by {v.excess:.3g} {v.unit}"},
    }  # fmt: skip


def _line(t: Array, y: Array, lo: Array, hi: Array) -> dict[str, Any]:
    """A joint's positions [rad] and the band about them, thinned without losing an extreme."""
    keep = extremes(y, FRAMES)
    bounded = np.isfinite(lo).all() and np.isfinite(hi).all()
    band, low, high = hulls(lo, hi, FRAMES) if bounded else (np.empty(0, np.intp), np.empty(0), np.empty(0))
    return {
        "t": t[keep].round(4).tolist(), "y": y[keep].round(5).tolist(), "band_t": t[band].round(4).tolist(),
        "lo": low.tolist(), "hi": high.tolist(),
    }  # fmt: skip
