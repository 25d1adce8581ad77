"""What kinds of violations there are, and what is said of one: codes in the message, words for people."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any


class Kind(StrEnum):
    """Class of a violation, by the evidence. The order is that of the codes in the state message and only grows."""

    NONE = "none"
    UNCLASSED = "unclassed"
    SPIKE = "spike"
    FROZEN = "frozen"
    STALE = "stale"
    LATE_TORQUE = "late_torque"
    CONTACT = "contact"
    DRIFT = "drift"
    MISSING_EFFECT = "missing_effect"
    ENCODER_JUMP = "encoder_jump"

    @property
    def code(self) -> int:
        return _CODES[self]


_CODES = {kind: code for code, kind in enumerate(Kind)}


@dataclass(frozen=True, slots=True)
class Cause:
    """Why the readings left the model, as far as they tell. ``joint``: where it shows ("": everywhere), for a contact the last
    joint of the chain that feels it; ``signal``: q, dq or tau; ``size`` in ``unit``; ``t``: stamp of the onset [s]; ``torque``:
    (n,) push on every joint [N m] of a contact; ``depends_on``: what a missing effect goes with; ``says``: a plain sentence."""

    kind: Kind
    says: str
    joint: str = ""
    signal: str = ""
    size: float = 0.0
    unit: str = ""
    t: float = 0.0
    torque: tuple[float, ...] = ()
    depends_on: str = ""

    def plain(self) -> dict[str, Any]:
        """For people and JSON."""
        out = {**asdict(self), "kind": self.kind.value, "torque_Nm": list(self.torque)}
        del out["torque"]
        return out


UNCLASSED = Cause(Kind.UNCLASSED, "too few readings around it to tell what it is")
