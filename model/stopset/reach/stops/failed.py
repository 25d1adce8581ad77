"""STOP 1 whose ramp fails: every state in which power can be taken, covered by boxes that each get a STOP 0 tube.

From the request on each joint goes on along its motion with a share ``lambda_i(t)`` of its speed, any function of time with
values from 0 to the largest share: one drive may fail while others brake, or all together. A programmed motion that gets faster by
its pace does so as it is run through. Power is taken after a fixed time (SS1-t), or ``reaction`` after a joint has left its monitored
ramp (SS1-r), at the latest when that has ended. So joint
i has travelled between 0 and some seconds at full speed, and has a speed between 0 and some share: a box. Where the tube
of a box does not come to rest the box is cut in two, across the side that matters most, or, of a narrow one, what is known of
brakes and rotors. A budget of tubes, larger where cutting helps, keeps that short; what it does not close the
kinetic energy bounds.

Source: IEC 61800-5-2 for SS1-t and SS1-r; stop notes of the project.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from heapq import heapify, heappop, heappush
from itertools import count
from typing import NamedTuple, Protocol

import numpy as np

from stopset.reach.stops.ramp import Ramp
from stopset.reach.stops.setting import Setting
from stopset.reach.stops.split import REWARD, halves
from stopset.reach.stops.start import Start
from stopset.reach.stops.tube import OK, Plant, Tube
from stopset.reach.stops.tubes import FAST_ENERGY_KNOTS, FAST_KNOTS, KNOTS, expected_stop, march_box
from stopset.types import Array

SLICES, FAST_SLICES = 8, 4  # of the monitored ramp, by when it is left; in a fast loop, of which joint speeds say enough
NARROW = 0.35  # [rad/s] a box whose sides do no more harm is not the trouble: then brakes and rotors are cut instead
# how many tubes are tried for a failed ramp while none comes to rest, and at all; then the kinetic energy bounds what is open
TUBES, TABLE_TUBES = (63, 320), (15, 160)  # for one state, in a table of hundreds
SLICE = 8  # one more for every further slice of a monitored ramp and so many of the first number
ANGLE_WEIGHT = 3.0  # [1/s] harm of a wide angle against a wide speed: slopes of inertia and gravity, some 2 to 4 per rad


@dataclass(frozen=True, slots=True)
class StatesAtCut:
    """States at power-off: ``travel`` (n, 2) in seconds at the speed of the request, ``share`` (n, 2) of that speed;
    ``time`` [s]: since the request, at most."""

    travel: Array
    share: Array
    time: float

    def boxes(self, start: Start, ramp: Ramp) -> tuple[Array, Array, Array, Array]:
        """Displacement (lo, hi) [rad] since the request and speed (lo, hi) [rad/s], (n,) each."""
        dq, dq_radius = start.dq, start.dq_radius
        (a, b), (s, r) = self.travel.T, self.share.T
        lo, hi = np.minimum(a * dq, b * dq) - b * dq_radius, np.maximum(a * dq, b * dq) + b * dq_radius
        v_lo, v_hi = np.minimum(s * dq, r * dq) - r * dq_radius, np.maximum(s * dq, r * dq) + r * dq_radius
        return lo - ramp.q_error, hi + ramp.q_error, v_lo - ramp.dq_error, v_hi + ramp.dq_error

    def width(self, dq: Array) -> float:
        """[rad/s] the harm of the widest side."""
        pace = np.abs(dq)
        return float(max((ANGLE_WEIGHT * pace * np.ptp(self.travel, axis=1)).max(), (pace * np.ptp(self.share, axis=1)).max()))

    def halves(self, dq: Array, *, together: bool) -> tuple[StatesAtCut, StatesAtCut]:
        """Cut across the side that matters most; all joints at once if they fail ``together``."""
        pace = np.abs(dq)
        harm = np.stack([ANGLE_WEIGHT * pace * np.ptp(self.travel, axis=1), pace * np.ptp(self.share, axis=1)])
        side, joint = np.unravel_index(int(np.argmax(harm)), harm.shape)
        which = np.ones(len(dq), bool) if together else np.arange(len(dq)) == joint
        parts = []
        for end in (1, 0):
            new = (self.travel if side == 0 else self.share).copy()
            new[which, end] = new[which].mean(axis=1)
            parts.append(StatesAtCut(new, self.share, self.time) if side == 0 else StatesAtCut(self.travel, new, self.time))
        return parts[0], parts[1]


def failed_cells(ramp: Ramp, fastest: Array, slices: int = SLICES) -> list[StatesAtCut]:
    """The boxes to begin with, but those that lie in the next one, which is later: so does their stop.

    ``fastest`` (n,) [rad/s]: the largest speeds at the request, as a ramp of fixed deceleration lasts. None where nothing says when power is taken.
    """
    n, top, pace = len(fastest), ramp.share, max(0.0, *ramp.pace)

    def cell(path_time: float, speed: float, time: float) -> StatesAtCut:
        travel, share = path_time * (1.0 + 0.5 * pace * path_time), speed * (1.0 + pace * path_time)
        return StatesAtCut(np.tile([0.0, travel], (n, 1)), np.tile([0.0, share], (n, 1)), time)

    if not ramp.monitored:
        return [] if ramp.off_after is None else [cell(top * ramp.off_after, top, ramp.off_after)]
    lasts = float(np.max(ramp.value.hi if ramp.kind == "time" else fastest / ramp.value.lo))
    control = float(np.max(ramp.control.hi))
    out: list[StatesAtCut] = []
    for k in range(slices + 1):  # left in slice k, until whose start the speed was below the line
        line = min(top, 1.0 - max(k - 1, 0) / slices + ramp.tolerance)
        s = k / slices
        path_time = control * min(top, 1.0 + ramp.tolerance) + lasts * (s - 0.5 * s * s + ramp.tolerance * s)
        # without drives that accelerate the speed stays below the line while power is being taken
        speed = line if top <= 1.0 else top
        here = cell(path_time + ramp.reaction * speed, speed, control + lasts * s + ramp.reaction)
        if out and np.all(out[-1].share <= here.share):  # later, no joint has travelled less
            out.pop()
        out.append(here)
    return out


class MarchOn(Protocol):
    """One tube from a box of states at power-off; ``energetic``: with the help of the kinetic energy."""

    def __call__(self, cell: StatesAtCut, plant: Plant, /, *, energetic: bool) -> Tube: ...


class CutPart(NamedTuple):
    """A box of states at power-off, an arm with the parameters it may then have, and the tube from there."""

    cell: StatesAtCut
    plant: Plant
    tube: Tube


@dataclass(frozen=True, slots=True)
class Cover:
    """Tubes that together hold every failure; the last is not OK if that failed. ``loose``: how many of them the kinetic energy
    had to bound, when the ``tried`` tubes of joint speeds had used up the budget."""

    parts: tuple[CutPart, ...]
    loose: int
    tried: int


def cover(
    cells: Sequence[StatesAtCut], plant: Plant, cut: Callable[[StatesAtCut, Plant], Sequence[tuple[StatesAtCut, Plant]]],
    march: MarchOn, width: Callable[[StatesAtCut], float], budget: tuple[int, int],
) -> Cover:  # fmt: skip
    """Tubes for boxes that together are ``cells``; ``march`` tries one, ``cut`` makes two of one.

    The widest box is tried first, and cut where its tube does not come to rest.  ``budget``: how many tubes may be tried so while
    none comes to rest, and how many at all; each that does is worth `REWARD` more.  What is open then the kinetic energy bounds,
    which is looser; where even that fails for a part it is tried for the whole box.
    """
    order = count()
    todo = [(-width(c), next(order), c, plant, c) for c in cells]
    heapify(todo)
    parts: list[tuple[StatesAtCut, CutPart]] = []  # each with the box it is of
    left: list[tuple[StatesAtCut, Plant, StatesAtCut]] = []
    tried = 0
    while todo:
        _, _, cell, arm, root = heappop(todo)
        allowed = min(budget[0] + REWARD * len(parts), budget[1])
        if tried < allowed:
            tried += 1
            tube = march(cell, arm, energetic=False)
            if tube.end == OK:
                parts.append((root, CutPart(cell, arm, tube)))
                continue
            if tried + len(todo) + 2 <= allowed:
                for c, a in cut(cell, arm):
                    heappush(todo, (-width(c), next(order), c, a, root))
                continue
        left.append((cell, arm, root))
    loose, whole = 0, set()
    for cell, arm, root in left:
        if id(root) in whole:
            continue
        tube = march(cell, arm, energetic=True)
        if tube.end != OK and cell is not root:
            whole.add(id(root))
            cell, arm = root, plant
            parts = [x for x in parts if x[0] is not root]
            tube = march(root, plant, energetic=True)
        parts.append((root, CutPart(cell, arm, tube)))
        loose += 1
        if tube.end != OK:
            break
    return Cover(tuple(p for _, p in parts), loose, tried)


def failed_stops(setting: Setting, ramp: Ramp, start: Start, tubes: tuple[int, int], *, fast: bool) -> Cover | None:
    """Tubes of all stops after a failed ramp, from requests at ``start``.

    None where nothing says when power is taken; ``tubes``: see `TUBES`; ``fast``: coarser steps, for a loop.
    """
    q, dq = start.q, start.dq
    cells = failed_cells(ramp, start.fastest)
    if not cells:
        return None
    lasts = expected_stop(setting.plant, q, start.fastest)

    def march(cell: StatesAtCut, plant: Plant, *, energetic: bool) -> Tube:
        lo, hi, v_lo, v_hi = cell.boxes(start, ramp)
        # whatever the ramp did, the drives may still give while their power goes
        v_lo, v_hi = v_lo + setting.residual.lo, v_hi + setting.residual.hi
        here = Start(q + 0.5 * (lo + hi), 0.5 * (v_lo + v_hi), 0.5 * (hi - lo) + start.q_radius, 0.5 * (v_hi - v_lo))
        knots = FAST_ENERGY_KNOTS if energetic else FAST_KNOTS if fast else KNOTS
        return march_box(setting, plant, here, energetic=energetic, knots=knots)

    def cut(cell: StatesAtCut, plant: Plant) -> Sequence[tuple[StatesAtCut, Plant]]:
        if cell.width(dq) > NARROW:
            return [(c, plant) for c in cell.halves(dq, together=ramp.together)]
        return [(cell, p) for p in halves(plant, q, lasts)]

    if fast:
        return in_a_loop(failed_cells(ramp, start.fastest, FAST_SLICES), cells, setting.plant, march)
    least = tubes[0] + (tubes[0] // SLICE * SLICES if ramp.monitored else 0)
    return cover(cells, setting.plant, cut, march, lambda c: c.width(dq), (least, tubes[1]))


def in_a_loop(few: Sequence[StatesAtCut], cells: Sequence[StatesAtCut], plant: Plant, march: MarchOn) -> Cover:
    """Without cutting: the ``few`` boxes by joint speeds, or else all ``cells`` by the kinetic energy.

    Where joint speeds come to rest they say as much in half the boxes, each in a fraction of the time.
    """

    def until_one_fails(boxes: Sequence[StatesAtCut], *, energetic: bool) -> tuple[CutPart, ...]:
        parts: list[CutPart] = []
        for cell in boxes:
            parts.append(CutPart(cell, plant, march(cell, plant, energetic=energetic)))
            if parts[-1].tube.end != OK:
                break
        return tuple(parts)

    parts = until_one_fails(few, energetic=False)
    if parts[-1].tube.end == OK:
        return Cover(parts, 0, len(parts))
    loose = until_one_fails(cells, energetic=True)
    return Cover(loose, len(loose), len(parts))
