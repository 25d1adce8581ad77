"""The types that every number of an arm comes in."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

# shapes and units stand in the docstring of whoever takes or gives one
Array = NDArray[np.float64]
Index = NDArray[np.integer[Any]]
Mask = NDArray[np.bool_]
