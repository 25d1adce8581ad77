"""Coulomb friction: a torque against the motion that does not care how fast."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stopset.effects.base import Effect, Number, Signals, Term


def law(s: Signals, shape: Mapping[str, Number]) -> Sequence[Number]:
    """``F_c sign(dq)``. Source: Liu & Althoff (2018), eq. (5)."""
    return (s.direction,)


EFFECT = Effect(
    name="coulomb",
    says="The drive rubs with a constant torque against its direction of motion.",
    look_at="direction of dq",
    terms=(Term("F_c", "N m", "Coulomb friction torque", 0.0, 1e4),),
    law=law,
    needs=("dq",),
    enters="compensation",
    role="friction",
    source="liu2018",
    looks_like=("load_coulomb", "stribeck"),
    distinguished_by="Move slowly back and forth at constant speed: Coulomb friction jumps at the reversal and stays.",
    base=True,
    part="dry friction",
    simulated="more dry friction",
)
