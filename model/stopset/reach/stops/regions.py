"""Friction of a model's stops for a few regions of angles and speeds, made once: for who cannot evaluate laws over intervals.

`power_off` is what an FMU computes: the core's stop bound with these regions.  The largest region counts where a stop may leave
the others; each is an enclosure of the laws over all of it, so a stop that stays inside while it has not left cannot leave it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stopset.core.library import check, ffi, given, lib, view
from stopset.reach.stops.friction import BEYOND
from stopset.reach.stops.setting import Setting
from stopset.reach.stops.tube import Plant, plant_struct
from stopset.sets import Box
from stopset.types import Array

FRICTION = ("coulomb_lo", "coulomb_hi", "viscous_lo", "viscous_hi", "u_lo", "u_hi")  # of a `Plant`, in the order of the C struct
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


@dataclass(frozen=True, slots=True)
class PowerOff:
    """A STOP 0: ``time`` [s], ``forward``, ``back`` [rad], ``speed`` [rad/s], (n,) each; ``tool``: displacement [m], speed [m/s]."""

    time: Array
    forward: Array
    back: Array
    speed: Array
    tool: Array


def power_off(setting: Setting) -> Callable[..., PowerOff | None]:
    """``bound(q, dq, q_radius, dq_radius)`` of measured states in a box, (n,) each [rad, rad/s]; None where nothing is proved.

    No domain is looked at.  Where friction depends on neither pose nor speed it is `StopBounds.bound` with ``fast``.
    """
    s, n = setting, setting.model.n
    rows = [[given(getattr(r.plant, k)) for k in FRICTION] + [given(x) for x in (r.q.lo, r.q.hi, r.speed)] for r in regions(s)]
    table = ffi.new("StopsetRegion[]", [tuple(view(x) for x in row) for row in rows])
    plant, tool = plant_struct(s.plant), given(s.payload_com)
    lag = ffi.NULL if s.lag is None else view(given(s.lag))
    apart = -1.0 if s.apart is None else s.apart
    struct = ffi.new("StopsetStops *", (plant[0][0], lag, apart, view(tool), len(rows), table))
    held, work = (plant, rows, table, lag, tool), np.empty(lib.stopset_stop_room(n))

    def bound(q: Array, dq: Array, q_radius: Array | None = None, dq_radius: Array | None = None) -> PowerOff | None:
        assert held
        more_q, more_dq = (np.zeros(n) if r is None else r for r in (q_radius, dq_radius))
        box = q + s.start.centre[:n], dq + s.start.centre[n:], s.start.radius[:n] + more_q, s.start.radius[n:] + more_dq
        if any(x.shape != (n,) for x in box):
            raise ValueError(f"a box of {[x.shape for x in box]} for {n} joints")
        out = [np.empty(k) for k in (n, n, n, n, 2)]
        made = ffi.new("StopsetBound *", tuple(view(x) for x in out))
        code = lib.stopset_power_off(struct, *(view(x) for x in box), view(work), made)
        check(-min(code, 0))
        return None if code else PowerOff(*out)

    return bound
