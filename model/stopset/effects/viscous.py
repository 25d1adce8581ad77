"""Viscous friction: a torque proportional to the speed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stopset.effects.base import Effect, Number, Signals, Term


def law(s: Signals, shape: Mapping[str, Number]) -> Sequence[Number]:
    """``F_v dq``. Source: Liu & Althoff (2018), eq. (5)."""
    return (s.dq,)


EFFECT = Effect(
    name="viscous",
    says="The drive's friction grows in proportion to its speed.",
    look_at="dq",
    terms=(Term("F_v", "N m s/rad", "viscous friction coefficient", 0.0, 1e5),),
    law=law,
    needs=("dq",),
    enters="damping",
    role="friction",
    power=1,
    source="liu2018",
    looks_like=("cubic_viscous", "thermal_viscous"),
    distinguished_by="Move at five constant speeds from slow to full speed: the friction lies on a straight line.",
    base=True,
    part="damping",
    simulated="more drag",
)
