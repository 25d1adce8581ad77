"""The speed-dependent part of the rigid body is missing (or scaled) in the controller's model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stopset.effects.base import Effect, Number, Signals, Term


def law(s: Signals, shape: Mapping[str, Number]) -> Sequence[Number]:
    """``x c(q, dq)``. Source: Liu & Althoff (2018), eq. (3)."""
    return (s.coriolis,)


EFFECT = Effect(
    name="coriolis",
    says="The Coriolis and centrifugal torque of the model does not match: it is missing or scaled.",
    look_at="products of joint speeds",
    terms=(Term("x", "1", "share of the Coriolis torque beyond the model", -1.5, 1.5, 0.5),),
    law=law,
    needs=("coriolis",),
    enters="compensation",
    role="arm or drive",
    source="liu2018",
    scope="arm",
    looks_like=("cubic_viscous", "coupling"),
    distinguished_by="Move several joints fast at the same time, then each alone.",
    simulated="unlogged feed-forward",
)
