"""The column of a delay at any lag, exact and odd where the position's noise would decide."""

from __future__ import annotations

import numpy as np

from stopset.offline.diagnose.prepare import Array
from stopset.offline.diagnose.smooth import calm, shifted
from stopset.offline.diagnose.source import Source


def lagged(source: Source, joint: int, lag: float, exact: bool) -> Array:
    """(N, 1) change of the modelled torque by a lag [s], per second of lag: the law's ``-dtau``, exact at that lag.

    Its odd part (late minus early) is orthogonal to the position's noise, which stands in torque and column alike; its even
    part is not, so that is taken from the calmed torque unless ``exact``.
    """
    d, s = source.data, source.rigid(joint)
    smooth = s.tau - source.friction[joint, 0] * s.way
    quiet = smooth if exact else calm(smooth, source.first)
    way = d.way_fine[:, joint]
    late_way, change = np.empty_like(way), np.empty_like(smooth)
    shift = round(lag / d.kernel.dt)
    for trial in d.trials:
        rows, fine = trial.rows, trial.fine
        late, early = (shifted(smooth[rows], k * lag / (d.step * d.kernel.dt)) for k in (1, -1))
        calm_late, calm_early = (shifted(quiet[rows], k * lag / (d.step * d.kernel.dt)) for k in (1, -1))
        change[rows] = 0.5 * (late - early) + 0.5 * (calm_late + calm_early) - quiet[rows]
        samples = np.arange(fine.stop - fine.start) - shift
        late_way[fine] = way[fine][np.clip(samples, 0, fine.stop - fine.start - 1)]
    jump = source.friction[joint, 0] * d.thin(late_way - way)
    out: Array = ((change + jump) / lag)[:, None]
    return out
