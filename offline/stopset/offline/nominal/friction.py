"""What friction may not do: push.  Limits on its parameters, over the range of speed and load that was seen.

A fitted polynomial ``v1 s + v2 s^2 + v3 s^3`` may feed energy in; ``v1 + v2 s + v3 s^2 >= 0`` is demanded on the whole
range of speeds, by cutting planes: the worst speed of a solution becomes a row of the next one (for the cubic these are
the two ends and the vertex).  Dry friction must resist in the mean of both directions at every load seen; a constant
offset cancels there, because an offset is not friction.

Source: Liu & Althoff (2018), eqs. (5)-(9).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stopset.effects import Effect, Signals
from stopset.offline.nominal.normal_equations import Layout
from stopset.types import Array

CREEP = 1e-9  # [rad/s] a column that has vanished here is viscous, one that has not is dry
DRY = 1e-6  # of a unit coefficient, at creeping speed
ENDS = 5  # speeds and loads in the first set of rows: both ends, the middle, and between
DENSE = 2001  # speeds at which a solution is checked


@dataclass(frozen=True, slots=True)
class ParameterLimits:
    """``lower <= A theta <= upper`` over the whole parameter vector."""

    A: Array
    lower: Array
    upper: Array

    def __add__(self, other: ParameterLimits) -> ParameterLimits:
        return ParameterLimits(
            np.vstack([self.A, other.A]),
            np.concatenate([self.lower, other.lower]),
            np.concatenate([self.upper, other.upper]),
        )


def dry(effect: Effect) -> NDArray[np.bool_]:
    """(terms,) which columns are still there when the joint creeps: Coulomb friction of any kind, not viscous torque."""
    if not set(effect.needs) <= {"dq", "load"}:
        return np.zeros(len(effect.terms), bool)
    direction, load = np.array([1.0, 1.0, -1.0, -1.0]), np.array([1.0, -1.0, 1.0, -1.0])  # each quadrant has columns of its own
    creeping = _values(effect, Signals(dq=CREEP * direction, load=load), 4)
    return np.asarray(np.abs(creeping).max(axis=0) >= DRY)


def _values(effect: Effect, s: Signals, rows: int) -> Array:
    return np.column_stack([np.broadcast_to(np.asarray(c, float), (rows,)) for c in effect.columns(s)])


def _place(layout: Layout, joint: int, effect: Effect) -> tuple[int, list[int]]:
    """First place of the joint's friction in the parameter vector, and the effect's columns there."""
    start = int(layout.index(joint)[10 * layout.n + 1]) if layout.columns[joint] else 0
    return start, [k for k, c in enumerate(layout.columns[joint]) if c.effect is effect]


def _rows(layout: Layout, joint: int, dq: Array, load: Array, *, viscous: bool) -> Array:
    """(rows, size): resisting torque of the joint's friction, per speed if ``viscous``, else in the mean of directions."""
    A = np.zeros((len(dq), layout.size))
    for effect in dict.fromkeys(c.effect for c in layout.columns[joint]):
        if not set(effect.needs) <= {"dq", "load"}:
            continue
        start, own = _place(layout, joint, effect)
        own = [start + k for k in own]
        if viscous:
            columns = _values(effect, Signals(dq=dq, load=load), len(dq)) / dq[:, None]
            keep = ~dry(effect)
        else:
            up = _values(effect, Signals(dq=np.abs(dq), load=load), len(dq))
            down = _values(effect, Signals(dq=-np.abs(dq), load=load), len(dq))
            columns = 0.5 * (up - down)
            keep = dry(effect)
        A[:, own] += np.where(keep, columns, 0.0)
    return A


def ranges(layout: Layout, *, rotor_positive: bool = True) -> ParameterLimits:
    """Each term within its admissible range, rotors not negative."""
    rows, lo, hi = [], [], []
    for j, columns in enumerate(layout.columns):
        terms: Mapping[tuple[str, str], tuple[float, float]] = {
            (c.effect.name, t.symbol): (t.lo, t.hi) for c in columns for t in c.effect.terms
        }
        for c, place in zip(columns, layout.index(j)[10 * layout.n + 1 :], strict=True):
            rows.append(np.eye(1, layout.size, int(place))[0])
            low, high = terms[c.effect.name, c.symbol]
            lo.append(low)
            hi.append(high)
    for j in range(layout.n if rotor_positive else 0):
        rows.append(np.eye(1, layout.size, 10 * layout.n + j)[0])
        lo.append(0.0)
        hi.append(np.inf)
    return ParameterLimits(np.array(rows).reshape(-1, layout.size), np.array(lo), np.array(hi))


def passivity(layout: Layout, speed: Array, load: Array) -> ParameterLimits:
    """First rows: friction resists at both ends, the middle and between, of ``speed`` and ``load`` (n,) magnitudes."""
    blocks = []
    for j in range(layout.n):
        if not layout.columns[j] or not speed[j] > 0:
            continue
        s = np.linspace(-speed[j], speed[j], ENDS + 1)  # even count: zero is not among them
        g = np.linspace(-load[j], load[j], ENDS)
        blocks.append(_rows(layout, j, s, np.zeros_like(s), viscous=True))
        blocks.append(_rows(layout, j, np.full_like(g, CREEP), g, viscous=False))
    A = np.vstack(blocks) if blocks else np.zeros((0, layout.size))
    A = A[np.abs(A).max(axis=1, initial=0.0) > 0]
    return ParameterLimits(A, np.zeros(len(A)), np.full(len(A), np.inf))


def worst(layout: Layout, theta: Array, speed: Array) -> ParameterLimits:
    """Rows at the speeds where the viscous friction of ``theta`` pushes hardest; none if it pushes nowhere."""
    rows = []
    for j in range(layout.n):
        if not layout.columns[j] or not speed[j] > 0:
            continue
        s = np.linspace(-speed[j], speed[j], DENSE + 1)
        A = _rows(layout, j, s, np.zeros_like(s), viscous=True)
        f = A @ theta
        k = int(np.argmin(f))
        if f[k] < -1e-9 * max(float(np.abs(f).max()), 1e-12):
            rows.append(A[k])
    A = np.array(rows).reshape(-1, layout.size)
    return ParameterLimits(A, np.zeros(len(A)), np.full(len(A), np.inf))
