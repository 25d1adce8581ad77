"""Gravity that was not taken off: the compensation used a wrong load, mass or centre of mass."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stopset.effects.base import Effect, Number, Signals, Term


def law(s: Signals, shape: Mapping[str, Number]) -> Sequence[Number]:
    """``k_g g(q)``: a share of the modelled gravity torque. Source: Liu & Althoff (2018), eq. (11)."""
    return (s.load,)


EFFECT = Effect(
    name="residual_gravity",
    says="A share of gravity is left in the compensated torque: the load or mass that was taken off is not the real one.",
    look_at="gravity torque",
    terms=(Term("k_g", "1", "share of the modelled gravity torque that is still there", -1.0, 1.0),),
    law=law,
    needs=("load",),
    enters="compensation",
    role="arm or drive",
    source="liu2018",
    looks_like=("payload", "torque_gain", "spring"),
    distinguished_by="Hold still poses over the joint's whole range: gravity shows at rest, friction and inertia do not.",
    effort="compensated_torque",
    simulated="gravity left",
)
