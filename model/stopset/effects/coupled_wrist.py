"""Two wrist joints of which one motor sees both: a drive that runs through the other joint turns with the sum of their speeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stopset.effects.base import Effect, Number, Signals, Term
from stopset.ring import sign


def law(s: Signals, shape: Mapping[str, Number]) -> Sequence[Number]:
    """``J ddq_other + c dq_other + F sign(dq + dq_other)``, the same on both rows; each joint's own part is its own rotor and friction.

    A motor of inertia ``J_m``, frictions ``c_m`` and ``F_m`` that turns with ``w = dq + s dq_other`` has the torque ``T = J_m dw/dt + c_m w +
    F_m sign(w)``, ``T`` on the one joint and ``s T`` on the other one: ``J = s J_m`` and ``c = s c_m`` have the sign of one ratio, and a friction
    against the *sum* of the speeds is that of ``s = 1``.  So none of the three can be negative; `opposed_wrist` has ``s = -1``.

    Source: Gautier, Janot & Vandanjon (2013), coupling of joints 5 and 6.
    """
    return (s.ddq_other, s.dq_other, sign(s.dq + s.dq_other))


EFFECT = Effect(
    name="coupled_wrist",
    says="One motor turns with the sum of the two joints' speeds: its inertia and its friction act on both.",
    look_at="sum of both joints' dq",
    terms=(
        Term("J", "kg m^2", "inertia of the motor that sees both, reflected", 0.0, 5.0),
        Term("c", "N m s/rad", "viscous friction of that motor per speed of the other joint", 0.0, 1e4),
        Term("F", "N m", "Coulomb friction of that motor, against the sum of the speeds", 0.0, 1e3),
    ),
    law=law,
    needs=("dq", "dq_other", "ddq_other"),
    enters="compensation",
    source="gautier2013",
    scope="pair",
    looks_like=("coupling", "coriolis"),
    distinguished_by="Move both joints with different ratios of their speeds: with opposite speeds of one size the common motor stands still.",
    usual=1,
    adjacent=True,
)
