"""Rounding outward to float32, one number at a time, in plain Python: what the packer's core is held against."""

from __future__ import annotations

import math
import struct

from stopset.monitor.layout import LARGEST_F32


def outward(x: float, rounds: str) -> float:
    """``x`` as a float32 number that is not below (``up``) or not above (``down``) it; not a number becomes +Inf or -Inf."""
    sign = 1.0 if rounds == "up" else -1.0
    x *= sign  # a bound from below is one from above of the negative
    if x != x:
        return sign * math.inf
    try:
        y: float = struct.unpack("<f", struct.pack("<f", x))[0]
    except OverflowError:  # beyond float32
        return sign * (math.inf if x > 0 else -LARGEST_F32)
    if y < x:
        bits: int = struct.unpack("<I", struct.pack("<f", y))[0]
        y = struct.unpack("<f", struct.pack("<I", 1 if y == 0.0 else bits + 1 if y > 0 else bits - 1))[0]
    return sign * y
