"""What may have changed in an arm since a model of it was identified: the levels that the model has, each with its columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stopset.artifact import Model
from stopset.artifact.inputs import effect_torques
from stopset.effects.base import Effect, Fitted, Part
from stopset.effects.registry import catalogue, get
from stopset.effects.selection import of_part
from stopset.effects.signals import Samples, arm_signals
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.columns.laws import beyond_gravity
from stopset.offline.nominal.parameter_uncertainty import along, own_columns
from stopset.robot.rigid import regressors, torques
from stopset.types import Array

FEW = 2000  # rows that are enough to tell how alike two torques are

PARTS: dict[Part, str] = {
    "dry friction": "Coulomb friction", "damping": "viscous friction", "constant torque": "constant torque",
    "torque scale": "torque scale", "load": "load at the flange",
}  # fmt: skip


class ColumnLevel(NamedTuple):
    """What one number of a change says: how much its level changes ``per`` unit of the coefficient ``of`` the change."""

    effect: str
    symbol: str
    unit: str
    before: float
    per: float = 1.0
    of: int = 0


@dataclass(frozen=True, slots=True)
class LevelChange:
    """A change at a joint (None: of the whole arm): ``columns`` (rows, n, k), what they say, and which of it counts.

    ``error, least`` (k,): the model's own error of each coefficient, and the least one that is no daily difference; ``beside``
    (rows, n, m): what may differ besides; ``amount`` [N m]: the least torque, root mean square over its rows, that all of it makes.
    """

    joint: int | None
    columns: Array
    beside: Array
    levels: tuple[ColumnLevel, ...]
    error: Array
    least: Array
    friction: bool = False
    amount: float = 0.0

    @property
    def constant(self) -> bool:
        """Whether it is a constant torque of one joint."""
        return self.joint is not None and all(get(x.effect).part == "constant torque" for x in self.levels)

    def only(self, here: NDArray[np.bool_]) -> LevelChange:
        """The same where ``here``, nothing elsewhere."""
        return replace(self, columns=np.where(here[:, None, None], self.columns, 0.0))

    def enough(self, theta: Array) -> bool:
        """Whether coefficients ``theta`` (k,) make as much torque as a change must."""
        torque = self.columns @ theta
        return float(np.linalg.norm(torque)) > self.amount * float(np.sqrt(np.count_nonzero(self.columns.any(axis=2))))

    def possible(self, theta: Array) -> bool:
        """Whether all numbers lie in their admissible ranges with coefficients ``theta`` (k,) more."""
        ranges = {(x.effect, t.symbol): (t.lo, t.hi) for x in self.levels for t in get(x.effect).terms}
        after = {(x.effect, x.symbol): x.before + x.per * float(theta[x.of]) for x in self.levels}
        return all(lo <= after[k] <= hi for k, (lo, hi) in ranges.items() if k in after)

    def same_as(self, other: LevelChange) -> bool:
        """Whether both are a change of the same numbers at the same joint; an offset of one joint reads like that of any other."""
        return self.joint == other.joint and self.levels == other.levels

    def rows(self, here: NDArray[np.bool_]) -> LevelChange:
        """The same of these rows alone."""
        return replace(self, columns=self.columns[here], beside=self.beside[here])


def level_changes(model: Model, q: Array, dq: Array, ddq: Array, moving: NDArray[np.bool_]) -> list[LevelChange]:
    """Every change to ask for, over rows of a motion (rows, n); friction's at the rows where its joint is ``moving`` (rows, n).

    How fast a joint usually moves decides how much friction it has: a program that stands half of its time is no slow one.
    """
    n, out = model.n, []
    dry_law, damping, offset, scale, body = map(of_part, PARTS)
    rigid = torques(model.robot.chain, model.robot.pi, q, dq, ddq) + model.rotor * ddq

    def at(*columns: Array, j: int) -> Array:
        block = np.zeros((len(q), n, len(columns)))
        block[:, j] = np.column_stack(columns)
        return block

    speed = np.where(moving, dq, 0.0)
    rubs = [at(np.sign(v), v, j=j) for j, v in enumerate(speed.T)]
    for j, joint in enumerate(model.joints):
        (dry, dry_error), (wet, wet_error) = _level(model, dry_law, joint), _level(model, damping, joint)
        error = _level_error(model, j, q[moving[:, j]], dq[moving[:, j]], ddq[moving[:, j]])
        out += _friction(j, rubs[j], (_said_of(dry_law, dry), dry_error), (_said_of(damping, wet), wet_error), error)
        usual, carried = dry + wet * _usual(speed[:, j]), float(np.sqrt(np.mean(rigid[:, j] ** 2)))
        least = np.array([max(limit.DAILY * dry, limit.DRIVES * carried)])  # constants off one by one show at other poses
        out.append(LevelChange(j, at(np.ones(len(q)), j=j), rubs[j], (_said_of(offset),), np.zeros(1), least))
        if carried > limit.LOADED_GAIN * usual:
            least = np.array([limit.LEAST_GAIN])
            out.append(LevelChange(j, at(rigid[:, j], j=j), rubs[j], (_said_of(scale),), np.zeros(1), least))
    tip = np.ascontiguousarray(regressors(model.robot.chain, q, dq, ddq)[:, :, -10:][:, :, :4])
    out += _own(model, q, dq, ddq, rubs)
    load = tuple(_said_of(body, term=k) for k in range(4))
    friction = np.concatenate(rubs, axis=2)
    out.append(LevelChange(None, tip, friction, load, np.zeros(4), np.array([limit.LEAST_MASS, *[np.inf] * 3])))
    out.append(LevelChange(None, rigid[:, :, None], friction, (_said_of(scale),), np.zeros(1), np.array([limit.LEAST_GAIN])))
    some = np.flatnonzero(moving.any(axis=1))
    some = some[:: max(1, len(some) // FEW)]
    open_by = _left_open(model, *(np.ascontiguousarray(x[some]) for x in (q, dq, ddq)))
    return [
        replace(c, error=_open_error(c.columns[some], open_by)) if open_by.size and not (c.friction or c.error.any()) else c
        for c in out
    ]


def _left_open(model: Model, q: Array, dq: Array, ddq: Array) -> Array:
    """(rows, n, k) [N m] torque along what the model's own recordings left open of it, see `parameter_uncertainty.left_open`."""
    F, n = np.array(model.provenance.get("left_open", []), float), model.n
    if not F.size or not len(q):
        return np.zeros((0, n, 0))
    Y = regressors(model.robot.chain, q, dq, ddq)
    return np.stack([along(F, j, Y[:, j], own_columns(dq[:, j], ddq[:, j])) for j in range(n)], axis=1)


