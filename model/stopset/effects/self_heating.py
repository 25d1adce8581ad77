"""Friction that falls while the drive is at work, because its own losses warm it, where no temperature is recorded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stopset.effects.base import Effect, Number, Shape, Signals, Term
from stopset.ring import absolute


def law(s: Signals, shape: Mapping[str, Number]) -> Sequence[Number]:
    """``w (k_v dq + k_c sign(dq))``: friction changes with the drive's warmth, for both friction parts.

    Source: Bittencourt & Gunnarsson (2012) for friction over temperature; the warmth is a first-order thermal model.
    """
    (w,) = s.memory
    return (w * s.dq, w * s.direction)


def flow(s: Signals, shape: Mapping[str, Number]) -> Sequence[Number]:
    """``tau_w dw/dt = |dq| - w``: sliding brings heat in, the surroundings take it out.

    ``w`` is counted in the sliding speed that would keep it up for ever, so no heat capacity and no kelvin are needed.
    """
    (w,) = s.memory
    return ((absolute(s.dq) - w) * (1.0 / shape["tau_w"]),)


EFFECT = Effect(
    name="self_heating",
    says="The friction falls while the drive works and comes back while it rests: its own losses warm it.",
    look_at="mean speed of the last seconds * direction of dq",
    terms=(
        Term("k_v", "N m s^2/rad^2", "change of the viscous coefficient per rad/s of warmth", -1e4, 0.0),
        Term("k_c", "N m s/rad", "change of the Coulomb torque per rad/s of warmth", -1e4, 0.0),
    ),
    shapes=(Shape("tau_w", "s", "time to warm up or cool down to 1 - 1/e", 0.5, 3600.0, (2.0, 8.0, 30.0, 120.0)),),
    # a recording begins with a drive that has rested: what it brings along from before is in no channel
    states=(Term("w", "rad/s", "warmth, as the sliding speed that would keep it up", 0.0, 50.0, 0.0),),
    law=law,
    flow=flow,
    needs=("dq", "memory"),
    enters="state",
    role="friction",
    source="bittencourt2012",
    looks_like=("warm_up", "cubic_viscous", "thermal_coulomb"),
    distinguished_by=(
        "Move back and forth at one speed for some minutes, rest as long, and repeat: self-heating falls and comes back each time, "
        "a warm-up of the session does not come back, and a cubic term shows no change at one speed. Record the temperature too."
    ),
    instead_of="temp",
    simulated="film heated by losses",
)
