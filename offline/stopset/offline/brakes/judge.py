"""Recorded stops against their bounds: every measured sample after the trigger, with the measurement's own error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stopset.artifact import Guarantee, Model
from stopset.offline.conform.guarantee import CONFIDENCE, clopper_pearson
from stopset.reach.stops.ramp import Ramp, ramp_time, ramp_tube
from stopset.reach.stops.setting import Setting, setting_of
from stopset.reach.stops.start import Start
from stopset.reach.stops.tube import OK, Tube
from stopset.reach.stops.tubes import tubes_of
from stopset.recording import Recording
from stopset.sets import Box
from stopset.types import Array

BEFORE = 20  # samples before the request that tell how the speeds were changing
SLOW = 0.2  # [rad/s] all joints together; slower, that is lost in the noise
PIECES = 8  # tubes per stop and window of delays


@dataclass(frozen=True, slots=True)
class StopVerdict:
    """Recorded stops against their bounds: how many have a certified one, which leave it (label, joint, time [s]).

    ``uncovered``: stops to which the bound does not apply, as its assumptions do not hold for them.
    """

    stops: int
    certified: int
    outside: tuple[tuple[str, int, float], ...]
    uncovered: tuple[str, ...] = ()

    @property
    def labels(self) -> list[str]:
        """Labels of the stops that leave their bound."""
        return [label for label, _, _ in self.outside]


def stop0_tubes(setting: Setting, r: Recording, pieces: int = PIECES) -> list[Tube] | None:
    """Tubes that together hold a power-off stop from the state measured at the trigger; None without certificate."""
    k = r.stop_requested
    assert k is not None
    n, start = r.q.shape[1], setting.start
    q, dq = r.q[k] + start.centre[:n], r.dq[k] + start.centre[n:]
    tubes = tubes_of(setting, Start(q, dq, start.radius[:n], start.radius[n:]), pieces)
    return None if tubes[-1].end != OK else tubes


def judge_stop0(model: Model, stops: Sequence[Recording]) -> StopVerdict:
    """All recorded power-off stops against the model's bounds."""
    setting = setting_of(model)
    assert setting is not None
    outside, certified = [], 0
    for r in stops:
        tubes = stop0_tubes(setting, r)
        if tubes is None:
            continue
        certified += 1
        left = first_outside(tubes, r, setting.noise)
        if left is not None:
            outside.append((r.label, *left))
    return StopVerdict(len(stops), certified, tuple(outside))


def judge_stop1(ramp: Ramp, noise: Box, stops: Sequence[Recording]) -> StopVerdict:
    """All recorded controlled stops against the ramp's bounds, where the motion they slow down changes as the ramp assumes."""
    outside, uncovered = [], []
    for r in stops:
        pace = pace_before(r)
        if pace is not None and not ramp.pace[0] <= pace <= ramp.pace[1]:
            uncovered.append(r.label)
            continue
        left = first_outside([stop1_tube(ramp, noise, r)], r, noise) or first_still_moving(ramp, noise, r)
        if left is not None:
            outside.append((r.label, *left))
    return StopVerdict(len(stops), len(stops) - len(uncovered), tuple(outside), tuple(uncovered))


def pace_before(r: Recording) -> float | None:
    """Share of its speed [1/s] by which the arm's motion was changing at the request; None where it hardly moved."""
    k = r.stop_requested
    assert k is not None
    if k < BEFORE:
        return None
    rows = slice(k - BEFORE, k + 1)
    v0, slope = r.dq[k], np.polyfit(r.t[rows] - r.t[k], r.dq[rows], 2)[1]
    size = float(v0 @ v0)
    return float(slope @ v0) / size if size > SLOW**2 else None


def stop1_tube(ramp: Ramp, noise: Box, r: Recording) -> Tube:
    """The ramp's bounds from the speeds measured at the request."""
    k = r.stop_requested
    assert k is not None
    n = r.dq.shape[1]
    return ramp_tube(ramp, r.dq[k] - noise.hi[n:], r.dq[k] - noise.lo[n:])


