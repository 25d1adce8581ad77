"""When one tube is not enough: the kinetic energy; else brakes and rotors are constant during a
stop, so their intervals may be cut in two and each half bounded.

The interval to cut next is the one whose uncertain impulse can do most harm to the other joints.
"""

from __future__ import annotations

from heapq import heappop, heappush
from itertools import count
from typing import Protocol

import numpy as np

from stopset.reach.stops.expansion import expand
from stopset.reach.stops.tube import OK, Plant, Tube
from stopset.types import Array

FIELDS = ("delay", "rise", "brake")
TRIALS = 15  # tubes that are tried while none comes to rest
REWARD = 3  # more for each that does: cutting then helps
BLURRED = 0.5  # [rad/s] by which a band of speeds may be wider than the fastest joint was before the energy is asked too


def harm_of(plant: Plant, q: Array, lasts: float) -> Array:
    """(4, n): speed change, in units of kinetic energy shared with other joints, by each interval."""
    M = expand(plant.chain, plant.pi, plant.pi_half, plant.rotor, q).M
    size = np.sqrt(np.diag(M))
    shared = np.abs(M / np.outer(size, size)).sum(axis=1) - 1.0
    impulse = np.array(
        [
            plant.brake_hi * (plant.delay_hi - plant.delay_lo),
            plant.brake_hi * (plant.rise_hi - plant.rise_lo) / 2.0,
            (plant.brake_hi - plant.brake_lo) * max(lasts - float(np.mean(plant.delay_lo)), 0.0),
            # what the joint's own momentum may be short of, at the speed its brake takes away meanwhile
            2.0 * plant.rotor_half / np.diag(M) * plant.brake_hi * lasts,
        ]
    )
    out: Array = impulse / size * (0.05 + shared)
    return out


def halves(plant: Plant, q: Array, lasts: float) -> tuple[Plant, Plant]:
    """The same arm with its most harmful interval cut in two; ``lasts``: [s] how long a stop takes, roughly."""
    field, i = np.unravel_index(int(np.argmax(harm_of(plant, q, lasts))), (4, plant.rotor.shape[0]))
    if field == 3:
        middle, half = plant.rotor, plant.rotor_half.copy()
        half[i] *= 0.5
        shift = np.zeros_like(half)
        shift[i] = half[i]
        return plant._replace(rotor=middle - shift, rotor_half=half), plant._replace(rotor=middle + shift, rotor_half=half)
    name = FIELDS[field]
    lo, hi = getattr(plant, f"{name}_lo").copy(), getattr(plant, f"{name}_hi").copy()
    middle = 0.5 * (lo[i] + hi[i])
    low_hi, high_lo = hi.copy(), lo.copy()
    low_hi[i], high_lo[i] = middle, middle
    return plant._replace(**{f"{name}_hi": low_hi}), plant._replace(**{f"{name}_lo": high_lo})


class March(Protocol):
    """One tube of an arm with these parameters; ``energetic``: with the help of the kinetic energy."""

    def __call__(self, plant: Plant, /, *, energetic: bool) -> Tube: ...


def certify(march: March, plant: Plant, q: Array, lasts: float, pieces: int, *, last_resort: bool) -> list[Tube]:
    """Tubes that together hold every stop: one, or one with the help of the kinetic energy, or of cut intervals.

    With ``last_resort`` the energy is asked where one tube does not come to rest, before any interval is cut: where it knows an end that
    is seldom farther than what the pieces find, at the cost of one of many. At most ``pieces`` tubes are kept, and no more tried than
    `TRIALS` and `REWARD` for each that came to rest: where the first ones do not, the rest seldom does. The part that can do most harm
    is tried first. If all fails the only tube is not OK.
    """
    tube = march(plant, energetic=False)
    if tube.end != OK and last_resort:
        tube = march(plant, energetic=True)
    if tube.end == OK:
        return [tube]
    return _cut(march, plant, q, lasts, pieces) or [tube]


def _cut(march: March, plant: Plant, q: Array, lasts: float, pieces: int) -> list[Tube]:
    """Tubes of joint speeds of parts of ``plant``, which as a whole has none; none of them where not all come to rest."""
    order = count()
    todo: list[tuple[float, int, Plant]] = []
    done: list[Tube] = []

    def cut(part: Plant) -> None:
        for half in halves(part, q, lasts):
            heappush(todo, (-float(harm_of(half, q, lasts).max()), next(order), half))

    tried = 1
    if pieces > 1:
        cut(plant)
    while todo:
        part = heappop(todo)[-1]
        tube = march(part, energetic=False)
        tried += 1
        if tube.end == OK:
            done.append(tube)
        elif len(todo) + len(done) + 2 > pieces or tried + len(todo) + 2 > TRIALS + REWARD * len(done):
            return []
        else:
            cut(part)
    return done


def nearer(march: March, plant: Plant, tube: Tube) -> Tube:
    """``tube`` of ``plant`` that came to rest, or one with the help of the kinetic energy where that lets the arm go less far.

    It is asked where bands of speeds have fed on each other though they closed: there the energy often knows more.
    """
    if not _blurred(tube):
        return tube
    whole = march(plant, energetic=True)
    return whole if whole.end == OK and np.mean(_reach(whole) / _reach(tube)) < 1.0 else tube


def _blurred(tube: Tube) -> bool:
    """Whether bands of speeds have fed on each other."""
    fastest = max(float(np.abs(tube.v_lo[0]).max()), float(np.abs(tube.v_hi[0]).max()))
    return float(np.max(tube.v_hi - tube.v_lo)) > fastest + BLURRED


def _reach(tube: Tube) -> Array:
    """(n,) [rad] how far each joint gets, no less than a hair."""
    out: Array = np.maximum(np.maximum(tube.d_hi.max(axis=0), -tube.d_lo.min(axis=0)), 1e-9)
    return out
