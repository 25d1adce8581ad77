"""What the configuration says the flange carries: a mass, a range of masses, or nothing at all.

Not declared and surely empty are two things: who says nothing, or 0, gets bounds over every payload the model knows, who says [0, 0] gets
the bare flange's, many times tighter on a light arm.
"""

from __future__ import annotations

from typing import Any

from stopset.artifact import Model
from stopset.monitor.config import Masses


def assumed(model: Model, declared: Masses | None) -> Masses:
    """The range [kg] that stop bounds hold for: what is declared, else all that the model was identified with."""
    return model.domain.payload if declared is None else declared


def unidentified_payload(model: Model, declared: Masses | None) -> str:
    """Why no verdict is possible with this payload; empty if one is. Who declares nothing may carry nothing."""
    lo, hi = model.domain.payload
    least, most = declared or (0.0, 0.0)
    if lo <= least and most <= hi:
        return ""
    if declared is None:
        return f"payload not declared, and the model holds for {lo} to {hi} kg, not for an empty flange: declare payload_kg"
    return f"payload {kilograms(declared)} is outside the identified [{lo}, {hi}] kg"


def kilograms(declared: Masses) -> str:
    """In words."""
    least, most = declared
    return f"{least} kg" if least == most else f"{least} to {most} kg"


def published(model: Model, declared: Masses | None) -> dict[str, Any]:
    """What the stop bounds assume, [kg] for ``state/json``."""
    least, most = assumed(model, declared)
    return {"least": least, "most": most, "declared": declared is not None}
