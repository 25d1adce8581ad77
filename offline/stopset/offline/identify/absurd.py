"""Sets that enclose all that was recorded and yet say little: told in words, and no success where they cannot be meant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stopset.artifact import UncertaintySets
from stopset.offline.campaign.survey import Survey
from stopset.offline.conform.tightness import JUDGED, Tightness

LATE = 0.5  # samples: a speed that comes later than this after the slope of its positions is told
MOVES = 5.0  # a joint moves if it is faster than so many times its noise
BEHIND_GEARS = (
    "the torque shows no rotors, so links move without them, and what a model lacks of it makes light links fast: measured behind the gears it "
    "tells what the links weigh and rub, not where they go; record the drives' own torque (motor current times torque constant and gear ratio), "
    "with faster motions where it is that already, or use this model for diagnosis only"
)
RANGES = 3.0  # an open-loop prediction that errs by more than so many of the joint's ranges has diverged


@dataclass(frozen=True, slots=True)
class Oddity:
    """What cannot be, in a sentence: a ``grave`` one is no model to go out unless asked for."""

    grave: bool
    what: str

    @property
    def says(self) -> str:
        return f"{'absurd' if self.grave else 'wide'}: {self.what}"


def late(found: Survey, joints: Sequence[str]) -> list[str]:
    """One sentence for each joint whose speed is not read when its positions are."""
    n = len(joints)
    return [
        f"the speed of {j} comes {1e3 * abs(x):.1f} ms {'after' if x > 0 else 'before'} the slope of its positions, as one that is "
        f"filtered or derived; with jolts and vibration its readings are up to {found.readings.most.hi[n + k]:.3g} rad/s off the smooth "
        "motion around them, and that is what V may hold"
        for k, (j, x) in enumerate(zip(joints, found.late.tolist(), strict=True))
        if abs(x) > LATE * found.dt
    ]


def silent(found: Survey, joints: Sequence[str], tightness: Tightness, *, geared: bool = True) -> list[Oddity]:
    """What is said of joints of which the sets say less after 0.1 s than that they move as they always did.

    Not ``geared``: the torque shows no rotors, so one sentence tells of all of them why that is, and what would tell more.
    """
    n, mute = len(joints), dict[str, tuple[float, float]]()
    fastest = np.maximum(np.abs(found.dq.lo), np.abs(found.dq.hi))
    for k, j in enumerate(joints):
        half = float(tightness.half[JUDGED, n + k])
        if np.isfinite(half) and half > fastest[k] > MOVES * found.readings.least.hi[n + k]:
            mute[j] = (half, float(fastest[k]))
    said = "say nothing there"
    if geared or not mute:
        out = [
            f"after 0.1 s the speed of {j} is predicted to within {half:.3g} rad/s, and it was never faster than {most:.3g} "
            f"rad/s: its sets {said}; look at its inertia and friction (`stopset compare`)"
            for j, (half, most) in mute.items()
        ]
    else:
        each = ", ".join(f"{j} {half:.3g} rad/s (never faster than {most:.3g})" for j, (half, most) in mute.items())
        out = [f"after 0.1 s speeds are predicted to within {each}: the sets {said}; {BEHIND_GEARS}"]
    return [Oddity(grave=2 * len(mute) > n, what=x) for x in out]


def absurd(sets: UncertaintySets, errors: Mapping[str, Mapping[str, Any]], found: Survey, *, geared: bool = True) -> list[Oddity]:
    """One for each joint and contradiction; ``errors``: joint -> RMS errors of the model. Not ``geared``: the torque shows no rotor, so what it
    moves is light, and that predictions over seconds leave the arm's range is no contradiction."""
    n, out, wide = len(errors), [], []
    fastest = np.maximum(np.abs(found.dq.lo), np.abs(found.dq.hi))
    for k, (j, row) in enumerate(errors.items()):
        wrong = max(-float(sets.V.lo[n + k]), float(sets.V.hi[n + k]))
        if sets.conform == "all" and wrong > fastest[k] > MOVES * found.readings.least.hi[n + k]:
            out.append(
                f"speeds of {j} would be read wrong by up to {wrong:.3g} rad/s, and it was never faster than "
                f"{fastest[k]:.3g} rad/s; look at how dq is made (`stopset inspect`)"
            )
        far, span = row["position_rmse"], float(found.q.width[k])
        diverges = far is not None and far > RANGES * max(span, 1.0)
        if diverges and geared:
            out.append(
                f"open-loop predictions of {j} err by {far:.3g} rad, and it moves over {span:.3g} rad: the model diverges; "
                "check the torque's sign and unit, and the inertia of its drive"
            )
        elif diverges:
            wide.append(
                f"open-loop predictions of {j} err by {far:.3g} rad, and it moves over {span:.3g} rad: torque that shows no rotors, as "
                "behind the gears, moves links without them, so predictions over seconds say nothing of them"
            )
        torque, width = row["torque_rmse"], float(sets.U.width[k])
        if torque is not None and width < 0.5 * torque:
            out.append(
                f"the torque set of {j} is {width:.3g} N m wide where the model's torque errs by {torque:.3g} N m RMS; "
                "its deviations sit in another set: look at the velocity signal"
            )
    return [Oddity(grave=True, what=x) for x in out] + [Oddity(grave=False, what=x) for x in wide]
