"""Friction that changes along the session, where no temperature is recorded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stopset.effects.base import Effect, Number, Signals, Term


def law(s: Signals, shape: Mapping[str, Number]) -> Sequence[Number]:
    """Friction scale linear in the place of the trial in the session, for both friction parts."""
    return (s.warm * s.dq, s.warm * s.direction)


EFFECT = Effect(
    name="warm_up",
    says="The friction changes along the session as the drive warms up; no temperature channel explains it.",
    look_at="place in the session * dq",
    terms=(
        Term("k_v", "N m s/rad", "change of the viscous coefficient from the first to the last trial", -1e4, 1e4),
        Term("k_c", "N m", "change of the Coulomb torque from the first to the last trial", -1e3, 1e3),
    ),
    law=law,
    needs=("dq", "warm"),
    enters="compensation",
    role="friction",
    source="bittencourt2012",
    looks_like=("thermal_viscous", "thermal_coulomb", "self_heating"),
    distinguished_by="Record the drive temperature, or repeat the first motion at the end and again after a cold night.",
    instead_of="temp",
    simulated="running in",
)
