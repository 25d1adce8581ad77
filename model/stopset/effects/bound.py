"""What an effect can do to an arm whose drives are off: its own law, evaluated over intervals.

Parameters are intervals (value and standard deviations, within their admissible range), and so are the signals: over what a
stop may reach.  The law is asked for motion forward and backward, with the speed as a `Slope`, and what it answers is told
apart into friction that opposes the motion (dry, and in proportion to speed) and torque of either direction.  So an effect
that nobody foresaw is bounded as any other; one that cannot be is refused by its label (`NotCovered`), never forgotten.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from math import isfinite
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from stopset.effects.base import Effect, Fitted, Shape, Signals, Term
from stopset.effects.memory import affine, whole
from stopset.errors import NotCovered
from stopset.ring import Interval, Slope

Array = NDArray[np.float64]
SIGMAS = 3.0  # identified parameters enter with this many standard deviations
# roles whose law is a torque on the arm, whoever moves it
ACTING = frozenset({"friction", "torque", "arm or drive"})


@dataclass(frozen=True, slots=True)
class Sight:
    """What a law may see of one joint in a stop; None where nothing bounds it.

    ``speed``, ``other`` [rad/s]: the joint and a pair's partner move no faster, ``past``: nor did it before; ``gear`` [N m]: no
    more loads the gear, brake and payload included; the rest as in `Signals`.
    """

    speed: float
    past: float
    gear: float
    q: Interval | None = None
    load: Interval | None = None
    other: float | None = None
    temp: Interval | None = None
    tilt: tuple[Interval, Interval] | None = None
    stiff: Interval | None = None
    inertia: Interval | None = None
    coriolis: Interval | None = None


@dataclass(frozen=True, slots=True)
class Acting:
    """Torque of one effect on one joint, ``way (dry + viscous |dq|) + push``: each (2,) a lower and an upper end [N m, N m s/rad]."""

    dry: Array
    viscous: Array
    push: Array


class _Unbounded:
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


def parameter(f: Fitted, p: Term | Shape) -> Interval:
    """A parameter with its uncertainty, cut at its admissible range; all of that range where the uncertainty has no number."""
    value = float(f.values[p.symbol])
    std = f.std.get(p.symbol)
    spread = 0.0 if std is None else SIGMAS * float(std)
    if not isfinite(spread):
        spread = float("inf")
    lo, hi = max(value - spread, min(p.lo, value)), min(value + spread, max(p.hi, value))
    if not (isfinite(lo) and isfinite(hi)):
        raise NotCovered(f"its {p.symbol} has no bound")
    return Interval(np.array(lo), np.array(hi))


def acting(effect: Effect, f: Fitted, sight: Sight) -> Acting:
    """The effect's torque on the joint seen by ``sight``. Raises `NotCovered` with the effect's label and what it lacks."""
    with _labelled(f):
        plus, minus = (_lines(effect, f, sight, way) for way in (1.0, -1.0))
        rest = None if straight(effect) or effect.role == "friction" else _at_rest(effect, f, sight)
        dry, push = _split(effect, plus[0], minus[0])
        viscous, along = _split(effect, plus[1], minus[1])
        push = push + np.array([min(along[0], 0.0), max(along[1], 0.0)]) * sight.speed
        if rest is not None:
            most = max(dry[1], 0.0)
            push = np.array([min(push[0], rest[0] + most), max(push[1], rest[1] - most)])
        if effect.role == "arm or drive":
            dry, viscous, push = (np.array([min(x[0], 0.0), max(x[1], 0.0)]) for x in (dry, viscous, push))
        out = Acting(dry, viscous, push)
        if not all(np.all(np.isfinite(x)) for x in (dry, viscous, push)):
            raise NotCovered("its torque has no bound")
        return out


def misread(effect: Effect, f: Fitted, q: Interval) -> tuple[Interval, Interval]:
    """True minus recorded position [rad], and speed per speed, of a ``reading`` effect at recorded positions ``q``."""
    with _labelled(f):
        if effect.reading is None:
            raise NotCovered("it does not say by how much the position is misread")
        shapes = {p.symbol: parameter(f, p) for p in effect.shapes}
        values = [parameter(f, t) for t in effect.terms]
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

    def values(way: float) -> Array:
        return np.array([c + np.zeros(20) for c in effect.columns(replace(drawn, way=np.full(20, way)))])

    ends = values(-1.0), values(1.0)
    return all(
        np.allclose(values(w), 0.5 * (1 - w) * ends[0] + 0.5 * (1 + w) * ends[1], rtol=1e-9, atol=1e-9) for w in (-0.5, 0.0, 0.5)
    )


def silent_at_rest(effect: Effect) -> bool:
    """Whether the law is zero where the joint stands and nothing pulls at it, whatever the other signals: as friction's must be."""
    one = Interval(np.array(-3.0), np.array(3.0))
    states = tuple(Interval(np.array(max(x.lo, -3.0)), np.array(min(x.hi, 3.0))) for x in effect.states)
    s = Signals(
        q=one, dq=0.0 * one, way=0.0 * one, ddq=one, load=one, tau=one, dtau=one, link=one, temp=one, warm=one, t=one, stiff=one,
        inertia=Interval(np.array(0.1), np.array(3.0)), coriolis=one, dq_other=one, tip=(one,) * 10, tilt=(one, one), memory=states,
    )  # fmt: skip
    return all(np.max(np.abs([c.lo, c.hi])) < 1e-300 for c in effect.columns(s))


