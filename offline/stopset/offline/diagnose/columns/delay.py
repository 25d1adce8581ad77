"""The column of a delay: what a joint's torque record, taken later or earlier or through a drive's lag, has more of.

The record itself is shifted, not a model of it.  It holds whatever the joint's torque was, friction at rest too, so at the
true lag the rows are just those of a record that was never late.  Its noise is shifted with it: as large as before, but
another one, so the record may only be shifted as a whole (`Candidate.given`).  With a free coefficient half a shift would
fit best wherever noise prevails, because the mean of two noises is smaller than either.
"""

from __future__ import annotations

import numpy as np

from stopset.effects import Effect
from stopset.offline.diagnose.columns.signals import ArmSignals
from stopset.types import Array


def lagged(source: ArmSignals, effect: Effect, joint: int, lag: float) -> Array:
    """(N, 1) change of the recorded torque by taking what acted for it, per second of ``lag``: the law's ``-dtau`` or ``dtau``."""
    d = source.data
    acted = d.torque_through(joint, lag) if effect.acting == "through a lag" else d.torque_at(joint, lag)
    out: Array = -np.asarray(acted - d.tau[:, joint])[:, None] / lag
    return out
