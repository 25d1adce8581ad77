"""Friction of a model's stops for a few regions of angles and speeds, made once: for who cannot evaluate laws over intervals.

The largest region counts where a stop may leave the others; each is an enclosure of the laws over all of it, so a stop that
stays inside while it has not left cannot leave it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stopset.reach.stops.friction import BEYOND
from stopset.reach.stops.setting import Setting
from stopset.reach.stops.tube import Plant
from stopset.sets import Box
from stopset.types import Array

SHARES = (0.5, 1.0, 2.0)  # of the fastest speeds that identification has seen, one region each


@dataclass(frozen=True, slots=True)
class FrictionRegion:
    """``plant``: its friction and torques hold at angles in ``q`` (n,) [rad], no joint faster than ``speed`` (n,) [rad/s]."""

    plant: Plant
    q: Box
    speed: Array


def regions(setting: Setting) -> tuple[FrictionRegion, ...]:
    """From the smallest to the largest, each inside the next; one without an end where friction depends on neither."""
    n, torques, seen = setting.model.n, setting.torques, setting.model.domain.q
    whole = Box(np.full(n, -np.inf), np.full(n, np.inf))
    if torques.settled:
        return (FrictionRegion(setting.plant, whole, whole.hi),)
    near = Box(seen.lo - BEYOND, seen.hi + BEYOND)
    q = near if torques.roaming else whole
    speeds = [share * torques.fastest for share in SHARES]
    return tuple(FrictionRegion(setting.near(setting.plant, near, v), q, v) for v in speeds)
