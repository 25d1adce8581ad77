"""State messages by themselves, as a monitor that packs one only."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stopset.monitor.packer import Packer, Signer


def pack(values: Mapping[str, Any], signer: Signer | None = None) -> bytes:
    """One message, see `Packer`."""
    return Packer(signer).pack(values)


def outward_all(x: NDArray[np.float64], up: NDArray[np.bool_]) -> NDArray[np.float32]:
    """`stopset.monitor.layout.outward` of many numbers at once."""
    sign = np.where(up, 1.0, -1.0)
    with np.errstate(over="ignore", invalid="ignore"):
        y = (sign * x).astype(np.float32)  # bounds from below are bounds from above of the negative
        y = np.where(y < sign * x, np.nextafter(y, np.float32(np.inf)), y)
    return np.asarray(np.where(np.isnan(y), np.inf, y) * sign, np.float32)
