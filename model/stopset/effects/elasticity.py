"""A flexible gear between the motor encoder and the link."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stopset.effects.base import Effect, Number, Shape, Signals, Term


def law(s: Signals, shape: Mapping[str, Number]) -> Sequence[Number]:
    """The link swings behind the motor by the states ``x`` [rad] and ``dx`` [rad/s]: ``-K x - D dx`` replaces the
    link torque.

    Source: Spong (1987).
    """
    x, dx = s.memory
    return (-(shape["K"] * x) - shape["D"] * dx - s.link,)


def flow(s: Signals, shape: Mapping[str, Number]) -> Sequence[Number]:
    """``M_jj ddx + D dx + (K + dg/dq) x = -link``."""
    x, dx = s.memory
    ddx = (-s.link - shape["D"] * dx - (shape["K"] + s.stiff) * x) / s.inertia
    return (dx, ddx)


EFFECT = Effect(
    name="elasticity",
    says="The gear between motor and link is flexible: the link swings behind the motor.",
    look_at="acceleration of the link torque",
    terms=(Term("share", "1", "1 if the link swings as the stiffness says", 0.4, 2.5, 1.0),),
    shapes=(
        Shape("K", "N m/rad", "stiffness", 20.0, 1e6, (1e2, 2e2, 4e2, 8e2, 1.6e3, 3.2e3, 6.4e3, 1.3e4, 2.6e4)),
        Shape("D", "N m s/rad", "damping", 1e-3, 1e3, (2.0,)),
    ),
    states=(
        Term("x", "rad", "link position minus motor position", -0.5, 0.5),
        Term("dx", "rad/s", "its rate", -50.0, 50.0),
    ),
    law=law,
    flow=flow,
    needs=("link", "inertia", "stiff", "memory"),
    enters="state",
    role="swing",
    source="spong1987",
    looks_like=("delay", "rotor_inertia"),
    distinguished_by="Excite from 1 to 60 Hz: elasticity gives a dip and a peak, a delay a straight phase line.",
    simulated="soft gear",
)
