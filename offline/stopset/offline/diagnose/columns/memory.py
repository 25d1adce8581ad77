"""States of laws with memory along the prepared samples.

What a drive did before a trial is in no channel: stamps begin anew with each recording, and between two of them the arm goes
back to its start or works on.  So each trial begins at the effect's own start.  What a memory brought along from before fades
(hysteresis over a few ways, warmth over its time constant); as long as it lasts it is a share of friction that differs from
trial to trial, which the friction scales of the trials take up.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from stopset.effects import Effect, Signals
from stopset.effects.memory import along
from stopset.types import Array, Mask


def memory(effect: Effect, s: Signals, shapes: Mapping[str, float], start: Mask, dt: float) -> tuple[Array, ...]:
    """The effect's states along the samples; ``start`` (M,): the first of each trial, ``dt`` [s] between samples."""
    return along(effect, s, shapes, start, np.full(len(start), dt))
