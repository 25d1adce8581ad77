"""The bound for a fast loop: a certificate made once for a box of states, evaluated in some ten microseconds inside it.

A certificate is the tube of the box with the accelerations it was verified for.  Every motion from a state in the box
obeys them, so from that state the one-sided comparison gives tighter curves: a closed form per joint, cut at the knots by
the certified tube.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stopset.errors import NotCovered
from stopset.reach.stops.tube import Tube
from stopset.sets import Box

Array = NDArray[np.float64]


@njit(cache=True)
def follow(
    t: Array, v_lo: Array, v_hi: Array, forward_lo: Array, forward_hi: Array, backward_lo: Array, backward_hi: Array,
    low: Array, high: Array, out: Array,
) -> None:  # fmt: skip
    """Curves from speeds ``[low, high]`` (n,) under certified rates (K, n); ``out`` (4, n): time, forward, back, speed."""
    K, n = forward_lo.shape
    h = t[1] - t[0]
    for i in range(n):
        U, L = high[i], low[i]
        ahead, behind, far, back, fast = 0.0, 0.0, 0.0, 0.0, max(abs(U), abs(L))
        last = 0
        for k in range(K):
            if U > 0.0:
                up = U + h * forward_hi[k, i]
                up = max(up, 0.0) if v_lo[k, i] <= 0.0 or up > 0.0 else v_hi[k + 1, i]
            elif U == 0.0:
                up = h * max(0.0, forward_hi[k, i])
            else:
                up = U + h * backward_hi[k, i]
                if up >= 0.0:
                    up = h * max(0.0, forward_hi[k, i])
            if L < 0.0:
                down = L + h * backward_lo[k, i]
                down = min(down, 0.0) if v_hi[k, i] >= 0.0 or down < 0.0 else v_lo[k + 1, i]
            elif L == 0.0:
                down = h * min(0.0, backward_lo[k, i])
            else:
                down = L + h * forward_lo[k, i]
                if down <= 0.0:
                    down = h * min(0.0, backward_lo[k, i])
            # rates of a direction the whole box cannot take are infinite; the tube itself bounds those steps
            if not up < np.inf:
                up = max(v_hi[k, i], v_hi[k + 1, i])
            if not down > -np.inf:
                down = min(v_lo[k, i], v_lo[k + 1, i])
            ahead += h * (max(up, 0.0) if U < 0.0 and up >= 0.0 else 0.5 * (U + up))
            behind += h * (min(down, 0.0) if L > 0.0 and down <= 0.0 else 0.5 * (L + down))
            far, back = max(far, ahead), max(back, -behind)
            U, L = min(up, v_hi[k + 1, i]), max(down, v_lo[k + 1, i])
            fast = max(fast, max(abs(up), abs(down)))
            if U != 0.0 or L != 0.0:
                last = k + 2
        out[0, i], out[1, i], out[2, i], out[3, i] = t[min(last, K)], far, back, fast


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
        out = np.empty((4, n))
        t = self.tube
        follow(
            t.t, t.v_lo, t.v_hi, t.forward_lo, t.forward_hi, t.backward_lo, t.backward_hi,
            dq + self.start.lo[n:], dq + self.start.hi[n:], out,
        )  # fmt: skip
        return out
