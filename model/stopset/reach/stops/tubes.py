"""Tubes of STOP 0 for a measured state: the time step, the cutting into pieces, and when each joint has stopped."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from stopset.core.library import given, lib, view
from stopset.reach.stops.friction import Friction
from stopset.reach.stops.parts import ALL_PARTS, Parts
from stopset.reach.stops.setting import Setting
from stopset.reach.stops.split import certify, nearer
from stopset.reach.stops.start import Start
from stopset.reach.stops.tube import OK, UNBOUNDED, Plant, Stride, Tube, march, plant_struct
from stopset.reach.stops.windows import windows
from stopset.sets import Box
from stopset.types import Array


class Knots(NamedTuple):
    """Time steps over the expected stop, and at least how many of them from when the first brake may close until all have.

    A step counts the least torque that a brake can have at its beginning: what brakes gain on it is given away.
    """

    stop: int
    closing: int


KNOTS = Knots(200, 70)  # of a table; the bound's time is coarse by one of them
ENERGY_KNOTS = Knots(200, 200)  # where the kinetic energy has to help
# in a fast loop: of a certificate (bounds under 1 % wider, in half the time); where the kinetic energy has to help (in a sixth of
# the time), and the same for one payload and for payloads that are alike; windows of the brakes' common delay (half the angle of one
# where the energy has to help)
FAST_KNOTS = Knots(lib.STOPSET_STOP_KNOTS, lib.STOPSET_STOP_CLOSING)
FAST_ENERGY_KNOTS = Knots(lib.STOPSET_STOP_ENERGY_KNOTS, lib.STOPSET_STOP_ENERGY_CLOSING)
FAST_ALIKE_KNOTS = Knots(lib.STOPSET_STOP_ALIKE_KNOTS, lib.STOPSET_STOP_ALIKE_CLOSING)
FAST_WINDOWS: int = lib.STOPSET_STOP_WINDOWS
REGIONS = 5  # that a tube is tried in, each larger than what the last led to
COARSE = 4  # times fewer knots of the tube that finds a region
PATIENCE: int = lib.STOPSET_STOP_PATIENCE  # times the expected stop before a tube is called endless
MORE_PATIENCE: int = lib.STOPSET_STOP_MORE_PATIENCE  # where the kinetic energy bounds it: that takes longer


def expected_stop(plant: Plant, q: Array, speed: Array) -> float:
    """Rough length of a stop [s] from ``q`` [rad] at ``speed`` [rad/s], (n,) each, to choose the time step."""
    if not q.shape == speed.shape == plant.rotor.shape:
        raise ValueError(f"a state of {q.shape} and {speed.shape} for {len(plant.rotor)} joints")
    struct, _held = plant_struct(plant)
    return float(lib.stopset_expected_stop(struct, view(given(q)), view(given(np.abs(speed)))))


@dataclass(slots=True)
class Region:
    """Angles, ``travel`` (n,) [rad] beyond a box, and speeds (n,) [rad/s] that a stop is taken not to leave, until shown.

    A continuous motion that stays inside while it has not left cannot leave: so a tube counts once it lies inside the region that
    its effects were taken over (Lemma 3 of docs/stops.md).  Stops from one box share it, as what held one mostly holds the
    next; ``known``: it has been found by a tube and not guessed.
    """

    travel: Array
    speed: Array
    known: bool = False
    _friction: Friction | None = None

    @classmethod
    def first(cls, setting: Setting, fast: Array, lasts: float) -> Region:
        """A guess for speeds of the box up to ``fast`` (n,) [rad/s] and a stop of some ``lasts`` seconds."""
        limit, speed = setting.torques.speed, 1.05 * fast + 0.05
        return cls(1.1 * lasts * fast + 0.01, np.where(fast < limit, np.minimum(speed, limit), speed))

    def friction(self, setting: Setting, start: Start) -> Friction:
        """What the effects give in the region around ``start``."""
        if self._friction is None:
            at = start.angles
            self._friction = setting.torques.over(Box(at.lo - self.travel, at.hi + self.travel), self.speed)
        return self._friction

    def holds(self, setting: Setting, tube: Tube, start: Start) -> bool:
        """Whether the tube stays inside; if not the region is now a larger one, in which it stays where the effects give the same
        there: then it is that region's tube too."""
        moved, fast = np.maximum(tube.d_hi.max(axis=0), -tube.d_lo.min(axis=0)), fastest(tube)
        if self._inside(moved, fast):
            return True
        before = self._friction
        self.travel, self.speed = np.maximum(self.travel, 1.3 * moved), np.maximum(self.speed, 1.1 * fast)
        self.known, self._friction = True, None
        return before is not None and before.same(self.friction(setting, start)) and self._inside(moved, fast)

    def _inside(self, moved: Array, fast: Array) -> bool:
        return bool(np.all(moved < self.travel) and np.all(fast < self.speed))


