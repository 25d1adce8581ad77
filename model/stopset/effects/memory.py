"""States of laws with memory along samples, the signals held over each step as a recording holds them.

Identification, diagnosis, monitor and FMU all step states by this rule (trap P18).  A single state whose flow is affine in
it, ``dz/dt = b + a z``, is stepped exactly: friction that builds up over a way, a drive that warms.  The step then keeps the
order of two states, so the ends of an interval enclose all states in between, and the middle stays the middle.  So what was
identified from one start holds for a monitor that does not know the start and carries both ends.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stopset.core.library import flags, given, lib, view
from stopset.effects.base import Effect, Number, Signals
from stopset.ring import Interval
from stopset.types import Array, Mask


@cache
def affine(effect: Effect) -> bool:
    """Whether the effect has one state, and its flow and its columns are affine in it, tried at random signals."""
    if len(effect.states) != 1:
        return False
    rng = np.random.default_rng(0)
    z = effect.states[0]
    left_out = ("memory", "tip", "tilt", "given_direction")
    drawn: dict[str, Any] = {f.name: rng.uniform(-2.0, 2.0, 20) for f in fields(Signals) if f.name not in left_out}
    lo, hi = (float(np.clip(x, z.lo, z.hi)) for x in (-1.0, 1.0))

    def values(x: float) -> Array:
        s = Signals(**drawn, memory=(x,))
        return np.array([c + np.zeros(20) for c in (*effect.columns(s), *effect.rates(s, {}))])

    return bool(np.allclose(values(0.5 * (lo + hi)), 0.5 * (values(lo) + values(hi)), rtol=1e-9, atol=1e-9))


def whole(effect: Effect, shapes: Mapping[str, Number], fastest: float) -> tuple[float, float]:
    """Where the state of an affine effect can be if the joint never moved faster than ``fastest`` [rad/s].

    The admissible range, made smaller where the flow leads back from beyond (a drive is no warmer than its fastest work).
    """
    z, start = effect.states[0], effect.at_start[0]
    if not set(effect.needs) <= {"dq", "memory"}:
        return z.lo, z.hi
    s = Signals(dq=_between(-fastest, fastest), given_direction=_between(-1.0, 1.0))

    def end(beyond: float, sign: float) -> float:
        near = start
        for _ in range(50):  # bisection: ``beyond`` leads back if the flow does there, whatever the speed
            middle = 0.5 * (near + beyond)
            rate = sign * effect.rates(replace(s, memory=(_between(middle, middle),)), shapes)[0]
            near, beyond = (near, middle) if rate.hi <= 0.0 else (middle, beyond)
        return beyond

    return end(z.lo, -1.0), end(z.hi, 1.0)


def _between(lo: float, hi: float) -> Interval:
    return Interval(np.array(lo), np.array(hi))


def coefficients(effect: Effect, s: Signals, shapes: Mapping[str, Number]) -> tuple[Array, Array]:
    """``b`` [1/s times the state's unit] and ``a`` [1/s] of an affine flow ``dz/dt = b + a z``, sample by sample."""
    zero_one = np.array([0.0, 1.0]).reshape(-1, *[1] * np.ndim(s.dq))
    rate, _ = np.broadcast_arrays(effect.rates(replace(s, memory=(zero_one,)), shapes)[0], zero_one)
    return rate[0], rate[1] - rate[0]


def stepped(z: Array, b: Array, a: Array, dt: float) -> Array:
    """The state after ``dt`` [s] of an affine flow; exact for signals held over the step."""
    x = a * dt
    slow = np.abs(x) < 1e-12  # (e^x - 1) / x is 1 there, and 0 / 0 in numbers
    return np.asarray(z + (b + a * z) * dt * np.where(slow, 1.0, np.expm1(x) / np.where(slow, 1.0, x)))


def along(effect: Effect, s: Signals, shapes: Mapping[str, Number], first: Mask, dt: Array) -> tuple[Array, ...]:
    """The states at every sample, from `Effect.at_start` where ``first`` (N,) marks the beginning of a trial.

    ``dt`` (N,): time from each sample to the next [s].  States without an affine flow: Heun's method.
    """
    if affine(effect):
        b, a = (np.broadcast_to(x, first.shape) for x in coefficients(effect, s, shapes))
        return (_walk(b, a, dt, first, effect.at_start[0]),)
    return _heun(effect, s, shapes, first, dt)


def _walk(b: Array, a: Array, dt: Array, first: Mask, start: float) -> Array:
    z = np.empty(first.shape[0])
    lib.stopset_remember(
        len(z), view(given(b)), view(given(a)), view(given(dt)), flags(np.ascontiguousarray(first)), start, view(z)
    )
    return z


def _heun(effect: Effect, s: Signals, shapes: Mapping[str, Number], first: Mask, dt: Array) -> tuple[Array, ...]:
    """All trials beside each other; states stay within their ranges."""
    begin = np.flatnonzero(first)
    length = np.diff(np.append(begin, len(first)))
    lo, hi = (np.array([[getattr(x, end)] for x in effect.states]) for end in ("lo", "hi"))
    states = np.tile(np.array(effect.at_start)[:, None], (1, len(first)))
    arrays = {f.name: v for f in fields(s) if f.name not in ("tip", "tilt", "memory") and np.ndim(v := getattr(s, f.name))}

    def rate(x: Array, at: NDArray[np.intp]) -> Array:
        here = replace(s, memory=tuple(x), **{name: v[at] for name, v in arrays.items()})
        return np.stack([np.broadcast_to(r, (len(at),)) for r in effect.rates(here, shapes)])

    for k in range(int(length.max(initial=0)) - 1):
        at = begin[length > k + 1] + k
        x, h = states[:, at], dt[at]
        slope = rate(x, at)
        slope = 0.5 * (slope + rate(x + h * slope, at + 1))
        states[:, at + 1] = np.clip(x + h * slope, lo, hi)
    return tuple(states)
