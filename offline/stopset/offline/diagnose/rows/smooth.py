"""Row signals smoothed in time."""

from __future__ import annotations

import numpy as np

from stopset.core.library import flags, given, lib, view
from stopset.types import Array, Mask


def calm(x: Array, first: Mask) -> Array:
    """A row signal smoothed over about +-3 rows within its trial; ``first``: the first row of each.

    The link torque holds the position's noise in its second derivative, and the swing differentiates it twice more: without
    this, noise common to the column and the torque would pass for elasticity.
    """
    out = np.empty(len(first))
    lib.stopset_calm(len(out), view(given(x)), flags(first), view(out))
    return out
