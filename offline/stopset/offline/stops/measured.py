"""Measured stops: how long and how far the arm really went, and what the bound says from the same state."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from stopset.errors import NotCovered
from stopset.reach.stops import Category, StopBounds
from stopset.recording import Recording

CATEGORY: dict[str, Category] = {"stop0": "0", "stop1": "1"}
STILL = 4.0  # standstill: speeds within this many times the noise band


@dataclass(frozen=True, slots=True)
class Measured:
    """One joint's part in one recorded stop, and the bound from the state at its trigger (None without one)."""

    label: str
    category: Category
    joint: int
    speed: float  # [rad/s] at the trigger
    time: float  # [s]
    angle: float  # [rad] signed
    bound_time: float | None
    bound_angle: float | None


def measured_stops(bounds: StopBounds, recordings: Iterable[Recording]) -> list[Measured]:
    """All stops of phases stop0 and stop1, joint by joint."""
    n = bounds.model.n
    noise = bounds.setting.noise.radius[n:] if bounds.setting is not None else np.full(n, 0.01)
    out = []
    for r in recordings:
        k = r.stop_requested
        if r.phase not in CATEGORY or k is None:
            continue
        try:
            bound = bounds.bound(r.q[k], r.dq[k], CATEGORY[r.phase])
        except NotCovered:
            continue
        moving = np.abs(r.dq[k:]) > STILL * noise + 1e-9
        last = np.where(moving.any(axis=0), moving.shape[0] - 1 - np.argmax(moving[::-1], axis=0), 0)
        travel = r.q[k:] - r.q[k]
        for j in range(n):
            angle = float(travel[int(np.argmax(np.abs(travel[:, j]))), j])
            out.append(
                Measured(
                    r.label, CATEGORY[r.phase], j, float(r.dq[k, j]), float(r.t[k + last[j]] - r.t[k]), angle,
                    None if bound.time is None else float(bound.time[j]),
                    None if bound.forward is None or bound.back is None
                    else float(bound.forward[j] if angle >= 0 else bound.back[j]),
                )
            )  # fmt: skip
    return out
