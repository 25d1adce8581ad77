"""Two wrist joints that share a motor whose axis is turned round: it turns with the difference of their speeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stopset.effects.base import Effect, Number, Signals, Term
from stopset.ring import sign


def law(s: Signals, shape: Mapping[str, Number]) -> Sequence[Number]:
    """``-J ddq_other - c dq_other + F sign(dq - dq_other)``, the same on both rows: `coupled_wrist` with one joint's axis turned round.

    Which way a description counts a joint's angle is a convention, so a shared motor is as often of this form as of the other one.

    Source: Gautier, Janot & Vandanjon (2013), coupling of joints 5 and 6.
    """
    return (-s.ddq_other, -s.dq_other, sign(s.dq - s.dq_other))


EFFECT = Effect(
    name="opposed_wrist",
    says="One motor turns with the difference of the two joints' speeds: its inertia and its friction act on both.",
    look_at="difference of both joints' dq",
    terms=(
        Term("J", "kg m^2", "inertia of the motor that sees both, reflected", 0.0, 5.0),
        Term("c", "N m s/rad", "viscous friction of that motor per speed of the other joint", 0.0, 1e4),
        Term("F", "N m", "Coulomb friction of that motor, against the difference of the speeds", 0.0, 1e3),
    ),
    law=law,
    needs=("dq", "dq_other", "ddq_other"),
    enters="compensation",
    source="gautier2013",
    scope="pair",
    looks_like=("coupling", "coriolis"),
    distinguished_by="Move both joints with different ratios of their speeds: with equal speeds the common motor stands still.",
    usual=2,
    adjacent=True,
)
