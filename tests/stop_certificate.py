"""A bound for a fast loop, that of the monitor is held against: made once for a box of states, evaluated in microseconds.

A certificate is the tube of the box with the accelerations it was verified for.  Every motion from a state in the box
obeys them, so from that state the one-sided comparison gives tighter curves: a closed form per joint, cut at the knots by
the certified tube.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stop_tubes import tube_of
from stopset.core.library import ffi, given, lib, view
from stopset.errors import NotCovered
from stopset.reach.stops import StopBounds
from stopset.reach.stops.setting import beyond_domain
from stopset.reach.stops.tube import OK, Tube
from stopset.reach.stops.tubes import FAST_KNOTS
from stopset.sets import Box
from stopset.types import Array


def follow(tube: Tube, low: Array, high: Array) -> Array:
    """Curves from speeds ``[low, high]`` (n,) under the tube's certified rates; (4, n): time, forward, back, speed."""
    out, steps = np.empty((4, len(low))), len(tube.forward_lo)
    rates = [given(x) for x in (tube.forward_lo, tube.forward_hi, tube.backward_lo, tube.backward_hi)]
    held = [given(x) for x in (tube.t, tube.v_lo, tube.v_hi, low, high)]
    t, v_lo, v_hi, lo, hi = (view(x) for x in held)
    struct = ffi.new("StopsetTube *", {"t": t, "v_lo": v_lo, "v_hi": v_hi, "rates": [view(x) for x in rates]})
    lib.stopset_follow(struct, len(low), steps, lo, hi, view(out))
    return out


@dataclass(frozen=True, slots=True)
class Certificate:
    """A verified tube for all measured states in the box ``q +- q_radius, dq +- dq_radius``.

    ``start``: (2n,) what the stop starts from, less the measured state; it is in the tube on top of the box.
    """

    tube: Tube
    q: Array
    dq: Array
    q_radius: Array
    dq_radius: Array
    start: Box

    def covers(self, q: Array, dq: Array) -> bool:
        """Whether a measured state lies in the box."""
        return bool(np.all(np.abs(q - self.q) <= self.q_radius) and np.all(np.abs(dq - self.dq) <= self.dq_radius))

    def bound(self, q: Array, dq: Array) -> Array:
        """(4, n): stop time [s], angle forward and back [rad], largest speed [rad/s] from a measured state in the box.

        Raises `NotCovered` for a state outside: certify a new box.
        """
        if not self.covers(q, dq):
            raise NotCovered("the state has left the certified box; expected one inside: certify a new box around it")
        n = len(q)
        return follow(self.tube, dq + self.start.lo[n:], dq + self.start.hi[n:])


def certify(bounds: StopBounds, q: Array, dq: Array, q_radius: Array, dq_radius: Array) -> Certificate | None:
    """A certificate for STOP 0 on a box of measured states; None if one tube does not come to rest, or outside the model's domain.

    ``q_radius`` [rad], ``dq_radius`` [rad/s]: (n,) half-widths for the state to move in.
    """
    if bounds.setting is None or beyond_domain(bounds.model, q, dq, q_radius, dq_radius):
        return None
    n, start = bounds.model.n, bounds.setting.start
    tube = tube_of(
        bounds.setting, q + start.centre[:n], dq + start.centre[n:], q_radius + start.radius[:n], dq_radius + start.radius[n:],
        knots=FAST_KNOTS,
    )  # fmt: skip
    return Certificate(tube, q, dq, q_radius, dq_radius, start) if tube.end == OK else None
