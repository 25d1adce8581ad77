"""Viscous friction that bends: the lubricant shears thinner, or churns, at high speed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stopset.effects.base import Effect, Number, Signals, Term


def law(s: Signals, shape: Mapping[str, Number]) -> Sequence[Number]:
    """``v_3 dq^3``, beside the linear part. Source: Liu & Althoff (2018), eq. (5)."""
    return (s.dq**3,)


EFFECT = Effect(
    name="cubic_viscous",
    says="The viscous friction is not proportional to speed: at high speed it bends away from the straight line.",
    look_at="dq",
    terms=(Term("v_3", "N m s^3/rad^3", "cubic coefficient of friction over speed", -1e4, 1e4),),
    law=law,
    needs=("dq",),
    enters="compensation",
    role="friction",
    power=3,
    source="liu2018",
    looks_like=("stribeck", "viscous", "thermal_viscous"),
    distinguished_by=(
        "Move at constant speeds over two decades up to full speed: a cubic bends at the fast end, Stribeck at the slow end."
    ),
    usual=2,
    simulated="thinning with speed",
)
