"""A code disc off its centre: the position reading errs once per turn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stopset.effects.base import Effect, Number, Signals, Term
from stopset.ring import cos, sin


def law(s: Signals, shape: Mapping[str, Number]) -> Sequence[Number]:
    """Position error ``a sin q + b cos q`` seen through gravity and inertia of the joint."""
    sq, cq = sin(s.q), cos(s.q)
    return (
        s.stiff * sq + s.inertia * (cq * s.ddq - sq * s.dq**2),
        s.stiff * cq - s.inertia * (sq * s.ddq + cq * s.dq**2),
    )


def reading(s: Signals, shape: Mapping[str, Number]) -> tuple[Sequence[Number], Sequence[Number]]:
    """``a sin q + b cos q``, and its slope."""
    sq, cq = sin(s.q), cos(s.q)
    return (sq, cq), (cq, -sq)


EFFECT = Effect(
    name="encoder_eccentricity",
    says="The position reading errs once per turn: the code disc is off its centre.",
    look_at="q",
    terms=(
        Term("a", "rad", "sine part of the position error", -0.02, 0.02, 0.005),
        Term("b", "rad", "cosine part of the position error", -0.02, 0.02, 0.005),
    ),
    law=law,
    needs=("q", "dq", "ddq", "stiff", "inertia"),
    enters="compensation",
    role="reading",
    reading=reading,
    source="khalil2007",
    looks_like=("encoder_offset", "torque_ripple", "spring"),
    distinguished_by="Compare with an outside position measurement over a full turn; torques alone rarely show it.",
    simulated="eccentric encoder",
)
