"""One reading of an arm, and what the bus itself adds to its error."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np

from stopset.types import Array


class Sample(msgspec.Struct, frozen=True):  # one is made in every cycle: a frozen dataclass takes fifteen times as long
    """One reading of the arm: ``q, dq`` (n,) [rad, rad/s], ``tau`` (n,) [N m] or None, ``temp`` (n,) [degC] or None.

    ``k``: cycle number; two samples belong together when their numbers differ by one, anything else is a gap.
    ``t``: sampling instant [s], ``off``: how far behind the place of its cycle that stamp lies [s],
    ``place_error``: how far off that place may be; ``powered``: the drives
    hold torque (else no verdict: another regime); ``fault``: what drives or their messages say against it, empty if nothing,
    and ``bad_nodes``: bit i set = joint i's.
    """

    k: int
    t: float
    q: Array
    dq: Array
    tau: Array | None = None
    temp: Array | None = None
    powered: bool = True
    fault: str = ""
    bad_nodes: int = 0
    off: float = 0.0
    place_error: float = 0.0


@dataclass(frozen=True, slots=True)
class Quantum:
    """Greatest error the bus itself adds to ``q, dq, tau`` (n,): half a count [rad, rad/s, N m]; zero where it adds none."""

    q: Array
    dq: Array
    tau: Array

    @classmethod
    def none(cls, n: int) -> Quantum:
        return cls(np.zeros(n), np.zeros(n), np.zeros(n))
