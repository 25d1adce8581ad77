"""A dress pack, hose or balancing spring that pulls with the joint's position."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stopset.effects.base import Effect, Number, Signals, Term


def law(s: Signals, shape: Mapping[str, Number]) -> Sequence[Number]:
    """``k q + c``: pulls to the position ``-c/k``."""
    return (s.q, s.q * 0.0 + 1.0)  # the constant has the shape of q


EFFECT = Effect(
    name="spring",
    says="A hose, cable pack or spring pulls the joint towards one position.",
    look_at="q",
    terms=(
        Term("k", "N m/rad", "stiffness", 0.0, 1e4),
        Term("c", "N m", "torque at q = 0; the spring rests at -c/k", -1e4, 1e4),
    ),
    law=law,
    needs=("q",),
    enters="compensation",
    source="khalil2007",
    looks_like=("asymmetric_coulomb", "payload", "base_tilt", "encoder_offset"),
    distinguished_by="Move slowly through the joint's range in a pose where gravity does not load it.",
    simulated="dress pack",
    essential=True,
)
