"""A load at the flange (or a missing one) that the robot description does not know."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stopset.effects.base import Effect, Number, Signals, Term


def law(s: Signals, shape: Mapping[str, Number]) -> Sequence[Number]:
    """The last link's ten standard parameters, all free: the columns are the rigid-body regressor of that link."""
    return s.tip


EFFECT = Effect(
    name="payload",
    says="The arm carries a mass at its flange that the robot description does not contain.",
    look_at="gravity load of all joints",
    terms=(
        Term("m", "kg", "mass", -100.0, 100.0, 1.0),
        Term("mx", "kg m", "first moment along x of the last link frame", -50.0, 50.0, 0.1),
        Term("my", "kg m", "first moment along y", -50.0, 50.0, 0.1),
        Term("mz", "kg m", "first moment along z", -50.0, 50.0, 0.1),
        Term("Ixx", "kg m^2", "inertia about the link frame's origin", -20.0, 20.0, 0.01),
        Term("Ixy", "kg m^2", "product of inertia", -20.0, 20.0, 0.01),
        Term("Iyy", "kg m^2", "inertia", -20.0, 20.0, 0.01),
        Term("Ixz", "kg m^2", "product of inertia", -20.0, 20.0, 0.01),
        Term("Iyz", "kg m^2", "product of inertia", -20.0, 20.0, 0.01),
        Term("Izz", "kg m^2", "inertia", -20.0, 20.0, 0.01),
    ),
    law=law,
    needs=("tip",),
    enters="inertia",
    role="plant",
    carried=True,
    essential=True,
    source="khalil2007",
    scope="arm",
    looks_like=("torque_gain", "base_tilt"),
    distinguished_by=(
        "Weigh the tool, or hold the arm in poses with the wrist turned: a payload moves all joints' loads together."
    ),
    part="load",
    absorbed=True,
    simulated="body on the last link",
)
