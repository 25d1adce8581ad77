"""Extra friction at creeping speed, before the oil film carries."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stopset.effects.base import Effect, Number, Shape, Signals, Term
from stopset.ring import exp, square


def law(s: Signals, shape: Mapping[str, Number]) -> Sequence[Number]:
    """``F_s exp(-(dq/v_s)^2) sign(dq)``. Source: Armstrong-Helouvry, Dupont & Canudas de Wit (1994)."""
    return (exp(-square(s.dq * (1.0 / shape["v_s"]))) * s.direction,)


EFFECT = Effect(
    name="stribeck",
    says="The friction is higher at creeping speed than a little faster: the oil film has not built up yet.",
    look_at="dq near zero",
    terms=(Term("F_s", "N m", "friction at standstill above the Coulomb level", 0.0, 1e3),),
    shapes=(
        Shape(
            "v_s",
            "rad/s",
            "speed at which the extra friction has fallen to 1/e",
            5e-3,
            0.6,
            (0.03, 0.06, 0.1, 0.17, 0.3),
        ),
    ),
    law=law,
    needs=("dq",),
    enters="compensation",
    role="friction",
    source="armstrong1994",
    looks_like=("hysteresis", "coulomb", "cubic_viscous"),
    distinguished_by=(
        "Pass slowly at several constant speeds: Stribeck depends on speed, hysteresis on the way since the reversal."
    ),
    simulated="breakaway",
)