def _open_error(columns: Array, open_by: Array) -> Array:
    """(k,) how much of a change with these ``columns`` (rows, n, k) what is left open of the model looks like, one standard deviation of it."""
    flat = columns.reshape(-1, columns.shape[2])
    alike = np.linalg.lstsq(flat, open_by.reshape(len(flat), -1), rcond=1e-9)[0]
    return np.asarray(np.sqrt(np.sum(alike**2, axis=1)))


def _own(model: Model, q: Array, dq: Array, ddq: Array, rubs: Sequence[Array]) -> list[LevelChange]:
    """Changes of the effects that the model has at single joints, as far as the arm's present state tells their torque."""
    out = []
    for f in model.effects:
        law = get(f.effect)
        if (
            law.base
            or law.part
            or law.scope != "joint"
            or law.states
            or not law.compensated()
            or "temp" in law.needs
            or f.joint is None
        ):
            continue
        j, columns = model.joints.index(f.joint), _columns(model, f, law, q, dq, ddq)
        before = np.array([f.values[t.symbol] for t in law.terms])
        levels = tuple(_said_of(law, float(x), k) for k, x in enumerate(before))
        error = np.array([f.std.get(t.symbol) or 0.0 for t in law.terms])
        out.append(LevelChange(j, columns, rubs[j], levels, error, limit.DAILY * np.abs(before)))
    return out


def look_alikes(model: Model, q: Array, dq: Array, ddq: Array, levels: Sequence[LevelChange]) -> list[LevelChange]:
    """Laws that look like a joint's friction, in the model or not, over the same rows, beside what ``levels`` have beside them.

    A level must not be said to have changed where one of these says more.
    """
    plain = {e.name for e in map(of_part, PARTS) if e.base}
    out = []
    for law in catalogue().values():
        if law.base or law.part or law.role != "friction" or not plain & set(law.looks_like) or not _instant(law):
            continue
        for j, joint in enumerate(model.joints):
            shares = next((c.beside for c in levels if c.friction and c.joint == j and c.beside.shape[2]), None)
            if shares is None:
                continue
            f = next((f for f in model.effects if (f.effect, f.joint) == (law.name, joint)), Fitted(law.name, joint, {}))
            before = np.array([f.values.get(t.symbol, 0.0) for t in law.terms])
            error = np.array([f.std.get(t.symbol) or 0.0 for t in law.terms])
            said = tuple(_said_of(law, float(x), k) for k, x in enumerate(before))
            columns = _columns(model, f, law, q, dq, ddq)
            out.append(LevelChange(j, columns, shares, said, error, limit.DAILY * np.abs(before), friction=True))
    return out


def while_moving(model: Model, laws: Sequence[Fitted], q: Array, dq: Array, ddq: Array) -> Array:
    """(rows, n) [N m] what ``laws`` of the load have beyond gravity's part where they are of all that their gears transmit."""
    out = np.zeros_like(q)
    signals = arm_signals(model.robot, Samples(q, dq, ddq), {"load", "link"}) if laws else ()
    for f in laws:
        law, j = get(f.effect), model.joints.index(f.joint or "")
        s = replace(signals[j], given_direction=np.sign(dq[:, j]))
        out[:, j] += beyond_gravity(law, s, np.asarray(s.link)) @ [f.values[t.symbol] for t in law.terms]
    return out


