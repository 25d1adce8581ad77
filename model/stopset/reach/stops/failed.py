"""STOP 1 whose ramp fails: every state in which power can be taken, covered by boxes that each get a STOP 0 tube.

From the request on each joint goes on along its motion with a share ``lambda_i(t)`` of its speed, any function of time with
values from 0 to the largest share: one drive may fail while others brake, or all together. Power is taken after a fixed
time (SS1-t), or ``reaction`` after a joint has left its monitored ramp (SS1-r), at the latest when that has ended. So joint
i has travelled between 0 and some seconds at full speed, and has a speed between 0 and some share: a box. Where the tube
of a box does not come to rest the box is cut in two, across the side that matters most.

Source: IEC 61800-5-2 for SS1-t and SS1-r; stop notes of the project.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stopset.reach.stops.ramp import Ramp
from stopset.reach.stops.tube import OK, Tube
from stopset.robot.rigid import Array

SLICES = 8  # of the monitored ramp, by when it is left
NARROW = 0.35  # [rad/s] a box whose sides do no more harm is not the trouble: then brakes and rotors are cut instead
CELLS = 16  # a box is cut into at most this many for each piece a power-off stop may be cut into
FAST_CELLS = 4  # in a fast loop
ANGLE_WEIGHT = 3.0  # [1/s] harm of a wide angle against a wide speed: slopes of inertia and gravity, some 2 to 4 per rad


@dataclass(frozen=True, slots=True)
class Cell:
    """States at power-off: ``travel`` (n, 2) in seconds at the speed of the request, ``share`` (n, 2) of that speed;
    ``time`` [s]: since the request, at most."""

    travel: Array
    share: Array
    time: float

    def boxes(self, dq: Array, dq_radius: Array, ramp: Ramp) -> tuple[Array, Array, Array, Array]:
        """Displacement (lo, hi) [rad] since the request and speed (lo, hi) [rad/s], (n,) each."""
        (a, b), (s, r) = self.travel.T, self.share.T
        lo, hi = np.minimum(a * dq, b * dq) - b * dq_radius, np.maximum(a * dq, b * dq) + b * dq_radius
        v_lo, v_hi = np.minimum(s * dq, r * dq) - r * dq_radius, np.maximum(s * dq, r * dq) + r * dq_radius
        return lo - ramp.q_error, hi + ramp.q_error, v_lo - ramp.dq_error, v_hi + ramp.dq_error

    def width(self, dq: Array) -> float:
        """[rad/s] the harm of the widest side."""
        pace = np.abs(dq)
        return float(max((ANGLE_WEIGHT * pace * np.ptp(self.travel, axis=1)).max(), (pace * np.ptp(self.share, axis=1)).max()))

    def halves(self, dq: Array, together: bool) -> tuple[Cell, Cell]:
        """Cut across the side that matters most; all joints at once if they fail ``together``."""
        pace = np.abs(dq)
        harm = np.stack([ANGLE_WEIGHT * pace * np.ptp(self.travel, axis=1), pace * np.ptp(self.share, axis=1)])
        side, joint = np.unravel_index(int(np.argmax(harm)), harm.shape)
        which = np.ones(len(dq), bool) if together else np.arange(len(dq)) == joint
        parts = []
        for end in (1, 0):
            new = (self.travel if side == 0 else self.share).copy()
            new[which, end] = new[which].mean(axis=1)
            parts.append(Cell(new, self.share, self.time) if side == 0 else Cell(self.travel, new, self.time))
        return parts[0], parts[1]


def failed_cells(ramp: Ramp, dq: Array) -> list[Cell]:
    """The boxes to begin with; none where nothing says when power is taken."""
    n, top = len(dq), ramp.share

    def cell(way: float, speed: float, time: float) -> Cell:
        return Cell(np.tile([0.0, way], (n, 1)), np.tile([0.0, speed], (n, 1)), time)

    if not ramp.monitored:
        return [] if ramp.off_after is None else [cell(top * ramp.off_after, top, ramp.off_after)]
    lasts = float(np.max(ramp.value.hi if ramp.kind == "time" else np.abs(dq) / ramp.value.lo))
    control = float(np.max(ramp.control.hi))
    out = []
    for k in range(SLICES + 1):  # left in slice k, until whose start the speed was below the line
        line = min(top, 1.0 - max(k - 1, 0) / SLICES + ramp.tolerance)
        s = k / SLICES
        way = control * min(top, 1.0 + ramp.tolerance) + lasts * (s - 0.5 * s * s + ramp.tolerance * s)
        # without drives that accelerate the speed stays below the line while power is being taken
        speed = line if top <= 1.0 else top
        out.append(cell(way + ramp.reaction * speed, speed, control + lasts * s + ramp.reaction))
    return out


def cover(
    cells: list[Cell], dq: Array, together: bool, budget: int, tubes: Callable[[Cell, bool], list[Tube]]
) -> list[tuple[Cell, list[Tube]]]:
    """Tubes for boxes that together are ``cells``; ``tubes(cell, energetic)`` tries one box.

    Each cell is cut at most ``budget`` times; then the kinetic energy has to bound it whole. If that fails too, the last
    tubes are not OK.
    """
    out: list[tuple[Cell, list[Tube]]] = []
    for root in cells:
        todo: list[Cell] = [root]
        done: list[tuple[Cell, list[Tube]]] = []
        while todo:
            part = todo.pop()
            found = tubes(part, False)
            if found[-1].end == OK:
                done.append((part, found))
            elif len(todo) + len(done) + 2 <= budget:
                todo.extend(part.halves(dq, together))
            else:
                done = [(root, tubes(root, True))]
                break
        out += done
        if done[-1][1][-1].end != OK:
            return out
    return out
