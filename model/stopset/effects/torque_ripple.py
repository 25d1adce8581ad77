"""A torque that repeats with the position of the joint: cogging, or the gear's teeth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stopset.effects.base import Effect, Number, Shape, Signals, Term
from stopset.ring import cos, sin


def law(s: Signals, shape: Mapping[str, Number]) -> Sequence[Number]:
    """``a sin(n q) + b cos(n q)``."""
    phase = s.q * shape["n"]
    return (sin(phase), cos(phase))


EFFECT = Effect(
    name="torque_ripple",
    says="The torque ripples n times per turn of the joint: motor cogging or gear teeth.",
    look_at="q folded by one n-th of a turn",
    terms=(
        Term("a", "N m", "sine amplitude", -1e3, 1e3),
        Term("b", "N m", "cosine amplitude", -1e3, 1e3),
    ),
    shapes=(Shape("n", "1", "cycles per turn of the joint", 10.0, 400.0, (12.0, 50.0, 100.0)),),
    law=law,
    needs=("q",),
    enters="compensation",
    source="bittencourt2012",
    looks_like=("spring", "encoder_eccentricity"),
    distinguished_by=("Move slowly at constant speed through the joint's range: the ripple repeats with position at any speed."),
    periodic=True,
    simulated="cogging",
)
