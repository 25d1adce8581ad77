"""A drive that follows the torque it is told to give as a lag of first order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stopset.effects.base import Effect, Number, Signals, Term


def law(s: Signals, shape: Mapping[str, Number]) -> Sequence[Number]:
    """``T dtau/dt``: what the drive is told is ahead of the torque that acts, ``told = tau + T dtau/dt``.

    Source: Spong, Hutchinson & Vidyasagar (2006), Sec. 6.1 (the time constant of a motor's current).
    """
    return (s.dtau,)


EFFECT = Effect(
    name="drive_lag",
    says="The drive follows its torque command slowly: what acts is the recorded torque through 1 / (T s + 1).",
    look_at="rate of the modelled torque",
    terms=(Term("T", "s", "time constant of the drive", 0.001, 0.025, 0.01),),
    law=law,
    needs=("dtau",),
    enters="input_delay",
    role="input",
    source="spong2006",
    looks_like=("delay", "elasticity", "rotor_inertia"),
    distinguished_by=(
        "Excite from 1 to 60 Hz, recorded at 500 Hz or more: a lag lets fast torque through smaller and its phase levels off, a delay changes "
        "no size and its phase falls on."
    ),
    refines=("delay",),
    simulated="slow drive",
    acting="through a lag",
)
