"""The answer of a comparison in one sentence: whether the sets hold, and where the model fails all the same."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from stopset.offline.compare.compare import Comparison

# a joint that errs by more than this many times what repetitions of the same torques differ by lacks something; below the
# first, what is left is their scatter, give or take that of its estimate
AT_THE_FLOOR, FLOORS = 1.2, 2.0
SEEN = "record the arm anew as it was identified, then `stopset diagnose`: what a monitor saw is one motion, too little for it"
DIAGNOSE = "`stopset diagnose` tells which effect is missing, `stopset add` puts it in"


@dataclass(frozen=True, slots=True)
class ComparisonVerdict:
    """``text``: a few sentences; ``kind``: how a page shows them, neither good nor bad where only the sets hold; ``next``: to do."""

    text: str
    kind: Literal["good", "", "bad"]
    next: str


def _of(out: int, count: int) -> str:
    """How many recordings leave ..., in words."""
    some = f"all {count}" if out == count else f"{out} of {count}"
    return "the recording leaves" if count == 1 else f"{some} recordings {'leaves' if out == 1 else 'leave'}"


def verdict(found: Comparison) -> ComparisonVerdict:
    """What a comparison says, first thing.

    Recordings inside wide sets are enclosed, which is not to say explained: the joint with the largest torque error over its
    repeatability floor is named first. Nothing good is said of recordings outside the model's domain, nor where a joint errs
    above its floor or no repetitions tell one.
    """
    count, out, beyond = len(found.rows), len(found.violations), found.outside_domain
    where, healthy = _worst(found)
    if found.unsound:
        return ComparisonVerdict(
            f"Not comparable: {found.unsound[0]}.", "bad", "mend the recordings first; the model may be right."
        )
    if beyond == count and not out:
        return ComparisonVerdict(
            f"Not covered: {_of(count, count)} the model's domain, where it promises nothing.", "bad",
            "compare with recordings inside the domain (see the table at the end), or identify with these.",
        )  # fmt: skip
    left = (
        f" {beyond} of the {count} {'leaves' if beyond == 1 else 'leave'} the model's domain, where it promises nothing."
        if beyond
        else ""
    )
    left = left if count > 1 or not beyond else " It leaves the model's domain, where it promises nothing."
    if out:
        where = where or _left(found)
        text = f"{where}Not conformant: {_of(out, count)} the predicted sets.{left}"
        return ComparisonVerdict(text, "bad", f"do not rely on bounds of this model; {SEEN if found.said else DIAGNOSE}.")
    stay = f"All {count} recordings stay" if count != 1 else "The recording stays"
    text = f"{where}{stay} inside the predicted sets.{left}"
    if healthy:
        todo = "nothing is left to explain; `stopset stops` bounds the stops, `stopset monitor` watches the arm."
    elif where:
        todo = f"{DIAGNOSE}: the sets hold, but wider than they need be."
    else:
        todo = "record the same torques twice or more: without repetitions nobody can tell the model's error from their scatter."
    return ComparisonVerdict(text, "good" if healthy and not beyond else "", todo)


def _leaves(found: Comparison) -> str:
    """The joint whose set is left worst, empty where none is, or where a set is left across several joints only."""
    if not found.violations:
        return ""
    joint = max(found.violations, key=lambda v: v.relative).state.partition("_")[2]
    return joint if joint in found.figures else ""


def _left(found: Comparison) -> str:
    """A sentence on that joint."""
    joint = _leaves(found)
    if not joint:
        return ""
    worst = max(found.violations, key=lambda v: v.relative)
    return f"The model fails most at {joint}, which leaves its set by {worst.excess:.3g} {worst.unit}. "


def failing(found: Comparison) -> list[str]:
    """The joint that the verdict names, none where it names none."""
    joint, row = by_failure(found)[0]
    if (above(row) or 0.0) > AT_THE_FLOOR:
        return [joint]
    return [j for j in [_leaves(found)] if j]


def in_full(row: Mapping[str, Any]) -> float | None:
    """A joint's torque error [N m] with all that the model knows; what its abstraction leaves out besides is known, and in U."""
    error: float | None = row.get("torque_rmse_known") or row["torque_rmse"]
    return error


def above(row: Mapping[str, Any]) -> float | None:
    """How many times a joint's error `in_full` is what repetitions of the same torques differ by; None where that is unknown."""
    error, floor = in_full(row), row["torque_rmse_floor"]
    return error / floor if error and floor else None


def by_failure(found: Comparison) -> list[tuple[str, Mapping[str, Any]]]:
    """The joints with their figures, the one that errs most over its floor first; those without a floor last, by their error."""
    return sorted(found.figures.items(), key=lambda x: (-(above(x[1]) or 0.0), -(in_full(x[1]) or 0.0)))


def _worst(found: Comparison) -> tuple[str, bool]:
    """A sentence on the joint that errs most over its floor, empty where none errs above it; and whether all joints are at theirs."""
    joint, row = by_failure(found)[0]
    times = above(row)
    if times is None:
        return "", False
    if times <= AT_THE_FLOOR:
        return "", all(above(r) is not None or not r["torque_rmse"] for r in found.figures.values())
    how = "The model fails most at" if times >= FLOORS else "The model errs most at"
    error, whole = times * row["torque_rmse_floor"], row["torque_rmse"]
    left_out = f"; with what the abstraction leaves out, {whole:.3g} N m" if whole > AT_THE_FLOOR * error else ""
    return (
        f"{how} {joint}: its torque errs by {error:.3g} N m, {times:.1f} times what repetitions of the same torques "
        f"differ by ({row['torque_rmse_floor']:.3g} N m){left_out}. "
    ), False
