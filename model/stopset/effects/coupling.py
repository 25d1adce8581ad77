"""Two joints that rub on each other through a common gear or seal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stopset.effects.base import Effect, Number, Signals, Term


def law(s: Signals, shape: Mapping[str, Number]) -> Sequence[Number]:
    """``c dq_other`` on both rows (reciprocity)."""
    return (s.dq_other,)


EFFECT = Effect(
    name="coupling",
    says="The motion of one joint drags on the other: coupled gears, seals or cables.",
    look_at="dq of the other joint",
    terms=(Term("c", "N m s/rad", "drag per speed of the other joint", -1e4, 1e4),),
    law=law,
    needs=("dq_other",),
    enters="compensation",
    source="khalil2007",
    scope="pair",
    looks_like=("viscous", "coriolis"),
    distinguished_by="Move one joint while the other holds still, then both with different speed ratios.",
    simulated="drag by the neighbour",
)
