"""The column of a delay: what a joint's torque record, taken later or earlier, has more of.

The record itself is shifted, not a model of it.  It holds whatever the joint's torque was, friction at rest too, so at the
true lag the rows are just those of a record that was never late.  Its noise is shifted with it: as large as before, but
another one, so the record may only be shifted as a whole (`Candidate.given`).  With a free coefficient half a shift would
fit best wherever noise prevails, because the mean of two noises is smaller than either.
"""

from __future__ import annotations

import numpy as np

from stopset.offline.diagnose.columns.signals import ArmSignals
from stopset.types import Array


def lagged(source: ArmSignals, joint: int, lag: float) -> Array:
    """(N, 1) change of the recorded torque by taking it ``lag`` [s] later, per second of lag: the law's ``-dtau``."""
    d = source.data
    out: Array = -np.asarray(d.torque_at(joint, lag) - d.tau[:, joint])[:, None] / lag
    return out