def first_still_moving(ramp: Ramp, noise: Box, r: Recording) -> tuple[int, float] | None:
    """Joint and time after the trigger [s] at which a controlled stop still moves though its bound says it rests; None if it never
    does, or nothing is said."""
    k = r.stop_requested
    assert k is not None
    n = r.dq.shape[1]
    rests = ramp_time(ramp, r.dq[k] - noise.hi[n:], r.dq[k] - noise.lo[n:])
    if rests is None:
        return None
    t = r.t[k:] - r.t[k]
    bad = (np.abs(r.dq[k:]) > ramp.band) & (t[:, None] > rests)
    if not bad.any():
        return None
    row = int(np.argmax(bad.any(axis=1)))
    return int(np.argmax(bad[row])), float(t[row])


def first_outside(tubes: Sequence[Tube], r: Recording, noise: Box) -> tuple[int, float] | None:
    """Joint and time after the trigger [s] at which a recorded stop first leaves the hull of ``tubes``; None if it never does."""
    k = r.stop_requested
    assert k is not None
    t, travel, dq = r.t[k:] - r.t[k], r.q[k:] - r.q[k], r.dq[k:]
    bad = ~inside(tubes, t, travel, dq, noise)
    if not bad.any():
        return None
    row = int(np.argmax(bad.any(axis=1)))
    return int(np.argmax(bad[row])), float(t[row])


def inside(tubes: Sequence[Tube], t: Array, travel: Array, dq: Array, noise: Box) -> NDArray[np.bool_]:
    """(K, n) whether measured displacement and speed lie in the hull of the tubes, measurement error included."""
    n = travel.shape[1]
    width = 2.0 * noise.radius[:n]  # the displacement is a difference of two measured angles
    lo, hi = np.full(travel.shape, np.inf), np.full(travel.shape, -np.inf)
    v_lo, v_hi = lo.copy(), hi.copy()
    for tube in tubes:
        for j in range(n):
            lo[:, j] = np.minimum(lo[:, j], np.interp(t, tube.t, tube.d_lo[:, j]))
            hi[:, j] = np.maximum(hi[:, j], np.interp(t, tube.t, tube.d_hi[:, j]))
            v_lo[:, j] = np.minimum(v_lo[:, j], np.interp(t, tube.t, tube.v_lo[:, j]))
            v_hi[:, j] = np.maximum(v_hi[:, j], np.interp(t, tube.t, tube.v_hi[:, j]))
    good = (travel >= lo - width) & (travel <= hi + width)
    good &= (dq >= v_lo + noise.lo[n:]) & (dq <= v_hi + noise.hi[n:])
    return np.asarray(good)


def guarantee_line(what: str, regular: StopVerdict, extra: StopVerdict, trained: int) -> Guarantee:
    """What the held-out stops say, with how many had a certified bound at all: the rest says nothing either way."""
    tried, violated = regular.certified + extra.certified, len(regular.outside) + len(extra.outside)
    bound = clopper_pearson(violated, tried, CONFIDENCE) if tried else 1.0
    text = f"{what}: {tried} of {regular.stops + extra.stops} held-out stops have a certified bound, {violated} of these leave it"
    if extra.stops:
        text += f" (of the {extra.stops} from suites of few stops: {extra.certified} and {len(extra.outside)})"
    if regular.uncovered or extra.uncovered:
        text += f"; to {len(regular.uncovered) + len(extra.uncovered)} it does not apply, as no training stop was asked for in such a motion"
    text += (
        f"; at {CONFIDENCE:.0%} confidence fewer than {bound:.1%} of stops like these leave a bound that is certified "
        f"({trained} other stops were used to identify)"
    )
    return Guarantee(tried, violated, bound, CONFIDENCE, text, trained)
