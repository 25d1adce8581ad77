"""Friction that builds up over a short way after each reversal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stopset.effects.base import Effect, Number, Shape, Signals, Term


def law(s: Signals, shape: Mapping[str, Number]) -> Sequence[Number]:
    """``F_h (z - sign(dq))``: after a reversal the friction lags by the state ``z``; steady sliding is not changed.

    Source: Dahl (1968).
    """
    return (s.memory[0] - s.direction,)


def flow(s: Signals, shape: Mapping[str, Number]) -> Sequence[Number]:
    """``dz/dt = (1 - z sign(dq)) dq / delta``, Dahl's curve for exponent 1."""
    (z,) = s.memory
    return ((1.0 - z * s.direction) * s.dq * (1.0 / shape["delta"]),)


EFFECT = Effect(
    name="hysteresis",
    says="After each reversal the friction needs a short way to build up: the gear winds before it slips.",
    look_at="way since the last reversal",
    terms=(Term("F_h", "N m", "part of the Coulomb torque that builds up over the way", 0.0, 1e3),),
    shapes=(Shape("delta", "rad", "way to build up to 1 - 1/e", 5e-5, 0.2, (1e-3, 3e-3, 0.01, 0.03)),),
    states=(Term("z", "1", "built-up share of the friction, with its direction", -1.0, 1.0),),
    law=law,
    flow=flow,
    needs=("dq", "memory"),
    enters="state",
    source="dahl1968",
    looks_like=("stribeck", "delay"),
    distinguished_by=(
        "Reverse many times with different accelerations: hysteresis depends on the way since the reversal, Stribeck on speed."
    ),
    within_friction=True,
    simulated="presliding",
)
