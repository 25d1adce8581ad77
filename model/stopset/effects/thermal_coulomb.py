"""Coulomb friction that changes with temperature."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stopset.effects.base import Effect, Number, Signals, Term


def law(s: Signals, shape: Mapping[str, Number]) -> Sequence[Number]:
    """``k_C T sign(dq)``. Source: Bittencourt & Gunnarsson (2012)."""
    return (s.temp * s.direction,)


EFFECT = Effect(
    name="thermal_coulomb",
    says="The Coulomb friction changes with the temperature of the drive.",
    look_at="temp * direction of dq",
    terms=(Term("k_C", "N m/K", "change of the Coulomb torque per kelvin", -1e2, 0.0),),
    law=law,
    needs=("dq", "temp"),
    enters="compensation",
    role="friction",
    source="bittencourt2012",
    looks_like=("thermal_viscous", "warm_up"),
    distinguished_by=(
        "Repeat several constant speeds cold and warm: the viscous part grows with speed, the Coulomb part does not."
    ),
    simulated="seals softening with heat",
)
