"""An effect in a stop over intervals once more, in numpy: what the core's bounds of laws are held against.

A second writing of `stopset.reach.stops.laws` and the core's ``stops/laws.c``, over whole arrays of joints, with numpy's functions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from typing import Any

import numpy as np

from slopes import Slope
from stopset.effects.base import Effect, Fitted, Signals
from stopset.effects.bound import Unbounded, labelled, parameter, straight
from stopset.effects.memory import affine, whole
from stopset.errors import NotCovered
from stopset.ring import Interval
from stopset.types import Array


@dataclass(frozen=True, slots=True)
class Sight:
    """What a law may see in a stop of several joints side by side, (m,) each; None where nothing bounds it.

    ``speed``, ``other`` [rad/s]: the joint and a pair's partner move no faster, ``past``: nor did it before; ``gear`` [N m]: no
    more loads the gear, brake and payload included; the rest as in `Signals`.
    """

    speed: Array
    past: Array
    gear: Array
    q: Interval | None = None
    load: Interval | None = None
    other: Array | None = None
    temp: Interval | None = None
    tilt: tuple[Interval, ...] | None = None
    stiff: Interval | None = None
    inertia: Interval | None = None
    coriolis: Interval | None = None

    def at(self, joints: Sequence[int]) -> Sight:
        """Of some of the joints."""
        k = list(joints)

        def of(x: Any) -> Any:
            if isinstance(x, Interval):
                return Interval(x.lo[k], x.hi[k])
            return tuple(of(y) for y in x) if isinstance(x, tuple) else None if x is None else x[k]

        return Sight(*(of(getattr(self, f.name)) for f in fields(self)))


@dataclass(frozen=True, slots=True)
class Acting:
    """Torque of an effect on ``m`` joints, ``direction (dry + viscous |dq|) + push``: each (m, 2) lower and upper ends [N m, N m s/rad]."""

    dry: Array
    viscous: Array
    push: Array


def acting(effect: Effect, fitted: Sequence[Fitted], sight: Sight) -> Acting:
    """The torque of one effect, fitted ``m`` times, on the ``m`` joints of ``sight``.

    Raises `NotCovered` with the effect's labels and what it lacks.
    """
    with labelled(", ".join(f.label for f in fitted)):
        value, shape = _parameters(effect, fitted)
        torque = _lines(effect, value, shape, sight)
        dry, push = _split(effect, *torque[0])
        viscous, along = _split(effect, *torque[1])
        push = push + np.clip(along, [-np.inf, 0.0], [0.0, np.inf]) * sight.speed[:, None]
        if not (straight(effect) or effect.role == "friction"):
            rest, most = _at_rest(effect, value, shape, sight), np.maximum(dry[:, 1], 0.0)
            push = np.column_stack([np.minimum(push[:, 0], rest[:, 0] + most), np.maximum(push[:, 1], rest[:, 1] - most)])
        if effect.role == "arm or drive":
            dry, viscous, push = (
                np.column_stack([np.minimum(x[:, 0], 0.0), np.maximum(x[:, 1], 0.0)]) for x in (dry, viscous, push)
            )
        if not all(np.all(np.isfinite(x)) for x in (dry, viscous, push)):
            raise NotCovered("its torque has no bound")
        return Acting(dry, viscous, push)


def _parameters(effect: Effect, fitted: Sequence[Fitted]) -> tuple[list[Interval], dict[str, Interval]]:
    """Of all terms in order, and of all shapes by symbol, (m, 1) each."""
    terms = [_column(parameter(fitted, t)) for t in effect.terms]
    return terms, {p.symbol: _column(parameter(fitted, p)) for p in effect.shapes}


def _column(x: Interval) -> Interval:
    return Interval(x.lo[:, None], x.hi[:, None])


def _signals(effect: Effect, sight: Sight, shapes: Mapping[str, Interval]) -> Signals:
    """What the law sees, (2, m, pieces): moving forward, moving backward; pieces of the load where it matters."""

    def seen(x: Interval | None, name: str) -> Any:
        return Unbounded(name) if x is None else Slope.constant(_column(x))

    if effect.role == "friction":
        # which way the gear is loaded cannot be told from gravity while the brakes work (trap P23): both ways, and no load
        ends = sight.gear[:, None] * np.array([-1.0, -1e-9, 1e-9, 1.0])
        load: Any = Slope.constant(Interval(ends[:, :3], ends[:, 1:]))
    else:
        load = seen(sight.load, "load")
    direction = np.array([1.0, -1.0])[:, None, None]
    other = None if sight.other is None else Interval(-sight.other, sight.other)
    tilt = (Unbounded("tilt"),) * 2 if sight.tilt is None else tuple(seen(x, "tilt") for x in sight.tilt)
    # a signal that nothing here bounds is never taken for zero: who looks at it is refused
    every: dict[str, Any] = {f.name: Unbounded(f.name) for f in fields(Signals)}
    bounded = {
        "q": seen(sight.q, "q"), "dq": Slope.variable(sight.speed[:, None], direction), "given_direction": Slope.constant(direction), "load": load,
        "temp": seen(sight.temp, "temp, and no temperature was recorded"), "stiff": seen(sight.stiff, "stiff"),
        "warm": Slope.constant(Interval(np.array(0.0), np.array(1.0))), "tip": (Unbounded("tip"),) * 10, "tilt": tilt,
        "inertia": seen(sight.inertia, "inertia"), "coriolis": seen(sight.coriolis, "coriolis"), "dq_other": seen(other, "dq_other"),
        "memory": _memory(effect, shapes, np.maximum(sight.speed, sight.past)),
    }  # fmt: skip
    return Signals(**(every | bounded))


def _memory(effect: Effect, shapes: Mapping[str, Interval], fastest: Array) -> tuple[Slope, ...]:
    """The states, wherever what came before has brought them."""
    out = []
    for state in effect.states:
        lo, hi = np.full(len(fastest), state.lo), np.full(len(fastest), state.hi)
        if affine(effect):
            for i, v in enumerate(fastest):
                mine = tuple((k, float(s.lo[i, 0]), float(s.hi[i, 0])) for k, s in shapes.items())
                lo[i], hi[i] = _whole(effect, mine, float(v))
        if not (np.all(np.isfinite(lo)) and np.all(np.isfinite(hi))):
            raise NotCovered(f"its state {state.symbol} has no bound")
        out.append(Slope.constant(_column(Interval(lo, hi))))
    return tuple(out)


@cache
def _whole(effect: Effect, shapes: tuple[tuple[str, float, float], ...], fastest: float) -> tuple[float, float]:
    return whole(effect, {k: Interval(np.array(lo), np.array(hi)) for k, lo, hi in shapes}, fastest)


def _lines(effect: Effect, values: Sequence[Interval], shapes: Mapping[str, Interval], sight: Sight) -> tuple[Array, Array]:
    """``torque in a + b |dq|``: ``a`` [N m] and ``b`` [N m s/rad], (2, m, 2) each: way, joint, ends.

    Each column either keeps its slope or is bounded as a whole, whichever is narrower at full speed.
    """
    columns = effect.columns(_signals(effect, sight, shapes), {k: Slope.constant(x) for k, x in shapes.items()})
    a = b = Interval(np.zeros((2, len(sight.speed), 1)), np.zeros((2, len(sight.speed), 1)))
    for value, number in zip(values, columns, strict=True):
        c = number if isinstance(number, Slope) else Slope.constant(number)
        all_, start = c.all * value, c.start * value
        if c.rate is None:
            a = a + all_
            continue
        rate = c.rate * value
        steady = np.all(rate.width * sight.speed[:, None] <= all_.width * (1.0 + 1e-9), axis=(0, -1), keepdims=True)
        a = a + Interval(np.where(steady, start.lo, all_.lo), np.where(steady, start.hi, all_.hi))
        b = b + Interval(np.where(steady, rate.lo, 0.0), np.where(steady, rate.hi, 0.0))
    return _hulls(a), _hulls(b)


def _hulls(x: Interval) -> Array:
    """Over the pieces, ends last."""
    return np.stack([x.lo.min(axis=-1), x.hi.max(axis=-1)], axis=-1)


def _at_rest(effect: Effect, values: Sequence[Interval], shapes: Mapping[str, Interval], sight: Sight) -> Array:
    """(m, 2) all torque of the law where the joint stands, whatever direction its friction takes [N m]."""
    s = _signals(effect, sight, shapes)
    any_direction = Slope.constant(Interval(np.array(-1.0), np.array(1.0)))
    columns = effect.columns(
        replace(s, dq=Slope.constant(0.0), given_direction=any_direction), {k: Slope.constant(x) for k, x in shapes.items()}
    )
    total = _sum([c.all if isinstance(c, Slope) else c for c in columns], values)
    return _hulls(Interval(*(x + np.zeros((len(sight.speed), 1)) for x in (total.lo, total.hi))))


def _split(effect: Effect, plus: Array, minus: Array) -> tuple[Array, Array]:
    """Torques forward and backward, (m, 2) ends each, as ``direction * odd + even``: what opposes the motion, and what does not."""
    if effect.role == "friction":
        odd = np.column_stack([np.minimum(plus[:, 0], -minus[:, 1]), np.maximum(plus[:, 1], -minus[:, 0])])
        return odd, np.zeros_like(odd)
    ahead, back = plus.mean(axis=1), minus.mean(axis=1)
    radius = np.max([plus[:, 1] - ahead, ahead - plus[:, 0], minus[:, 1] - back, back - minus[:, 0]], axis=0)
    rubs, pushes = 0.5 * (ahead - back), 0.5 * (ahead + back)
    # what is not known goes to what opposes the motion as long as it then still does: the rest may push
    unsure = np.minimum(radius, np.abs(rubs))
    slack = 4e-16 * (np.abs(ahead) + np.abs(back) + radius)  # of rounding in this function
    halves = unsure + slack, radius - unsure + slack
    odd, even = (np.column_stack([x - half, x + half]) for x, half in zip((rubs, pushes), halves, strict=True))
    return odd, even


def _sum(columns: Sequence[Any], values: Sequence[Interval]) -> Interval:
    out = Interval(np.array(0.0), np.array(0.0))
    for c, value in zip(columns, values, strict=True):
        out = out + value * c
    return out
