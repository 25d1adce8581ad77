"""Whether a trial repeats another one: what its number says of that is not relied on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from stopset.types import Array

# in which arms move under power, best first: open loop lets the states diverge as a prediction does; poses, and stops, repeat by their numbers
POWERED = ("open_loop", "closed_loop")
COMPARED = 512  # samples of a trial that are compared
# of its own size by which a motion differs from another one's: two that have nothing in common by 1.4; of the 28 labelled sets repetitions
# by 0.31 at most, as friction falls while drives warm up, and other motions of one suite by 0.73 at least
ANOTHER = 0.5
MOVES = 0.02  # [rad] what moves less repeats whatever it is said to


@dataclass(frozen=True, slots=True)
class Motion:
    """At most `COMPARED` samples of a trial: ``t`` (k,) [s] from its beginning, ``q``, ``tau`` (k, n) [rad, N m]."""

    t: Array
    q: Array
    tau: Array

    @classmethod
    def of(cls, t: Array, q: Array, tau: Array) -> Self:
        """That of a trial's ``t`` (N,) and its ``q, tau`` (N, n)."""
        at = slice(None, None, -(-len(t) // COMPARED))
        return cls(t[at] - t[0], q[at], tau[at])

    def repeated_by(self, other: Motion) -> bool:
        """Whether torques or angles go as here over the time that both last: open-loop trials share torques (Liu & Althoff 2018,
        def. 2), and their angles diverge; under a controller it is the angles, and friction may have changed."""
        still = max(np.ptp(self.q, axis=0).max(), np.ptp(other.q, axis=0).max()) < MOVES
        return bool(still or self.difference(other) <= ANOTHER)

    def difference(self, other: Motion) -> float:
        """By how much of its own size [1] the torque or the angle, the nearer of the two, differs over the time that both last."""
        t = self.t[self.t <= other.t[-1]]
        return min(_difference(a[: len(t)], _at(t, other.t, b)) for a, b in ((self.tau, other.tau), (self.q, other.q)))


def _at(t: Array, stamps: Array, x: Array) -> Array:
    return np.column_stack([np.interp(t, stamps, c) for c in x.T])


def _difference(a: Array, b: Array) -> float:
    """Difference of two signals (k, n) over what they vary, root mean square, all joints together; 0 of two that are the same."""
    size, off = 0.5 * float(a.var(axis=0).sum() + b.var(axis=0).sum()), float(((a - b) ** 2).mean(axis=0).sum())
    return 0.0 if off == 0.0 else float(np.sqrt(off / max(size, 1e-300)))
