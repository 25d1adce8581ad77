"""What a certified box says of a state inside it, written plainly: bounds of the monitor, which keeps boxes alone, are held against it.

A certificate is the tube of the box with the accelerations it was verified for.  Every motion from a state in the box
obeys them, so from that state the one-sided comparison gives tighter curves: a closed form per joint, cut at the knots by
the certified tube.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stop_tubes import tube_of
from stopset.errors import NotCovered
from stopset.reach.stops import StopBounds
from stopset.reach.stops.setting import beyond_domain
from stopset.reach.stops.tube import OK, Tube
from stopset.reach.stops.tubes import FAST_KNOTS
from stopset.sets import Box
from stopset.types import Array


def follow(tube: Tube, low: Array, high: Array) -> Array:
    """Curves from speeds ``[low, high]`` (n,) under the tube's certified rates; (4, n): time, forward, back, speed.

    Lower ones are upper ones of the mirrored tube.
    """
    up = _upper(tube.t, high, tube.forward_hi, tube.backward_hi, tube.v_lo, tube.v_hi)
    down = _upper(tube.t, -low, -tube.backward_lo, -tube.forward_lo, -tube.v_hi, -tube.v_lo)
    return np.array([tube.t[np.maximum(up[0], down[0])], up[1], down[1], np.maximum(up[2], down[2])])


def _upper(
    t: Array, speed: Array, forward: Array, backward: Array, v_lo: Array, v_hi: Array
) -> tuple[NDArray[np.int_], Array, Array]:
    """Of the upper curves from ``speed`` (n,): the first knot at which they are at rest for good, how far, how fast in size."""
    U, K = speed, len(forward)
    travel, far, fast, last = np.zeros_like(U), np.zeros_like(U), np.abs(U), np.zeros(len(U), int)
    with np.errstate(invalid="ignore"):
        for k, h in enumerate(np.diff(t)):
            moving = U + h * forward[k]
            ahead = np.where((v_lo[k] <= 0.0) | (moving > 0.0), np.maximum(moving, 0.0), v_hi[k + 1])
            back = np.where(U == 0.0, 0.0, U + h * backward[k])
            new = np.where(U > 0.0, ahead, np.where(back >= 0.0, h * np.maximum(0.0, forward[k]), back))
            # rates of a direction the whole box cannot take are infinite; the tube itself bounds those steps
            new = np.where(new < np.inf, new, np.maximum(v_hi[k], v_hi[k + 1]))
            travel = travel + h * np.where((U < 0.0) & (new >= 0.0), new, 0.5 * (U + new))
            far, fast = np.maximum(far, travel), np.maximum(fast, np.abs(new))
            U = np.minimum(new, v_hi[k + 1])
            last = np.where(U != 0.0, k + 2, last)
    return np.minimum(last, K), far, fast


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
