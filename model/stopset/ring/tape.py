"""Tape: the same law as a list of elementary steps, which the compiled core plays for any numbers.

So no compiler is needed where a law is registered or used: monitor, identification and FMU play the same steps with the same
functions, one rounding each, in the order in which the law writes them.  A step that was written before is not written twice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

STEPS = 256  # of one law at most, as many as the core keeps
# in the order of the core's `enum` in law.h; a POWER's second argument is its exponent
CONSTANT, SIGNAL, ADD, SUB, MUL, DIV, NEG, ABSOLUTE, SIGN, SQUARE, SQRT, SIN, COS, EXP, TANH, MINIMUM, MAXIMUM, POWER = range(18)
BINARY = frozenset({ADD, SUB, MUL, DIV, MINIMUM, MAXIMUM})  # of two earlier steps; the others but the first two of one


@dataclass(slots=True)
class Tape:
    """Steps ``(what, first, second)`` and constants; `signal` and `constant` begin a law, its operators go on from there."""

    steps: list[tuple[int, int, int]] = field(default_factory=list)
    numbers: list[float] = field(default_factory=list)
    _shared: dict[tuple[float, bool], int] = field(default_factory=dict)  # constants that the law itself writes
    _place: dict[tuple[int, int, int], int] = field(default_factory=dict)

    def step(self, what: int, first: int, second: int = 0) -> Played:
        """A step, or the place where it already is; raises `ValueError` where a law is too long."""
        key = (what, first, second)
        if key not in self._place:
            if len(self.steps) == STEPS:
                raise ValueError(f"a law takes more than {STEPS} elementary steps; expected fewer: write it more shortly")
            self._place[key] = len(self.steps)
            self.steps.append(key)
        return Played(self, self._place[key])

    def constant(self, x: float) -> Played:
        """A number of the law."""
        if x != x:
            raise ValueError("a law holds a constant that is not a number; expected a finite one")
        key = (x, bool(np.signbit(x)))
        if key not in self._shared:
            self._shared[key] = len(self.numbers)
            self.numbers.append(x)
        return self.step(CONSTANT, self._shared[key])

    def parameter(self, x: float) -> Played:
        """A number with a place of its own among the constants, so that who plays the law may put another one there."""
        self.numbers.append(x)
        return self.step(CONSTANT, len(self.numbers) - 1)

    def signal(self, k: int) -> Played:
        """What the law looks at: signal number ``k``."""
        return self.step(SIGNAL, k)

    def finished(self, result: Any) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
        """Steps (K, 3) of which the last one gives ``result``, none of them without use, and the constants."""
        last = result if isinstance(result, Played) else self.constant(float(result))
        steps, _ = needed(self.steps, [last.at])
        return np.array(steps, np.int32).reshape(-1, 3), np.array(self.numbers or [0.0], float)


def needed(steps: Sequence[tuple[int, int, int]], at: Sequence[int]) -> tuple[list[tuple[int, int, int]], list[int]]:
    """Only the steps that ``at`` rest on, and where these are then."""

    def arguments(step: tuple[int, int, int]) -> tuple[int, ...]:
        what, first, second = step
        return () if what in (CONSTANT, SIGNAL) else (first, second) if what in BINARY else (first,)

    wanted, todo = set(), list(at)
    while todo:
        k = todo.pop()
        if k not in wanted:
            wanted.add(k)
            todo += arguments(steps[k])
    place = {k: i for i, k in enumerate(sorted(wanted))}
    out = []
    for k in sorted(wanted):
        what, first, second = steps[k]
        if what not in (CONSTANT, SIGNAL):
            first, second = place[first], place[second] if what in BINARY else second
        out.append((what, first, second))
    return out, [place[k] for k in at]


@dataclass(frozen=True, slots=True)
class Played:
    """A number on a tape: the result of its step ``at``."""

    tape: Tape
    at: int
    __array_ufunc__ = None

    def _of(self, other: Any) -> int:
        return other.at if isinstance(other, Played) else self.tape.constant(float(other)).at

    def _two(self, what: int, other: Any, *, swap: bool = False) -> Played:
        a, b = self.at, self._of(other)
        return self.tape.step(what, *((b, a) if swap else (a, b)))

    def __add__(self, other: Any) -> Played:
        return self._two(ADD, other)

    def __radd__(self, other: Any) -> Played:
        return self._two(ADD, other, swap=True)

    def __sub__(self, other: Any) -> Played:
        return self._two(SUB, other)

    def __rsub__(self, other: Any) -> Played:
        return self._two(SUB, other, swap=True)

    def __mul__(self, other: Any) -> Played:
        return self._two(MUL, other)

    def __rmul__(self, other: Any) -> Played:
        return self._two(MUL, other, swap=True)

    def __truediv__(self, other: Any) -> Played:
        return self._two(DIV, other)

    def __rtruediv__(self, other: Any) -> Played:
        return self._two(DIV, other, swap=True)

    def __neg__(self) -> Played:
        return self.tape.step(NEG, self.at)

    def __pow__(self, n: int) -> Played:
        if not isinstance(n, int) or n < 0:
            raise ValueError(f"power {n!r} in a law; expected an integer >= 0")
        if n < 2:
            return self if n else self.tape.constant(1.0)
        return self.tape.step(POWER, self.at, n)

    def sin(self) -> Played:
        """Sine."""
        return self.tape.step(SIN, self.at)

    def cos(self) -> Played:
        """Cosine."""
        return self.tape.step(COS, self.at)

    def exp(self) -> Played:
        """Exponential."""
        return self.tape.step(EXP, self.at)

    def tanh(self) -> Played:
        """Hyperbolic tangent."""
        return self.tape.step(TANH, self.at)

    def sqrt(self) -> Played:
        """Square root."""
        return self.tape.step(SQRT, self.at)

    def absolute(self) -> Played:
        """Magnitude."""
        return self.tape.step(ABSOLUTE, self.at)

    def sign(self) -> Played:
        """-1, 0 or 1."""
        return self.tape.step(SIGN, self.at)

    def square(self) -> Played:
        """Times itself."""
        return self.tape.step(SQUARE, self.at)

    def minimum(self, other: Any) -> Played:
        """The smaller of two."""
        return self._two(MINIMUM, other)

    def maximum(self, other: Any) -> Played:
        """The larger of two."""
        return self._two(MAXIMUM, other)
