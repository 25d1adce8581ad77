"""A joint zero that is off."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stopset.effects.base import Effect, Number, Signals, Term


def law(s: Signals, shape: Mapping[str, Number]) -> Sequence[Number]:
    """``e dtau/dq``: the model evaluated at the true position, to first order."""
    return (s.stiff,)


def reading(s: Signals, shape: Mapping[str, Number]) -> tuple[Sequence[Number], Sequence[Number]]:
    """``e``, the same at every position."""
    return (1.0,), (0.0,)


EFFECT = Effect(
    name="encoder_offset",
    says="The joint's zero position is off, so gravity is computed for another pose.",
    look_at="derivative of the load by q",
    terms=(Term("e", "rad", "true position minus recorded position", -0.3, 0.3, 0.02),),
    law=law,
    needs=("stiff",),
    enters="compensation",
    role="reading",
    reading=reading,
    source="khalil2007",
    looks_like=("base_tilt", "payload", "spring"),
    distinguished_by="Measure the pose from outside (dial gauge, laser): torques alone take it for a shifted centre of mass.",
    absorbed=True,
    simulated="shifted encoder",
)
