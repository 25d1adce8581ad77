"""Viscous friction that falls as the gear oil warms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stopset.effects.base import Effect, Number, Shape, Signals, Term
from stopset.ring import exp


def law(s: Signals, shape: Mapping[str, Number]) -> Sequence[Number]:
    """``k_T dq (1 - exp(-b T)) / b``: slope ``k_T`` at the reference temperature, levelling off when warm (oil
    viscosity)."""
    return (s.dq * (1.0 - exp(-(s.temp * shape["b"]))) * (1.0 / shape["b"]),)


EFFECT = Effect(
    name="thermal_viscous",
    says="The viscous friction changes with the temperature of the drive.",
    look_at="temp * dq",
    terms=(Term("k_T", "N m s/rad/K", "change of the viscous coefficient per kelvin at the reference temperature", -1e3, 0.0),),
    shapes=(Shape("b", "1/K", "rate at which the viscosity levels off", 1e-4, 0.15, (1e-3, 0.025, 0.05)),),
    law=law,
    needs=("dq", "temp"),
    enters="compensation",
    role="friction",
    source="bittencourt2012",
    looks_like=("thermal_coulomb", "cubic_viscous", "warm_up"),
    distinguished_by=(
        "Repeat several constant speeds cold and warm: the viscous part grows with speed, the Coulomb part does not."
    ),
    simulated="oil thinning with heat",
)
