"""The base stands crooked: gravity comes from another direction than the description says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stopset.effects.base import Effect, Number, Signals, Term


def law(s: Signals, shape: Mapping[str, Number]) -> Sequence[Number]:
    """Derivatives of the joint torques by the two angles of the gravity direction."""
    return s.tilt


EFFECT = Effect(
    name="base_tilt",
    says="The base is tilted against the robot description, so gravity acts from another direction.",
    look_at="gravity load, joint 1 over q of joint 1",
    terms=(
        Term("roll", "rad", "tilt about the base's x axis", -0.6, 0.6, 0.02),
        Term("pitch", "rad", "tilt about the base's y axis", -0.6, 0.6, 0.02),
    ),
    law=law,
    needs=("tilt",),
    enters="compensation",
    source="khalil2007",
    scope="arm",
    looks_like=("spring", "payload"),
    distinguished_by="Put a spirit level on the base; turn joint 1 with the arm stretched: a tilt loads it like a sine.",
    absorbed=True,
    simulated="tilted base",
)
