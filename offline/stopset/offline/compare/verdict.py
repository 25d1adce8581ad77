"""The answer of a comparison in one sentence: whether the sets hold, and where the model fails all the same."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from stopset.offline.compare.compare import Comparison

# a joint that errs by more than this many times what repetitions of the same torques differ by lacks something
FLOORS = 2.0


@dataclass(frozen=True, slots=True)
class Verdict:
    """``text``: one or two sentences; ``kind``: how a page shows them, neither good nor bad where only the sets hold."""

    text: str
    kind: Literal["good", "", "bad"]


def verdict(found: Comparison) -> Verdict:
    """What a comparison says, first thing.

    Recordings inside wide sets are enclosed, which is not to say explained: the joint with the largest torque error over its
    repeatability floor is named. Nothing good is said of recordings outside the model's domain.
    """
    count, out, beyond = len(found.rows), len(found.violations), found.outside_domain
    where = _worst(found)
    if out:
        return Verdict(f"Not conformant: {out} of {count} recordings leave the predicted sets.{where}", "bad")
    if beyond == count:
        return Verdict(
            f"Not covered: all {count} recordings leave the model's domain, where it promises nothing; "
            "compare with recordings inside it, or identify with these.",
            "bad",
        )
    left = f" {beyond} of them leave the model's domain, where it promises nothing." if beyond else ""
    text = f"All {count} recordings stay inside the predicted sets.{left}{where}"
    return Verdict(text, "good" if not where and not beyond else "")


def _worst(found: Comparison) -> str:
    """A sentence on the joint that errs most over its floor, empty where no joint errs `FLOORS` times it."""
    ratio = {
        j: row["torque_rmse"] / row["torque_rmse_floor"]
        for j, row in found.figures.items()
        if row["torque_rmse"] and row["torque_rmse_floor"]
    }
    j = max(ratio, key=ratio.__getitem__, default=None)
    if j is None or ratio[j] < FLOORS:
        return ""
    row = found.figures[j]
    return (
        f" The model fails most at {j}: its torque errs by {row['torque_rmse']:.3g} N m, {ratio[j]:.1f} times what repetitions of the "
        f"same torques differ by ({row['torque_rmse_floor']:.3g} N m); `stopset diagnose` tells what is missing."
    )
