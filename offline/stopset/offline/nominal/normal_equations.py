"""The data's whole say in a few small matrices: one pass, constant memory, recordings add up.

For each joint the normal matrix of ``[link parameters | rotor | friction | torque at several delays]`` is summed over
its usable samples.  Every later question (fit, weights, delay, held-out error, covariance) is answered from these sums,
so a campaign of any length is read once, and a later recording is folded in by addition, with the result of having
read everything together (sums of floating-point numbers: equal to rounding).

Motions are spread over a fixed number of groups by a hash of their name: leaving out a group leaves out whole motions,
which is what an honest held-out error and a standard error need (friction varies from motion to motion, not from
sample to sample).
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from stopset.effects import Effect, get
from stopset.effects.base import Number
from stopset.effects.selection import base
from stopset.effects.signals import Samples, arm_signals
from stopset.errors import EffectError, RecordingError
from stopset.offline.nominal.preprocess import Pose, PreparedMotion, Preprocessing, derivative, motions, pose_of
from stopset.recording.types import Recording
from stopset.robot import Robot
from stopset.robot.rigid import regressors
from stopset.types import Array

GROUPS = 32
TOGETHER = 10.0  # rows whose errors count as one where nothing tells it: half a second, at 20 rows per second
DELAYS: Array = 0.006 * np.arange(-10, 11, dtype=np.float64)  # [s] torque is kept at these lags; 6 ms resolves 15 Hz to 0.3 %
STILL_PHASES = ("static",)
BRAKED_PHASES = ("stop0", "stop1")  # the brake's torque is not in tau


@dataclass(frozen=True, slots=True)
class Column:
    """One friction column: term ``symbol`` of ``effect`` at joint number ``joint``."""

    effect: Effect
    symbol: str
    joint: int


@dataclass(frozen=True, slots=True)
class Layout:
    """Which parameters there are: 10 n of the links, n rotors, then the friction columns joint by joint."""

    joints: tuple[str, ...]
    columns: tuple[tuple[Column, ...], ...]  # per joint

    @property
    def n(self) -> int:
        return len(self.joints)

    @property
    def effects(self) -> tuple[str, ...]:
        """``effect:joint`` of all friction columns."""
        return tuple(dict.fromkeys(f"{c.effect.name}:{self.joints[c.joint]}" for cs in self.columns for c in cs))

    @property
    def width(self) -> int:
        """Most friction columns of any joint; the others' are padded with zeros."""
        return max((len(c) for c in self.columns), default=0)

    @property
    def size(self) -> int:
        return 11 * self.n + sum(len(c) for c in self.columns)

    def index(self, joint: int) -> NDArray[np.intp]:
        """Places in the parameter vector of the columns in this joint's normal matrix (without padding)."""
        n = self.n
        start = 11 * n + sum(len(c) for c in self.columns[:joint])
        own = np.arange(start, start + len(self.columns[joint]))
        return np.concatenate([np.arange(10 * n), [10 * n + joint], own]).astype(np.intp)

    def names(self) -> tuple[str, ...]:
        """Parameter names, e.g. ``arm_joint_2.mx``, ``arm_joint_2.rotor``, ``coulomb:arm_joint_2.F_c``."""
        link = [f"{j}.{p}" for j in self.joints for p in ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")]
        rotor = [f"{j}.rotor" for j in self.joints]
        return (*link, *rotor, *(f"{c.effect.name}:{self.joints[c.joint]}.{c.symbol}" for cs in self.columns for c in cs))

    def units(self) -> tuple[str, ...]:
        """Unit of each parameter, in the order of `names`."""
        link = ("kg", *["kg m"] * 3, *["kg m²"] * 6)
        friction = (t.unit for cs in self.columns for c in cs for t in c.effect.terms if t.symbol == c.symbol)
        return (*link * self.n, *["kg m²"] * self.n, *friction)


def layout_of(robot: Robot, effects: Sequence[str | Effect], *, compensated: bool) -> Layout:
    """The parameters of ``effects`` (names, ``name:joint``, or effects) at every joint, in the order given.

    Torque that is already compensated (eq. 11) holds no Coulomb friction: only what enters as damping is kept.
    Raises `EffectError` for effects of the whole arm or with memory: they are added to a model, not part of it.
    """
    columns: list[list[Column]] = [[] for _ in robot.joints]
    for item in effects:
        name, _, only = item.partition(":") if isinstance(item, str) else (item.name, "", "")
        effect = get(name) if isinstance(item, str) else item
        if effect.scope != "joint" or effect.states:
            raise EffectError(
                f"effect {effect.name} acts on {effect.scope} or has memory; the nominal model takes friction and "
                "other effects of single joints without memory: add it with `stopset add`"
            )
        if only and only not in robot.joints:
            raise EffectError(f"{item}: the robot has no joint {only}; expected one of {', '.join(robot.joints)}")
        if compensated and effect.enters != "damping":
            continue
        for j, joint in enumerate(robot.joints):
            if only in ("", joint):
                columns[j] += [Column(effect, t.symbol, j) for t in effect.terms]
    return Layout(robot.joints, tuple(tuple(c) for c in columns))


@dataclass(slots=True)
class NormalEquations:
    """Sums over recordings: ``moving`` (GROUPS, n, c, c), ``still`` (n, c, c) with ``c = 10 n + 1 + width + 1 + len(DELAYS)``.

    Behind the friction, before the torque at its lags, stands the joint's reversals (`reversals`), which only the lag's estimate reads.

    ``rows_moving`` (GROUPS, n), ``rows_still`` (n,): samples; ``speed, load`` (n, 2): lowest and highest seen; ``period`` [s].
    """

    layout: Layout
    settings: Preprocessing
    reference: Array  # (n, 10) link parameters that the load of load-dependent effects is computed with
    moving: Array
    still: Array
    rows_moving: Array
    rows_still: Array
    speed: Array
    load: Array
    span: Array  # (n, 2) lowest and highest position
    compensated: bool = False
    period: float = float("nan")
    samples: int = 0
    recordings: int = 0
    poses: int = 0
    skipped: dict[str, int] = field(default_factory=dict)

    def __add__(self, other: NormalEquations) -> NormalEquations:
        """Both campaigns together; raises `RecordingError` where they were not prepared alike."""
        same = (
            self.layout.names() == other.layout.names()
            and self.settings == other.settings
            and np.array_equal(self.reference, other.reference)
            and self.compensated == other.compensated
        )
        if not same:
            raise RecordingError(
                "the new recordings were prepared with other settings, effects or robot than the old ones; expected the "
                "same: identify from all recordings again"
            )
        weight = np.array([self.recordings, other.recordings], float)
        periods = np.nan_to_num([self.period, other.period])
        skipped = {k: self.skipped.get(k, 0) + other.skipped.get(k, 0) for k in {*self.skipped, *other.skipped}}
        return NormalEquations(
            self.layout, self.settings, self.reference,
            self.moving + other.moving, self.still + other.still,
            self.rows_moving + other.rows_moving, self.rows_still + other.rows_still,
            _hull(self.speed, other.speed), _hull(self.load, other.load), _hull(self.span, other.span),
            self.compensated, float(periods @ weight / max(weight.sum(), 1)), self.samples + other.samples,
            self.recordings + other.recordings, self.poses + other.poses, skipped,
        )  # fmt: skip


def _hull(a: Array, b: Array) -> Array:
    return np.column_stack([np.minimum(a[:, 0], b[:, 0]), np.maximum(a[:, 1], b[:, 1])])


def group_of(r: Recording) -> int:
    """The group of a trial's motion, the same in every run and on every machine, whatever numbers the recorder gave.

    Open-loop trials of a suite repeat one motion, unless they were found to go otherwise; elsewhere every trial is a motion of its own.
    """
    own = r.other if r.phase == "open_loop" else r.other + r.repetition
    name = f"{r.phase}:{r.begun}" if r.phase == "open_loop" and not own else f"{r.phase}:{r.begun}:{own}"
    return zlib.crc32(name.encode(), r.file) % GROUPS


def empty(robot: Robot, layout: Layout, settings: Preprocessing, reference: Array, *, compensated: bool) -> NormalEquations:
    """Normal equations of no data."""
    n = robot.n
    c = 10 * n + 1 + layout.width + 1 + len(DELAYS)
    nothing = np.tile([np.inf, -np.inf], (n, 1))
    return NormalEquations(
        layout, settings, np.array(reference, float),
        np.zeros((GROUPS, n, c, c)), np.zeros((n, c, c)), np.zeros((GROUPS, n)), np.zeros(n),
        nothing.copy(), nothing.copy(), nothing.copy(), compensated,
    )  # fmt: skip


def accumulate(
    robot: Robot,
    recordings: Iterable[Recording],
    effects: Sequence[str | Effect] | None = None,
    settings: Preprocessing | None = None,
    reference: Array | None = None,
    *,
    compensated: bool = False,
) -> NormalEquations:
    """One pass over the recordings; memory does not grow with their number. ``effects`` left out: `base` friction.

    ``reference``: link parameters (n, 10) for the load of load-dependent effects, the robot's own if left out.
    """
    layout = layout_of(robot, base() if effects is None else effects, compensated=compensated)
    out = empty(robot, layout, settings or Preprocessing(), robot.pi if reference is None else reference, compensated=compensated)
    view = robot.with_parameters(out.reference)
    pending: list[Recording] = []  # the trials of the static pose being read
    for r in recordings:
        if r.phase in BRAKED_PHASES:
            out.skipped[r.phase] = out.skipped.get(r.phase, 0) + 1
            continue
        if r.phase in STILL_PHASES:
            if pending and pending[0].suite_key != r.suite_key:
                _add_pose(out, view, pending)
                pending = []
            pending.append(r)
            continue
        _add_motions(out, view, r)
    if pending:
        _add_pose(out, view, pending)
    return out


def _add_motions(out: NormalEquations, robot: Robot, r: Recording) -> None:
    used = 0
    for m in motions(r, out.settings):
        X, use = moving_rows(out, robot, m)
        g = group_of(r)
        for j in range(robot.n):
            rows = X[j][use[:, j]]
            out.moving[g, j] += rows.T @ rows
            out.rows_moving[g, j] += len(rows)
        out.speed = _hull(out.speed, np.column_stack([m.dq.min(axis=0), m.dq.max(axis=0)]))
        out.span = _hull(out.span, np.column_stack([m.q.min(axis=0), m.q.max(axis=0)]))
        used += len(m.retained)
        period = m.period
    if used:
        out.period = float(np.nan_to_num(out.period) * out.recordings + period) / (out.recordings + 1)
        out.recordings += 1
        out.samples += len(r.t)
    else:
        out.skipped["too short"] = out.skipped.get("too short", 0) + 1


def moving_rows(out: NormalEquations, robot: Robot, m: PreparedMotion) -> tuple[Array, NDArray[np.bool_]]:
    """(n, rows, c) regression rows of every joint, and (rows, n) which of them count."""
    k, n = m.retained, robot.n
    at = np.arange(len(m.t)) if m.narrow else k
    Y = regressors(robot.chain, *(np.ascontiguousarray(x[at]) for x in (m.q, m.dq, m.ddq)))
    if out.compensated:  # eq. (11): gravity is not in u
        zero = np.zeros_like(m.q[at])
        Y = Y - regressors(robot.chain, np.ascontiguousarray(m.q[at]), zero, zero)
    body = np.concatenate([Y, m.ddq[at][:, :, None]], axis=2)
    X = np.zeros((n, len(k), out.moving.shape[-1]))
    X[:, :, : 10 * n + 1] = (m.smooth(body)[k] if m.narrow else body).transpose(1, 0, 2)
    friction, load = friction_columns(out.layout, robot, m, out.settings.still)
    for j in range(n):
        for c, column in enumerate(friction[j]):
            X[j, :, 10 * n + 1 + c] = column
    X[:, :, -len(DELAYS) - 1] = reversals(m, out.settings.still).T
    X[:, :, -len(DELAYS) :] = m.delayed(m.tau, DELAYS).transpose(1, 0, 2)
    if load is not None:
        out.load = _hull(out.load, np.column_stack([load.min(axis=0), load.max(axis=0)]))
    return X, m.moving[k]


def reversals(m: PreparedMotion, still: float) -> Array:
    """(kept rows, n) [1/s] rate of each joint's direction, through the torque's filter: what a change of when friction turns over adds.

    Where a joint reverses it sticks for some milliseconds, its teeth and its grease give way before it moves, and a controller's
    friction compensation leads it: dry friction turns over beside the instant at which the filtered speed is zero, on slow wrists by
    10 ms.  Its step is the steepest torque of such a joint, so without this column a lag would be read from where friction steps.
    """
    return derivative(m.smooth(np.clip(m.dq / still, -1.0, 1.0)), m.period)[m.retained]


def friction_columns(
    layout: Layout, robot: Robot, m: PreparedMotion, still: float, direction: float | None = None
) -> tuple[list[list[Array]], Array | None]:
    """Each joint's friction columns at the kept rows, through the torque's filter, and the load if it was needed.

    ``direction``: direction of motion to assume in place of that of ``dq``.
    """
    needs = {s for cs in layout.columns for c in cs for s in c.effect.needs}
    if "temp" in needs and m.temp is None:
        raise RecordingError("an effect needs joint temperatures (temp_<joint>) that this recording does not have; leave it out")
    signals = arm_signals(robot, Samples(m.q, m.dq, m.ddq, m.temp, t=m.t), needs or {"dq"})
    # within the stiction band the sign of the noise is no direction; beyond it this is the plain sign
    signals = tuple(
        replace(s, given_direction=np.clip(s.dq / still, -1.0, 1.0) if direction is None else np.full(len(m.t), direction))
        for s in signals
    )
    raw: list[Array] = []
    for j, columns in enumerate(layout.columns):
        for effect in dict.fromkeys(c.effect for c in columns):
            raw += [_column(c, m.t.shape) for c in effect.columns(signals[j])]
    smooth = m.smooth(np.column_stack(raw))[m.retained] if raw else np.zeros((len(m.retained), 0))
    edges = np.cumsum([0, *(len(c) for c in layout.columns)])
    out = [[smooth[:, k] for k in range(lo, hi)] for lo, hi in pairwise(edges)]
    load = np.column_stack([s.load for s in signals]) if "load" in needs else None
    return out, load


def _column(values: Number, shape: tuple[int, ...]) -> Array:
    """One law's column as numbers, one of each sample."""
    x = np.asarray(values, float)
    return x if x.shape == shape else np.broadcast_to(x, shape)


def _add_pose(out: NormalEquations, robot: Robot, trials: list[Recording]) -> None:
    pose = None if out.compensated else pose_of(trials)
    if pose is None:
        what = "static, compensated torque" if out.compensated else "static pose from one side only"
        out.skipped[what] = out.skipped.get(what, 0) + len(trials)
        return
    X = _pose_rows(out, robot, pose)
    for j in range(robot.n):
        out.still[j] += np.outer(X[j], X[j])
        out.rows_still[j] += 1
    out.poses += 1
    out.span = _hull(out.span, np.column_stack([pose.q.min(axis=0), pose.q.max(axis=0)]))


def _pose_rows(out: NormalEquations, robot: Robot, pose: Pose) -> Array:
    """(n, c): mean of the rows of both approaches; Coulomb friction cancels, its load dependence does not."""
    n = robot.n
    zero = np.zeros_like(pose.q)
    X = np.zeros((n, out.still.shape[-1]))
    X[:, : 10 * n] = regressors(robot.chain, pose.q, zero, zero).mean(axis=0)
    needs = {s for cs in out.layout.columns for c in cs for s in c.effect.needs}
    # creeping speed: the sign says from which side the pose was reached
    signals = arm_signals(robot, Samples(pose.q, 1e-6 * pose.direction), (needs & {"load"}) or {"dq"})
    for j, columns in enumerate(out.layout.columns):
        place = 10 * n + 1
        for effect in dict.fromkeys(c.effect for c in columns):
            for column in effect.columns(signals[j]):
                X[j, place] = np.mean(np.broadcast_to(np.asarray(column, float), (2,)))
                place += 1
    X[:, -len(DELAYS) :] = pose.tau.mean(axis=0)[:, None]
    return X
