"""Coulomb friction that grows with the load on the gear teeth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stopset.effects.base import Effect, Number, Signals, Term
from stopset.ring import absolute, sign


def law(s: Signals, shape: Mapping[str, Number]) -> Sequence[Number]:
    """``|load| sign(dq)``, apart for the load driving against and along the motion.

    Source: Liu & Althoff (2018), eqs. (6)-(9).
    """
    magnitude = absolute(s.load) * s.direction
    along = sign(s.load) * s.direction  # 1: the drive lifts the load; -1: the load drives
    return (0.5 * magnitude * (1.0 + along), 0.5 * magnitude * (1.0 - along))


EFFECT = Effect(
    name="load_coulomb",
    says="The friction grows with the gravity load that the gear carries.",
    look_at="abs(load) * direction of dq",
    terms=(
        Term("k_lift", "N m/(N m)", "friction per load while the drive lifts", 0.0, 2.0),
        Term("k_lower", "N m/(N m)", "friction per load while the load drives", 0.0, 2.0),
    ),
    law=law,
    needs=("dq", "load"),
    enters="compensation",
    role="friction",
    source="liu2018",
    looks_like=("coulomb", "torque_gain"),
    distinguished_by=(
        "Move slowly up and down through the whole load range: a gain error does not change sign with the direction."
    ),
    usual=1,
    simulated="tooth friction",
)
