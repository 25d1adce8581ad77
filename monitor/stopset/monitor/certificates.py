"""Stop bounds that hold for a box of measured states, kept: an arm that comes by again finds its bound without asking.

What a certificate rests on, the model and the payload, does not change while a daemon uses them; so it does not grow old.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from stopset.core.library import lib, view
from stopset.types import Array

CAPACITY = 2048  # certificates per category: some minutes of motion that never repeats; the oldest goes
MOST_CAPSULES = 200  # of a bound that are kept for pictures (0.15 ms to send); one in more pieces has none, rather than a part

_ANY = view(np.zeros(1))  # the cost of one box is not looked at


@dataclass(frozen=True, slots=True)
class Numbers:
    """One category's bound: per joint (n,) time [s], forward and back [rad], and the flange's travel [m]; inf = not provable."""

    time: Array
    forward: Array
    back: Array
    tcp: float
    provable: NDArray[np.bool_]
    why: str = ""
    margin: float = float("-inf")  # least holding margin [N m]
    capsules: Array | None = None  # (P, 7) [m] both ends and radius: together they contain what the links sweep
    end_stops: tuple[str, ...] = ()  # joints that can strike the end of their range, after which the numbers say nothing
    proven: bool = field(init=False)  # every joint is

    def __post_init__(self) -> None:
        object.__setattr__(self, "proven", bool(self.provable.all()))
        if self.capsules is not None and len(self.capsules) > MOST_CAPSULES:
            object.__setattr__(self, "capsules", None)

    @classmethod
    def none(cls, n: int, why: str, margin: float = float("-inf")) -> Numbers:
        inf = np.full(n, np.inf)
        return cls(inf, inf, inf, float("inf"), np.zeros(n, bool), why, margin)

    @classmethod
    def fallback(cls, n: int, time: float, angle: float, tcp: float) -> Numbers:
        a = np.full(n, angle)
        return cls(np.full(n, time), a, a, tcp, np.zeros(n, bool))


@dataclass(frozen=True, slots=True)
class Certificate:
    """A bound that holds for every measured state with ``lo <= (q, dq) <= hi``, (2n,) each; ``took`` [s] to make, ``cpu`` of it at work."""

    category: str
    lo: Array
    hi: Array
    numbers: Numbers
    took: float
    cpu: float

    def covers(self, x: Array, slack: Array) -> bool:
        """Whether a reading lies inside with all that bus rounding, ``slack`` (2n,), may have hidden; noise is in the bound."""
        return bool(lib.stopset_tightest(1, len(x), view(self.lo), view(self.hi), _ANY, view(x), view(slack)) == 0)


class CommonBox:
    """The box in which all answers in use hold, if they are known; what the core sees of it is pinned, as it is looked at in every cycle.

    ``x``: the reading that is looked up, ``slack``: what bus rounding may have hidden, (2n,) each.
    """

    def __init__(self, slack: Array) -> None:
        self.x, self._box, self._known = np.empty_like(slack), np.empty((2, len(slack))), 0
        self._joints = self.x.reshape(2, -1)
        self._seen = len(slack), view(self._box[0]), view(self._box[1]), _ANY, view(self.x), view(slack)

    def of(self, answers: list[Certificate]) -> None:
        """These are in use."""
        self._box[0], self._box[1] = np.max([a.lo for a in answers], axis=0), np.min([a.hi for a in answers], axis=0)
        self._known = 1

    def forget(self) -> None:
        """Which are in use may have changed."""
        self._known = 0

    def holds(self, q: Array, dq: Array) -> bool:
        """Whether all answers in use hold for this reading, (n,) each, as far as that is known."""
        self._joints[0], self._joints[1] = q, dq
        return bool(lib.stopset_tightest(self._known, *self._seen) == 0)


@dataclass(slots=True)
class Shelf:
    """The certificates of one category for an arm of ``n`` joints."""

    n: int
    capacity: int = CAPACITY
    answers: list[Certificate] = field(default_factory=list)
    _lo: Array = field(init=False)  # (kept, 2n) so are the upper ends; rows beyond `answers` are not looked at
    _hi: Array = field(init=False)
    _cost: Array = field(init=False)  # (kept,) the tightest is taken where several hold
    _oldest: int = 0

    def __post_init__(self) -> None:
        self._lo, self._hi = np.empty((self.capacity, 2 * self.n)), np.empty((self.capacity, 2 * self.n))
        self._cost = np.empty(self.capacity)

    def put(self, answer: Certificate) -> None:
        """Keep a certified answer, in the place of the oldest where there is none left."""
        row = self._oldest
        if len(self.answers) < self.capacity:
            self.answers.append(answer)
        else:
            self.answers[row] = answer
        self._lo[row], self._hi[row] = answer.lo, answer.hi
        self._cost[row] = float(np.sum(answer.numbers.forward + answer.numbers.back))
        self._oldest = (row + 1) % self.capacity

    def best(self, x: Array, slack: Array) -> Certificate | None:
        """The tightest that holds for the reading ``x`` (2n,) with ``slack`` (2n,) either way."""
        count = len(self.answers)
        row = lib.stopset_tightest(count, 2 * self.n, view(self._lo), view(self._hi), view(self._cost), view(x), view(slack))
        return None if row < 0 else self.answers[row]
