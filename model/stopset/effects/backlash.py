"""A gear with play: within a gap no tooth touches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import pi

from stopset.effects.base import Effect, Number, Signals, Term
from stopset.ring import sign

ARCMIN = pi / (180 * 60)


def law(s: Signals, shape: Mapping[str, Number]) -> Sequence[Number]:
    """``-(gap/2) sign(link) dtau/dq``: the link lies half the gap off its motor, on the side to which its own torque pushes it.

    To first order, and but for the time in which it crosses the gap.  Source: Nordin & Gutman (2002), Sec. 2.
    """
    return (-0.5 * sign(s.link) * s.stiff,)


EFFECT = Effect(
    name="backlash",
    says="The gear has play: within it no tooth touches, and the link is free.",
    look_at="link minus motor angle over the link's torque",
    terms=(Term("gap", "rad", "width of the gap", 0.3 * ARCMIN, 10 * ARCMIN, 3 * ARCMIN),),
    law=law,
    needs=("link", "stiff"),
    enters="state",
    role="play",
    source="nordin2002",
    looks_like=("elasticity", "hysteresis", "encoder_eccentricity"),
    distinguished_by=(
        "Record the angle behind the gear (q_link_<joint>) while the link's torque changes its sign: play is a jump, elasticity a slope."
    ),
)
