"""A torque constant (or sensor gain) other than stated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stopset.effects.base import Effect, Number, Signals, Term


def law(s: Signals, shape: Mapping[str, Number]) -> Sequence[Number]:
    """``e tau``: the recorded torque is ``1 + e`` times the true one."""
    return (s.tau,)


EFFECT = Effect(
    name="torque_gain",
    says="The joint's torque reading is scaled: the torque constant or the sensor gain is off.",
    look_at="modelled torque",
    terms=(Term("e", "1", "relative error of the recorded torque", -0.7, 1.5, 0.1),),
    law=law,
    needs=("tau",),
    enters="input_gain",
    role="input",
    source="gautier2014",
    looks_like=("payload", "load_coulomb", "rotor_inertia"),
    distinguished_by="Hang a weighed mass at the flange: the true torque is then known.",
    part="torque scale",
    absorbed=True,
    loaded=True,  # of an axis that gravity does not load a scale is an inertia and friction of another size
    simulated="drive gain",
)
