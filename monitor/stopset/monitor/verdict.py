"""What one sample says of the model."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import msgspec

from stopset.types import Array


class Conformance(StrEnum):
    """What one sample says of the model."""

    CONFORMANT = "CONFORMANT"
    VIOLATION = "VIOLATION"
    UNKNOWN = "UNKNOWN"
    FAULT = "FAULT"


# Python 3.11 calls a function for every look into an enumeration, some of them in every cycle
CONFORMANT, VIOLATION, UNKNOWN, FAULT = Conformance


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


class Verdict(msgspec.Struct, frozen=True):  # as `Sample`
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

    @classmethod
    def of_comparison(
        cls, deviations: tuple[Deviation, ...], outside: tuple[str, ...], compared: int, oldest: float, room: Array
    ) -> Verdict:
        """What a sample that was held against predictions has come to: one contradiction is a violation, inside the domain or not."""
        result, why = CONFORMANT, "inside every prediction"
        if deviations:
            worst = max(deviations, key=lambda d: d.fraction)
            result = VIOLATION
            why = f"{worst.joint}: {worst.state} {worst.side} its prediction of {worst.age:.3f} s ago"
        elif outside:
            result, why = UNKNOWN, beyond_domain(outside)
        return cls(result, why, compared, oldest, deviations, outside, room)


def beyond_domain(outside: tuple[str, ...]) -> str:
    """Why nothing is known of a sample whose signals ``outside`` the model was not identified for."""
    return f"outside the identified domain: {', '.join(outside)}"
