"""What an effect can do to an arm whose drives are off: its own law, evaluated over intervals.

Parameters are intervals (value and standard deviations, within their admissible range), and so are the signals: over what a
stop may reach.  The core (``core/stops/laws.c``) asks the law for motion forward and backward, for what it gives at rest and how it
grows with the speed, and what it answers is told apart into friction that opposes the motion (dry, and in proportion to speed)
and torque of either direction.  So an effect that nobody foresaw is bounded as any other; one that cannot be is refused by its
label (`NotCovered`), never forgotten.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from typing import Any, NoReturn

import numpy as np

from stopset.effects.base import Effect, Fitted, Shape, Signals, Term
from stopset.errors import NotCovered
from stopset.ring import Interval
from stopset.types import Array

SIGMAS = 3.0  # identified parameters enter with this many standard deviations
# roles whose law is a torque on the arm, whoever moves it
ACTING = frozenset({"friction", "torque", "arm or drive"})


class Unbounded:
    """A signal that nothing bounds in a stop: whoever computes with it hears so."""

    __slots__ = ("name",)
    __array_ufunc__ = None

    def __init__(self, name: str) -> None:
        self.name = name

    def _refuse(self, *_: Any) -> NoReturn:
        raise NotCovered(f"it looks at {self.name}, which nothing bounds in a stop")

    __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = __truediv__ = __rtruediv__ = __pow__ = __neg__ = _refuse
    __lt__ = __gt__ = __le__ = __ge__ = __bool__ = __float__ = __abs__ = _refuse
    sin = cos = exp = tanh = sqrt = absolute = sign = square = minimum = maximum = _refuse


def parameter(fitted: Sequence[Fitted], p: Term | Shape) -> Interval:
    """A parameter with its uncertainty, cut at its admissible range, (m,); all of that range where the uncertainty is no number.

    A value beyond that range, of an older model, shows that the range is none there: its uncertainty is not cut.
    """
    value = np.array([float(f.values[p.symbol]) for f in fitted])
    spread = SIGMAS * np.array([float(f.std.get(p.symbol) or 0.0) for f in fitted])
    spread = np.where(np.isfinite(spread), spread, np.inf)
    lo = np.where(value < p.lo, value - spread, np.maximum(value - spread, p.lo))
    hi = np.where(value > p.hi, value + spread, np.minimum(value + spread, p.hi))
    if not (np.all(np.isfinite(lo)) and np.all(np.isfinite(hi))):
        raise NotCovered(f"its {p.symbol} has no bound")
    return Interval(lo, hi)


def misread(effect: Effect, f: Fitted, q: Interval) -> tuple[Interval, Interval]:
    """True minus recorded position [rad], and speed per speed, of a ``reading`` effect at recorded positions ``q``."""
    with labelled(f.label):
        if effect.reading is None:
            raise NotCovered("it does not say by how much the position is misread")
        shapes = {p.symbol: parameter([f], p) for p in effect.shapes}
        values = [parameter([f], t) for t in effect.terms]
        position, speed = effect.reading(Signals(q=q), shapes)
        return _sum(position, values), _sum(speed, values)


@cache
def straight(effect: Effect) -> bool:
    """Whether at rest the law is a straight line over the direction that friction takes, tried at random signals.

    Then what it can give at rest lies between what it gives in both directions; else rest has to be looked at by itself.
    """
    rng = np.random.default_rng(0)

    def draw(*shape: int) -> Array:
        return rng.uniform(-2.0, 2.0, (*shape, 20))

    drawn = Signals(
        q=draw(), load=draw(), tau=draw(), dtau=draw(), link=draw(), temp=draw(), warm=draw(), t=draw(), stiff=draw(),
        inertia=np.abs(draw()) + 0.1, coriolis=draw(), dq_other=draw(), ddq=draw(), dq=np.zeros(20),
        tip=tuple(draw(10)), tilt=tuple(draw(2)), memory=tuple(draw(len(effect.states))),
    )  # fmt: skip

    def values(direction: float) -> Array:
        return np.array([c + np.zeros(20) for c in effect.columns(replace(drawn, given_direction=np.full(20, direction)))])

    ends = values(-1.0), values(1.0)
    return all(
        np.allclose(values(w), 0.5 * (1 - w) * ends[0] + 0.5 * (1 + w) * ends[1], rtol=1e-9, atol=1e-9) for w in (-0.5, 0.0, 0.5)
    )


def silent_at_rest(effect: Effect) -> bool:
    """Whether the law is zero where the joint stands and nothing pulls at it, whatever the other signals: as friction's must be."""
    one = Interval(np.array(-3.0), np.array(3.0))
    states = tuple(Interval(np.array(max(x.lo, -3.0)), np.array(min(x.hi, 3.0))) for x in effect.states)
    s = Signals(
        q=one, dq=0.0 * one, given_direction=0.0 * one, ddq=one, load=one, tau=one, dtau=one, link=one, temp=one, warm=one, t=one, stiff=one,
        inertia=Interval(np.array(0.1), np.array(3.0)), coriolis=one, dq_other=one, tip=(one,) * 10, tilt=(one, one), memory=states,
    )  # fmt: skip
    return all(np.max(np.abs([c.lo, c.hi])) < 1e-300 for c in effect.columns(s))


@contextmanager
def labelled(label: str) -> Iterator[None]:
    """Whatever keeps the law from answering becomes a sentence with the effect's label."""
    try:
        yield
    except Exception as e:  # an effect from outside may fail in any way, and must never be left out for it
        said = str(e) if isinstance(e, NotCovered) else f"its law cannot be evaluated over intervals ({type(e).__name__}: {e})"
        raise NotCovered(uncovered(label, said)) from e


def uncovered(label: str, why: str) -> str:
    """The refusal of an effect that has no bound in a stop."""
    return (
        f"no stop is bounded with {label}: {why}; expected every effect of the model to be bounded by its law: "
        "use a revision without it, or count with the arm's whole reach"
    )


def _sum(columns: Sequence[Any], values: Sequence[Interval]) -> Interval:
    out = Interval(np.array(0.0), np.array(0.0))
    for c, value in zip(columns, values, strict=True):
        out = out + value * c
    return out
