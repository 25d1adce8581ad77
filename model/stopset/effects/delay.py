"""The torque stamps lag (or lead) the motion stamps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stopset.effects.base import Effect, Number, Signals, Term


def law(s: Signals, shape: Mapping[str, Number]) -> Sequence[Number]:
    """``-d dtau/dt``, first order; a simulator shifts the signal itself."""
    return (-s.dtau,)


EFFECT = Effect(
    name="delay",
    says="The recorded torque is late (or early) against the recorded motion.",
    look_at="rate of the modelled torque",
    terms=(Term("d", "s", "lag of the recorded torque; negative: it leads", -0.1, 0.1, 0.02),),
    law=law,
    needs=("dtau",),
    enters="input_delay",
    role="input",
    source="swevers1997",
    looks_like=("elasticity", "rotor_inertia", "drive_lag"),
    distinguished_by="Excite from 1 to 60 Hz: a delay gives a straight phase line, elasticity a dip and a peak.",
    simulated="late torque",
    acting="later",
)
