"""A spring, gas spring or hydraulic cylinder between two links that carries a part of gravity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stopset.effects.base import Effect, Number, Shape, Signals, Term
from stopset.ring import cos, sin, sqrt, square


def law(s: Signals, shape: Mapping[str, Number]) -> Sequence[Number]:
    """``sin x (k_b + P / l)``, ``x = q - q_0``, ``l = sqrt(1 + r^2 + 2 r cos x)``: its length over the longer lever.

    A spring's stiffness pulls with its length, so that part is a plain sine; a preload or gas pressure pulls alike at any length.
    """
    turn = s.q - shape["q_0"]
    length = sqrt(1.0 + square(shape["r"]) + 2.0 * shape["r"] * cos(turn))
    return (sin(turn), sin(turn) / length)


EFFECT = Effect(
    name="counterbalance",
    says="A balancing spring, gas spring or cylinder carries a part of the arm's weight that the description does not tell of.",
    look_at="q",
    terms=(
        # makers state 20 to 40 % more force at full compression
        Term("k_b", "N m", "stiffness times both levers", -1e4, 1e4, share=0.2),
        Term("P", "N m", "preload or pressure force times the shorter lever", -1e4, 1e4),
    ),
    shapes=(
        Shape(
            "q_0",
            "rad",
            "where the two levers are stretched out",
            0.01,
            6.29,
            (0.2, 0.6, 1.1, 1.6, 2.1, 2.6, 3.1, 3.7, 4.2, 4.7, 5.2, 5.8),
        ),
        Shape("r", "1", "shorter over longer lever", 0.1, 0.8, (0.4,)),
    ),
    law=law,
    needs=("q",),
    enters="compensation",
    source="khalil2007",
    looks_like=("payload", "spring", "cable", "residual_gravity"),
    distinguished_by="Hold poses over the joint's whole range with the arm beyond it folded and stretched: a weight's torque changes with that.",
    simulated="gas spring",
    refines=("spring",),
    loaded=True,
)