def _instant(law: Effect) -> bool:
    """Whether the arm's present state tells a law's torque, with no shape to be found."""
    return (
        law.scope == "joint" and not law.shapes and not law.states and law.compensated() and not {"temp", "warm"} & set(law.needs)
    )


def _columns(model: Model, f: Fitted, law: Effect, q: Array, dq: Array, ddq: Array) -> Array:
    """(rows, n, terms) torque of each term of a law at one, its shapes as ``f`` has them."""
    shapes = {x.symbol: f.values[x.symbol] for x in law.shapes}
    unit = [replace(f, values={**shapes, **{t.symbol: float(t is x) for t in law.terms}}) for x in law.terms]
    s = Samples(q, dq, ddq, None, 0.0, np.zeros(len(q)))
    return np.stack([effect_torques(model.robot, [x], s) for x in unit], axis=2)


def _friction(
    joint: int, rubs: Array, dry: tuple[ColumnLevel, float], wet: tuple[ColumnLevel, float], error: float
) -> list[LevelChange]:
    """Changes of a joint's friction: of its dry part, of its viscous part, of both by one factor, and of both freely.

    ``rubs`` (rows, n, 2): direction and speed.  In the first three the shares of the parts may be off as the model's errors are,
    at the speeds of these rows: what counts is how much friction there is, which the model knows but for an ``error`` [N m].  So it is in
    the fourth, beside each part: at a creep a viscous number may be half as large again for a few percent of the friction.
    """
    (a, a_error), (b, b_error) = dry, wet
    direction, speed = rubs[:, :, :1], rubs[:, :, 1:]
    usual = _usual(speed)
    level = a.before + usual * b.before
    shares = (speed - usual * direction) * max(b_error, limit.DAILY * b.before, 1e-9)  # in the model's own errors
    free = LevelChange(
        joint, rubs, rubs[:, :, :0], (a, b._replace(of=1)), np.array([a_error, b_error]),
        limit.DAILY * np.array([a.before, b.before]), friction=True, amount=limit.DAILY * level,
    )  # fmt: skip
    one = [
        (direction, (a,), 1.0),
        (speed, (b,), max(usual, 1e-9)),
        (direction * a.before + speed * b.before, (a._replace(per=a.before), b._replace(per=b.before)), max(level, 1e-9)),
    ]
    return [
        free,
        *(
            LevelChange(joint, x, shares, said, np.array([error / per]), np.array([limit.DAILY * level / per]), friction=True)
            for x, said, per in one
        ),
    ]


def _level_error(model: Model, joint: int, q: Array, dq: Array, ddq: Array) -> float:
    """[N m] standard error of the friction that a model says a joint has in the mean over these rows (rows, n).

    Its numbers err against each other, so that their sum is known better than any of them.  Of a model that does not say how, they err as
    those of a regression on these rows would.
    """
    name, moved = model.joints[joint], np.abs(dq[:, joint])
    if not len(moved):
        return 0.0
    laws = {f.effect: f for f in model.effects if f.joint == name}
    stated = model.provenance.get("friction_covariance", {}).get(name, {"of": [["", ""]]})
    if not all(effect in laws for effect, _ in stated["of"]):
        (_, a), (_, b) = (_level(model, of_part(part), name) for part in ("dry friction", "damping"))
        m1, m2 = float(np.mean(moved)), float(np.mean(moved**2))
        return float(np.sqrt(a**2 + (m1 * b) ** 2 - 2 * m1 / np.sqrt(m2) * a * m1 * b))
    columns = {effect: _columns(model, laws[effect], get(effect), q, dq, ddq)[:, joint] for effect in dict(stated["of"])}
    place = [[t.symbol for t in get(effect).terms].index(symbol) for effect, symbol in stated["of"]]
    along = np.sign(dq[:, joint])
    mean = np.array([np.mean(along * columns[e][:, k]) for (e, _), k in zip(stated["of"], place, strict=True)])
    return float(np.sqrt(max(mean @ np.array(stated["covariance"]) @ mean, 0.0)))


def _usual(speed: Array) -> float:
    """Mean speed [rad/s] where it is not zero."""
    return float(np.sum(np.abs(speed)) / max(np.count_nonzero(speed), 1))


def _level(model: Model, law: Effect, joint: str) -> tuple[float, float]:
    """What the model says of a law's first term, and its error."""
    symbol = law.terms[0].symbol
    f = next((f for f in model.effects if (f.effect, f.joint) == (law.name, joint)), None)
    return (0.0, 0.0) if f is None else (f.values.get(symbol, 0.0), f.std.get(symbol) or 0.0)


def _said_of(law: Effect, before: float = 0.0, term: int = 0) -> ColumnLevel:
    return ColumnLevel(law.name, law.terms[term].symbol, law.terms[term].unit, before, of=term)
