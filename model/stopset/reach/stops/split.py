"""When one tube is not enough: brakes are constant during a stop, so their intervals may be cut in two and each half bounded.

The half to cut next is where a brake's uncertain impulse can do most harm to the other joints.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from stopset.reach.stops.expansion import expand
from stopset.reach.stops.tube import OK, Plant, Tube
from stopset.robot.rigid import Array

FIELDS = ("delay", "rise", "brake")


def _harm(plant: Plant, q: Array, lasts: float) -> Array:
    """(3, n): speed change, in units of kinetic energy shared with other joints, by each brake parameter's interval."""
    M = expand(plant.chain, plant.pi, plant.pi_half, plant.rotor, q).M
    size = np.sqrt(np.diag(M))
    shared = np.abs(M / np.outer(size, size)).sum(axis=1) - 1.0
    impulse = np.array(
        [
            plant.brake_hi * (plant.delay_hi - plant.delay_lo),
            plant.brake_hi * (plant.rise_hi - plant.rise_lo) / 2.0,
            (plant.brake_hi - plant.brake_lo) * max(lasts - float(np.mean(plant.delay_lo)), 0.0),
        ]
    )
    out: Array = impulse / size * shared
    return out


def halves(plant: Plant, q: Array, lasts: float) -> tuple[Plant, Plant]:
    """The same arm with its most harmful brake interval cut in two; ``lasts``: [s] how long a stop takes, roughly."""
    field, i = np.unravel_index(int(np.argmax(_harm(plant, q, lasts))), (3, plant.rotor.shape[0]))
    name = FIELDS[field]
    lo, hi = getattr(plant, f"{name}_lo").copy(), getattr(plant, f"{name}_hi").copy()
    middle = 0.5 * (lo[i] + hi[i])
    low_hi, high_lo = hi.copy(), lo.copy()
    low_hi[i], high_lo[i] = middle, middle
    return plant._replace(**{f"{name}_hi": low_hi}), plant._replace(**{f"{name}_lo": high_lo})


def certify(march: Callable[[Plant], Tube], plant: Plant, q: Array, lasts: float, pieces: int) -> list[Tube]:
    """Tubes that together hold every stop, cutting brake intervals where one tube does not come to rest.

    At most ``pieces`` tubes are kept; if these do not suffice the last tube is the failed one.
    """
    todo, done = [plant], []
    while todo:
        part = todo.pop()
        tube = march(part)
        if tube.end == OK:
            done.append(tube)
        elif len(todo) + len(done) + 2 > pieces:
            return [*done, tube]
        else:
            todo.extend(halves(part, q, lasts))
    return done
