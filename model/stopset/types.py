"""The one type that every number of an arm comes in."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]  # shapes and units stand in the docstring of whoever takes or gives one
