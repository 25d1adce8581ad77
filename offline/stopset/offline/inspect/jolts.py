"""Moments at which speeds leave the smooth motion by far more than they do otherwise: a contact, or a reference that jumps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stopset.offline.campaign.reading_error import SMOOTH, reading_residual
from stopset.offline.inspect.finding import Finding
from stopset.recording.types import Recording

# times what all but the largest hundredth of moving samples differ by.  recordings of three real arms reach 4.8 (a person pushes), that of a
# fourth with jolts 10 to 17 at each joint; ends that a filter bent, left out before, 12
JOLT = 8.0
SEEN = 0.1  # of the joint's largest speed: less than that is a flaw of a reading and widens nothing
FEWEST = 300  # moving samples that tell what is usual
MOVING = 0.02  # [rad/s]
SHOWN = 5  # moments that are told by their time


@dataclass(frozen=True, slots=True)
class Jolt:
    """A moment ``t`` [s] of a trial at which a ``joint``'s speed is ``size`` [rad/s] off the smooth motion, ``times`` the usual."""

    label: str
    t: float
    joint: int
    size: float
    times: float


def jolts(r: Recording) -> list[Jolt]:
    """The moments of a trial in motion, each by the joint that is farthest beyond what is usual of it."""
    if r.phase not in ("closed_loop", "open_loop"):
        return []
    n, dt = r.q.shape[1], float(np.median(np.diff(r.t)))
    error = np.abs(reading_residual(r.q, r.dq, dt).error[:, n:])
    cut = (len(r.t) - len(error)) // 2
    t, moving = r.t[cut:][: len(error)], (np.abs(r.dq[cut:][: len(error)]) > MOVING).any(axis=1)
    if moving.sum() < FEWEST:
        return []
    times = error / np.maximum(np.percentile(error[moving], 99, axis=0), 1e-12)
    times = np.where(error > SEEN * np.abs(r.dq).max(axis=0), times, 0.0)
    far = np.flatnonzero((times > JOLT).any(axis=1))
    out = []
    for part in np.split(far, np.flatnonzero(np.diff(t[far]) > SMOOTH) + 1) if len(far) else []:
        k, j = np.unravel_index(int(times[part].argmax()), (len(part), n))
        out.append(Jolt(r.label, float(t[part[k]]), int(j), float(error[part[k], j]), float(times[part[k], j])))
    return out


def found(seen: Sequence[Jolt], joints: Sequence[str]) -> list[Finding]:
    """One note of all moments of a file."""
    if not seen:
        return []
    worst = max(seen, key=lambda x: x.size)
    when = ", ".join(f"{x.t:.4g} s of {x.label}" for x in seen[:SHOWN])
    more = f" and {len(seen) - SHOWN} more times" if len(seen) > SHOWN else ""
    return [
        Finding("jolt", "note", joints[worst.joint],
                f"at {when}{more} the speed jolts, by up to {worst.size:.3g} rad/s off the smooth motion, {worst.times:.3g} times what is usual",
                "a motion that a controller plans", "look what happens there, a contact or a reference that jumps: the sets enclose it and are as "
                "wide as it is; leave it out only if the arm never does it", worst.size)
    ]  # fmt: skip
