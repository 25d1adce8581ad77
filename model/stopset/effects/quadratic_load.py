"""Friction of a gear that grows with the square of what it carries."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stopset.effects.base import Effect, Number, Signals, Term
from stopset.ring import square


def law(s: Signals, shape: Mapping[str, Number]) -> Sequence[Number]:
    """``k_2 load^2 sign(dq)``: worm and high-ratio gears rub little while they carry little.

    Source: Duclusaud et al. (2025), model M6.
    """
    return (square(s.load) * s.direction,)


EFFECT = Effect(
    name="quadratic_load",
    says="The friction grows with the square of the gravity load that the gear carries.",
    look_at="load^2 * direction of dq",
    terms=(Term("k_2", "1/(N m)", "friction per square of the load", 0.0, 0.1),),
    law=law,
    needs=("dq", "load"),
    enters="compensation",
    role="friction",
    source="duclusaud2025",
    looks_like=("load_coulomb", "coulomb"),
    refines=("load_coulomb",),
    distinguished_by="Move slowly under no, half and full load: the friction rises by a third as much in the first half as in the second.",
    simulated="square tooth friction",
)
