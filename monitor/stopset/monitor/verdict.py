"""What one sample says of the model."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from stopset.types import Array


class Conformance(StrEnum):
    """What one sample says of the model."""

    CONFORMANT = "CONFORMANT"
    VIOLATION = "VIOLATION"
    UNKNOWN = "UNKNOWN"
    FAULT = "FAULT"


@dataclass(frozen=True, slots=True)
class Deviation:
    """One measurement outside its prediction: ``excess`` beyond the bound [rad or rad/s], also as a part of the tube's width.

    ``age``: of the prediction that is contradicted worst [s]; ``in_domain``: whether the model ever claimed to hold here.
    """

    joint: str
    state: str  # "q" or "dq"
    side: str  # "above" or "below"
    age: float
    excess: float
    fraction: float
    measured: float
    bound: float
    in_domain: bool


@dataclass(frozen=True, slots=True)
class Verdict:
    """What one sample says. ``compared``: predictions it was held against; ``room``: (2n,) distance to the nearest bound
    over the tube's half width (1 centre, 0 on the bound, negative outside); ``outside``: signals beyond the domain; ``gap``:
    cycles were missing before it."""

    conformance: Conformance
    why: str
    compared: int = 0
    oldest: float = 0.0
    deviations: tuple[Deviation, ...] = ()
    outside: tuple[str, ...] = ()
    room: Array | None = None
    gap: bool = False
