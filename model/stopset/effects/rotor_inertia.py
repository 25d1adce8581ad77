"""A rotor (or gear) inertia other than the data sheet says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stopset.effects.base import Effect, Number, Signals, Term


def law(s: Signals, shape: Mapping[str, Number]) -> Sequence[Number]:
    """``dJ ddq`` on the joint's own row alone. Source: Liu & Althoff (2018), eq. (3)."""
    return (s.ddq,)


EFFECT = Effect(
    name="rotor_inertia",
    says="The reflected inertia of the motor differs from the data sheet.",
    look_at="ddq",
    terms=(Term("dJ", "kg m^2", "reflected inertia beyond the data sheet", -1e2, 1e2),),
    law=law,
    needs=("ddq",),
    enters="inertia",
    role="plant",
    source="liu2018",
    looks_like=("payload", "delay", "elasticity"),
    distinguished_by="Accelerate the joint with the arm stretched and folded: a rotor's share does not change with the pose.",
    absorbed=True,
    simulated="heavier rotor",
)