@contextmanager
def _labelled(f: Fitted) -> Iterator[None]:
    """Whatever keeps the law from answering becomes a sentence with the effect's label."""
    try:
        yield
    except Exception as e:  # an effect from outside may fail in any way, and must never be left out for it
        said = str(e) if isinstance(e, NotCovered) else f"its law cannot be evaluated over intervals ({type(e).__name__}: {e})"
        raise NotCovered(uncovered(f, said)) from e


def uncovered(f: Fitted, why: str) -> str:
    """The refusal of an effect that has no bound in a stop."""
    return (
        f"no stop is bounded with {f.label}: {why}; expected every effect of the model to be bounded by its law: "
        "use a revision without it, or count with the arm's whole reach"
    )


def _signals(effect: Effect, sight: Sight, way: float, shapes: Mapping[str, Any]) -> Signals:
    """What the law sees while the joint moves with ``way``."""

    def seen(x: Interval | None, name: str) -> Any:
        return _Unbounded(name) if x is None else Slope.constant(x)

    if effect.role == "friction":
        # which way the gear is loaded cannot be told from gravity while the brakes work (trap P23): both ways, and no load
        tiny = 1e-9 * sight.gear
        load: Interval | None = Interval(np.array([-sight.gear, -tiny, tiny]), np.array([-tiny, tiny, sight.gear]))
    else:
        load = sight.load
    other = None if sight.other is None else Interval(np.array(-sight.other), np.array(sight.other))
    tilt = (_Unbounded("tilt"),) * 2 if sight.tilt is None else tuple(Slope.constant(x) for x in sight.tilt)
    return Signals(
        q=seen(sight.q, "q"), dq=Slope.variable(sight.speed, way), way=Slope.constant(way), ddq=_Unbounded("ddq"),
        load=seen(load, "load"), tau=_Unbounded("tau"), dtau=_Unbounded("dtau"), link=_Unbounded("link"),
        temp=seen(sight.temp, "temp, and no temperature was recorded"), warm=Slope.constant(Interval(np.array(0.0), np.array(1.0))),
        t=_Unbounded("t"), tip=(_Unbounded("tip"),) * 10, tilt=tilt, stiff=seen(sight.stiff, "stiff"),
        inertia=seen(sight.inertia, "inertia"), coriolis=seen(sight.coriolis, "coriolis"), dq_other=seen(other, "dq_other"),
        memory=_memory(effect, shapes, max(sight.speed, sight.past)),
    )  # fmt: skip


