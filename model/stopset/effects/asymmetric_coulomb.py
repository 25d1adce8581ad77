"""Coulomb friction that differs between the two directions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stopset.effects.base import Effect, Number, Signals, Term
from stopset.ring import square


def law(s: Signals, shape: Mapping[str, Number]) -> Sequence[Number]:
    """A torque that pushes the same way in both directions while moving; ``F_c +- F_o``.

    Source: Liu & Althoff (2018), eq. (5).
    """
    return (square(s.direction),)


EFFECT = Effect(
    name="asymmetric_coulomb",
    says="The drive rubs harder in one direction than in the other, or its torque reading is offset.",
    look_at="direction of dq",
    terms=(Term("F_o", "N m", "half the difference between positive and negative Coulomb torque", -1e3, 1e3),),
    law=law,
    needs=("dq",),
    enters="compensation",
    role="friction",
    source="liu2018",
    looks_like=("spring", "coulomb"),
    distinguished_by="Stand still with the brake closed: an offset of the current sensor stays, asymmetric friction is gone.",
    part="constant torque",
    usual=3,
    simulated="skew",
)
