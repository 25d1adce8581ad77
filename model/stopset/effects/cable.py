"""A cable or hose pack that pulls the harder the nearer the joint is to the end of the pack's reach."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stopset.effects.base import Effect, Number, Signals, Term
from stopset.ring import square


def law(s: Signals, shape: Mapping[str, Number]) -> Sequence[Number]:
    """``k q + k_2 q^2 + k_3 q^3 + c``: a spring that stiffens towards both ends, about any centre."""
    return (s.q, square(s.q), s.q**3, s.q * 0.0 + 1.0)  # the constant has the shape of q


EFFECT = Effect(
    name="cable",
    says="A cable or hose pack pulls the joint, much harder near the end of its reach than in the middle.",
    look_at="q",
    terms=(
        Term("k", "N m/rad", "stiffness at q = 0", -1e4, 1e4),
        Term("k_2", "N m/rad^2", "how the stiffness differs between the two sides", -1e4, 1e4),
        Term("k_3", "N m/rad^3", "how the stiffness grows towards both ends", 0.0, 1e4),
        Term("c", "N m", "torque at q = 0", -1e4, 1e4),
    ),
    law=law,
    needs=("q",),
    enters="compensation",
    source="khalil2007",
    looks_like=("spring", "payload", "encoder_offset"),
    distinguished_by="Move slowly through the joint's whole range, then with the pack undone: a spring is a straight line over q.",
    simulated="cable at its end",
    refines=("spring",),
)
