"""Sets that enclose all that was recorded and yet cannot be meant: said in words, and no success unless they are accepted."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from stopset.artifact import UncertaintySets
from stopset.offline.campaign.survey import Survey

MOVES = 5.0  # a joint moves if it is faster than so many times its noise
RANGES = 3.0  # an open-loop prediction that errs by more than so many of the joint's ranges has diverged


def absurd(sets: UncertaintySets, errors: Mapping[str, Mapping[str, Any]], found: Survey) -> list[str]:
    """One sentence for each joint and contradiction; ``errors``: joint -> RMS errors of the model."""
    n, out = len(errors), []
    fastest = np.maximum(np.abs(found.dq.lo), np.abs(found.dq.hi))
    for k, (j, row) in enumerate(errors.items()):
        wrong = max(-float(sets.V.lo[n + k]), float(sets.V.hi[n + k]))
        if sets.conform == "all" and wrong > fastest[k] > MOVES * found.readings.least.hi[n + k]:
            out.append(
                f"absurd: speeds of {j} would be read wrong by up to {wrong:.3g} rad/s, and it was never faster than "
                f"{fastest[k]:.3g} rad/s; look at how dq is made (`stopset inspect`)"
            )
        far, span = row["position_rmse"], float(found.q.width[k])
        if far is not None and far > RANGES * max(span, 1.0):
            out.append(
                f"absurd: open-loop predictions of {j} err by {far:.3g} rad, and it moves over {span:.3g} rad: the model diverges; "
                "check the torque's sign and unit, and the inertia of its drive"
            )
        torque, width = row["torque_rmse"], float(sets.U.width[k])
        if torque is not None and width < 0.5 * torque:
            out.append(
                f"absurd: the torque set of {j} is {width:.3g} N m wide where the model's torque errs by {torque:.3g} N m RMS; "
                "its deviations sit in another set: look at the velocity signal"
            )
    return out