def march_box(
    setting: Setting, plant: Plant, start: Start, parts: Parts = ALL_PARTS, *, energetic: bool, knots: Knots | None = None,
    region: Region | None = None,
) -> Tube:  # fmt: skip
    """One tube of ``plant`` from the states of ``start``.

    Where effects depend on pose or speed, they are those of a `Region` that the stop must not leave, given or found here: first
    with a coarse tube where laws look at most joints.
    """
    fast, angles, speeds = start.fastest, start.angles, start.speeds
    knots = knots or (ENERGY_KNOTS if energetic else KNOTS)
    lasts = expected_stop(setting.plant, start.q, fast)
    patience = MORE_PATIENCE if energetic else PATIENCE
    closes = float((plant.delay_hi + plant.rise_hi).max() - plant.delay_lo.min())
    if setting.torques.settled:
        steps = Stride(lasts / knots.stop, knots.stop * patience + knots.closing, closes / knots.closing)
        return march(plant, angles, speeds, steps, parts, energetic=energetic)
    region = region or Region.first(setting, fast, lasts)
    for _ in range(REGIONS):
        coarse = not region.known and setting.torques.far_seeing
        few, brief = (max(1, count // (COARSE if coarse else 1)) for count in (knots.stop, knots.closing))
        steps = Stride(lasts / few, few * patience + brief, closes / brief)
        at = setting.with_friction(plant, region.friction(setting, start))
        tube = march(at, angles, speeds, steps, parts, energetic=energetic)
        if tube.end != OK and not coarse:
            return tube
        if tube.end != OK:
            region.known = True  # no more is found with so few steps
        elif region.holds(setting, tube, start):
            if not coarse:
                return tube
            region.known = True
    return tube._replace(end=UNBOUNDED)


def fastest(tube: Tube) -> Array:
    """(n,) [rad/s] largest speed of a tube, between its knots too."""
    knots = np.maximum(np.abs(tube.v_lo), np.abs(tube.v_hi)).max(axis=0)
    out: Array = np.maximum(knots, np.maximum(np.abs(tube.e_lo), np.abs(tube.e_hi)).max(axis=0))
    return out


def tubes_of(
    setting: Setting, start: Start, pieces: int, parts: Parts = ALL_PARTS, *, last_resort: bool = True, fast: bool = False
) -> list[Tube]:
    """Tubes that together hold all stops from the states of ``start``; the last is not OK if that failed.

    Up to ``pieces`` of them, for every window of the brakes' common delay; with one piece the delays are taken as independent.
    ``last_resort``: whether the kinetic energy may have to bound it; ``fast``: few windows and coarse steps, for a loop.
    """
    lasts = expected_stop(setting.plant, start.q, start.fastest)
    loop = FAST_KNOTS, FAST_ENERGY_KNOTS if setting.payloads == lib.STOPSET_SOME_PAYLOADS else FAST_ALIKE_KNOTS
    knots = loop if fast else (KNOTS, ENERGY_KNOTS)
    regions = [Region.first(setting, start.fastest, lasts) for _ in knots]  # the kinetic energy's tubes lead farther

    def one(plant: Plant, *, energetic: bool) -> Tube:
        return march_box(setting, plant, start, parts, energetic=energetic, knots=knots[energetic], region=regions[energetic])

    out: list[Tube] = []
    # the latest brakes are the hardest: what cannot be proved is known at once
    delay_spread = setting.delay_spread if pieces > 1 or fast else None
    for plant in reversed(windows(setting.plant, delay_spread, setting.lag, FAST_WINDOWS if fast else None)):
        part = certify(one, plant, start.q, lasts, pieces, last_resort=last_resort)
        if [t.end for t in part] == [OK] and last_resort and not part[0].energetic:
            part = [nearer(one, plant, part[0])]
        out += part
        if part[-1].end != OK:
            break
    return out


def stopped_after(tube: Tube) -> Array:
    """(n,) [s]: the first knot from which each joint's speed bounds are zero."""
    moving = (tube.v_lo != 0.0) | (tube.v_hi != 0.0)
    # the momenta may show that a joint rests at a knot, having moved since the one before
    moving[:-1] |= (tube.e_lo != 0.0) | (tube.e_hi != 0.0)
    last = np.where(moving.any(axis=0), len(tube.t) - 1 - np.argmax(moving[::-1], axis=0), -1)
    after: Array = tube.t[np.minimum(last + 1, len(tube.t) - 1)]
    return after