def _memory(effect: Effect, shapes: Mapping[str, Any], fastest: float) -> tuple[Slope, ...]:
    """The states, wherever what came before has brought them."""
    if affine(effect):
        ranges = [_whole(effect, tuple((k, float(s.all.lo), float(s.all.hi)) for k, s in shapes.items()), fastest)]
    else:
        ranges = [(x.lo, x.hi) for x in effect.states]
    for state, (lo, hi) in zip(effect.states, ranges, strict=True):
        if not (isfinite(lo) and isfinite(hi)):
            raise NotCovered(f"its state {state.symbol} has no bound")
    return tuple(Slope.constant(Interval(np.array(lo), np.array(hi))) for lo, hi in ranges)


@cache
def _whole(effect: Effect, shapes: tuple[tuple[str, float, float], ...], fastest: float) -> tuple[float, float]:
    return whole(effect, {k: Interval(np.array(lo), np.array(hi)) for k, lo, hi in shapes}, fastest)


def _lines(effect: Effect, f: Fitted, sight: Sight, way: float) -> tuple[Array, Array]:
    """``torque in a + b |dq|`` while moving with ``way``: (2,) ends of ``a`` [N m] and of ``b`` [N m s/rad].

    Each column either keeps its slope or is bounded as a whole, whichever is narrower at full speed.
    """
    shapes = {p.symbol: Slope.constant(parameter(f, p)) for p in effect.shapes}
    columns = effect.columns(_signals(effect, sight, way, shapes), shapes)
    a, b = Interval(np.array(0.0), np.array(0.0)), Interval(np.array(0.0), np.array(0.0))
    for term, number in zip(effect.terms, columns, strict=True):
        c, value = number if isinstance(number, Slope) else Slope.constant(number), parameter(f, term)
        whole_, start = c.all * value, c.start * value
        rate = None if c.rate is None else c.rate * value
        if rate is not None and np.max(rate.width) * sight.speed <= np.max(whole_.width) * (1.0 + 1e-9):
            a, b = a + start, b + rate
        else:
            a = a + whole_
    return np.array([np.min(a.lo), np.max(a.hi)]), np.array([np.min(b.lo), np.max(b.hi)])


def _at_rest(effect: Effect, f: Fitted, sight: Sight) -> Array:
    """(2,) all torque of the law where the joint stands, whatever direction its friction takes [N m]."""
    shapes = {p.symbol: Slope.constant(parameter(f, p)) for p in effect.shapes}
    s = _signals(effect, sight, 1.0, shapes)
    any_way = Slope.constant(Interval(np.array(-1.0), np.array(1.0)))
    columns = effect.columns(replace(s, dq=Slope.constant(0.0), way=any_way), shapes)
    total = _sum([c.all if isinstance(c, Slope) else c for c in columns], [parameter(f, t) for t in effect.terms])
    return np.array([np.min(total.lo), np.max(total.hi)])


def _split(effect: Effect, plus: Array, minus: Array) -> tuple[Array, Array]:
    """Torques forward and backward, (2,) ends each, as ``way * odd + even``: what opposes the motion, and what does not."""
    if effect.role == "friction":
        return np.array([min(plus[0], -minus[1]), max(plus[1], -minus[0])]), np.zeros(2)
    ahead, back = 0.5 * (plus[0] + plus[1]), 0.5 * (minus[0] + minus[1])
    radius = max(plus[1] - ahead, ahead - plus[0], minus[1] - back, back - minus[0])
    odd, even = 0.5 * (ahead - back), 0.5 * (ahead + back)
    # what is not known goes to what opposes the motion as long as it then still does: the rest may push
    rubs = min(radius, abs(odd))
    pushes = radius - rubs
    slack = 4e-16 * (abs(ahead) + abs(back) + radius)  # of rounding in this function
    return np.array([odd - rubs - slack, odd + rubs + slack]), np.array([even - pushes - slack, even + pushes + slack])


def _sum(columns: Any, values: list[Interval]) -> Interval:
    out = Interval(np.array(0.0), np.array(0.0))
    for c, value in zip(columns, values, strict=True):
        out = out + value * c
    return out
