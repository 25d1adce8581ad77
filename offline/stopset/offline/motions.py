"""Which recordings are independent: the motion is, the repetition and the later start of the same motion are not (P8)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Suite = tuple[str, int]

SHIFT = 8  # samples by which the ends of two recordings of one motion may differ
ALIKE = 0.02  # relative RMS difference of torques that are the same up to a shift of the clock within a sample


def independent_motions(torques: Mapping[Suite, Array]) -> dict[Suite, int]:
    """Number of the motion each suite belongs to; ``torques``: suite -> (N, n) torque of one of its trials.

    Two suites are starts of one motion where the shorter one's torques are the end of the longer one's, but for a few
    samples of shift: so test suites are cut from a recorded motion (Liu & Althoff 2018, sec. V-B).
    """
    motion: dict[Suite, int] = {}
    heads: list[Array] = []  # longest suite of each motion
    for suite in sorted(torques, key=lambda s: -len(torques[s])):
        u = torques[suite]
        for number, whole in enumerate(heads):
            if _ends_alike(whole, u):
                motion[suite] = number
                break
        else:
            motion[suite] = len(heads)
            heads.append(u)
    order = {old: new for new, old in enumerate(dict.fromkeys(motion[s] for s in torques))}
    return {s: order[motion[s]] for s in torques}


def _ends_alike(whole: Array, u: Array) -> bool:
    if len(u) < 2 * SHIFT or not np.ptp(u) > 0:
        return False
    tail = u[SHIFT : len(u) - SHIFT]
    size = np.sqrt(np.mean(tail**2))
    for shift in range(-SHIFT, SHIFT + 1):
        first = len(whole) - len(u) + SHIFT + shift
        other = whole[first : first + len(tail)] if first >= 0 else whole[:0]
        if len(other) == len(tail) and np.sqrt(np.mean((other - tail) ** 2)) <= ALIKE * size:
            return True
    return False
