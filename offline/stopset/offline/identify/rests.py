"""Which bounds of U come from joints that stand: there dry friction holds a joint, wherever it points, and U holds what it holds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stopset.artifact.model import ActiveBound
from stopset.recording.types import Recording

STANDS = 0.02  # [rad/s]
MOSTLY = 0.5  # of a prediction's time


def at_rest(active: Sequence[ActiveBound], sample: Sequence[Recording], joints: Sequence[str]) -> list[str]:
    """A sentence on the bounds of U that are fixed while their joint stands or creeps; ``sample``: trials, of others nothing is said."""
    by = {r.label: r for r in sample}
    sides: dict[str, list[str]] = {}
    for a in active:
        place, _, side = a.bound.partition("].")
        joint, r = place.removeprefix("U["), by.get(a.recording)
        if not a.bound.startswith("U[") or joint not in joints or r is None:
            continue
        window = (r.t - r.t[0] >= a.start_s) & (r.t - r.t[0] <= a.start_s + a.age_s)
        if window.any() and np.mean(np.abs(r.dq[window, joints.index(joint)]) < STANDS) > MOSTLY:
            sides.setdefault(joint, []).append(side)
    if not sides:
        return []
    reported = ", ".join(f"{j} ({' and '.join(x)})" for j, x in sides.items())
    return [
        f"U of {reported} is fixed where the joint stands or creeps: dry friction holds it there whichever way it points, and a model in which it "
        "acts against motion only has that torque in U; identify the recordings without their rests to see what motion asks for"
    ]
