"""What to measure next: one plain sentence, made from what this diagnosis left open."""

from __future__ import annotations

from collections.abc import Sequence

from stopset.effects import get
from stopset.offline.diagnose.explain.identifiable import Blind
from stopset.offline.diagnose.explain.leftover import Pattern


def to_decide(rivals: Sequence[Sequence[str]]) -> str | None:
    """The experiment that tells a claim from its rivals; ``rivals``: groups of ``effect:joint``, the claim first."""
    for first, *others in rivals:
        name = first.partition(":")[0]
        experiment = get(name).distinguished_by
        if others and all(o.partition(":")[0] == name for o in others):
            experiment = f"Move the joints one after another, each alone, the others held in several poses. {experiment}"
        return f"To tell {first} from {' and '.join(others)}: {experiment}"
    return None


def to_explain(joint: str, found: Pattern | None) -> str:
    """The experiment that shows an unknown cause at ``joint`` by itself."""
    if found is None:
        return (
            f"Repeat one slow motion of {joint} twenty times without a pause, nothing touching the arm: what does not repeat has a "
            "cause that is not recorded (contact, a cable, a temperature); record that too."
        )
    first = found.variables[0]
    if found.together:
        return (
            f"The error of {joint} follows {first} and {found.variables[1]} together: hold {first} at five values through its range "
            f"and change {found.variables[1]} at each of them."
        )
    if first.startswith("dq_"):
        return (
            f"Move {first[3:]} alone at ten constant speeds, from the slowest to the fastest and both ways: the torque of {joint} "
            "over speed then shows the law by itself."
        )
    if first.startswith("q_"):
        return (
            f"Move {first[2:]} alone through its range, slowly and at constant speed, both ways: what is the same both ways is a "
            f"load on {joint}, what changes sign is friction that depends on the position."
        )
    if first.startswith("load"):
        return f"Move {joint} slowly up and down through its range, with and without a known mass at the flange."
    if first.startswith("direction"):
        return f"Move {joint} alone, slowly and at constant speed, back and forth over the same stretch, twenty times."
    return (
        f"Repeat one motion of {joint} from a cold start until it is warm, then after a pause: what follows {first} then shows "
        "apart from what follows the motion."
    )


def to_see(blind: Sequence[Blind]) -> str | None:
    """The experiment that would cover what these recordings are blind to: the first such effect at a joint."""
    for spot in blind:
        where = f" at {', '.join(spot.joints)}" if spot.joints else ""
        return f"These recordings would not show {spot.effect}{where}: {spot.experiment}"
    return None
