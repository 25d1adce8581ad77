"""The compiled core's stop bound (stops/bound.c), called as the FMU calls it, without an FMU around it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from stopset.core.library import ffi, given, lib, view
from stopset.reach.stops import StopBounds
from stopset.reach.stops.regions import FrictionRegion, regions
from stopset.reach.stops.tube import plant_struct
from stopset.types import Array

FRICTION = ("coulomb_lo", "coulomb_hi", "viscous_lo", "viscous_hi", "u_lo", "u_hi")


@dataclass(frozen=True, slots=True)
class CoreStop:
    """(n,) each: time [s], forward, back [rad], speed [rad/s]; ``tool``: displacement [m] and speed [m/s]."""

    time: Array
    forward: Array
    back: Array
    speed: Array
    tool: Array


def core_stop(bounds: StopBounds) -> Callable[..., CoreStop | None]:
    """``bound(q, dq, q_radius, dq_radius)`` from measured states; None where nothing is proved. No domain is looked at."""
    s, n = bounds.setting, bounds.model.n
    assert s is not None
    rows = [
        [given(getattr(r.plant, k)) for k in FRICTION] + [given(x) for x in (r.q.lo, r.q.hi, r.speed)] for r in regions(s)
    ]  # fmt: skip
    table = ffi.new("StopsetRegion[]", [tuple(view(x) for x in row) for row in rows])
    lag = None if s.lag is None else given(s.lag)
    plant, tool = plant_struct(s.plant), given(s.payload_com)
    apart = -1.0 if s.apart is None else s.apart
    struct = ffi.new("StopsetStops *", (plant[0][0], ffi.NULL if lag is None else view(lag), apart, view(tool), len(rows), table))
    alive, work = (plant, rows, table, lag, tool), np.zeros(lib.stopset_stop_room(n))

    def bound(q: Array, dq: Array, q_radius: Array | None = None, dq_radius: Array | None = None) -> CoreStop | None:
        assert alive
        more = [np.zeros(n) if r is None else r for r in (q_radius, dq_radius)]
        box = [q + s.start.centre[:n], dq + s.start.centre[n:], s.start.radius[:n] + more[0], s.start.radius[n:] + more[1]]
        out = [np.zeros(k) for k in (n, n, n, n, 2)]
        made = ffi.new("StopsetBound *", tuple(view(x) for x in out))
        code = lib.stopset_power_off(struct, *(view(x) for x in box), view(work), made)
        assert code in (0, 1)
        return None if code else CoreStop(*out)

    return bound


def in_region(bounds: StopBounds, region: FrictionRegion) -> StopBounds:
    """The Python bounds with the friction of one region, wherever the stop leads."""
    assert bounds.setting is not None
    n = bounds.model.n
    torques = replace(bounds.setting.torques, roaming=(), speed=np.full(n, np.inf))
    return replace(bounds, setting=replace(bounds.setting, plant=region.plant, torques=torques))
