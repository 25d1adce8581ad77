"""The engine of the diagnosis: rows and columns of all joints, computed once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stopset.effects import Effect
from stopset.offline.campaign.hold_out import FOLDS
from stopset.offline.campaign.independence import Ends, uncut
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.columns.base import all_rows, base_columns, first_friction
from stopset.offline.diagnose.columns.laws import columns
from stopset.offline.diagnose.columns.signals import ArmSignals
from stopset.offline.diagnose.columns.structure import Giving, Place
from stopset.offline.diagnose.evidence.candidate import Candidate
from stopset.offline.diagnose.evidence.evidence import JointGram
from stopset.offline.diagnose.evidence.priors import Beforehand, link_tolerance
from stopset.offline.diagnose.rows.prepare import Prepared, prepare
from stopset.offline.diagnose.rows.rows import JointRows
from stopset.offline.diagnose.side_by_side import Recent
from stopset.offline.nominal.parameter_uncertainty import along
from stopset.offline.nominal.prior import Tolerance
from stopset.recording import Recordings
from stopset.robot import Robot
from stopset.types import Array, Index

EMPTY = 1e-9  # [N m] rounding: a column no larger leaves no trace
RECENT = 8  # laws whose columns are kept
PLACES = 32  # places where a structure or a gear may give, with all that their swings ask of the rows, that are kept
CACHED = 64  # columns of tried shapes that are kept: a search comes back to them


@dataclass(slots=True)
class Engine:
    """Everything computed once: rows, columns and their sums; what is assumed of them stands in a `Hypothesis`."""

    robot: Robot
    data: Prepared
    source: ArmSignals
    rows: list[JointRows]
    fold_of_trial: Index
    friction: Array  # (n, 2) F_c, F_v of the first fit
    taken_off: Array  # (n, 2) the part of it that was taken off the rows beforehand
    grams: list[JointGram]
    prior_sd: Array  # (1 + base columns,) of y (unused) and the base model; inf: flat
    cad: Index  # base columns whose prior is the robot description
    rotors: Index  # and those whose prior is the data sheet
    stamps: Index  # and those of the stamps, by joint
    drives: int  # and that of the torque's scale, common to the drives
    size: int  # columns in all; column 0 is y
    scales: tuple[float, ...]  # how far links and rotors may be off, for evidence to choose from
    rotor_scales: tuple[float, ...]
    left_open: Array  # (13 n, k) links, rotors, friction along what a model left open of itself; its columns are the base's last
    as_before: NDArray[np.bool_]  # (n,) joints where a model holds as well as of its own recordings
    hidden_before: Array  # (n,) variance over the sensors' noise that a model's own recordings may have held unnoticed
    chosen: frozenset[tuple[str, tuple[int, ...]]]  # effects and joints of what identification chose in these recordings
    lag_std: float  # [s] how far off the lag is that was taken out of all joints' torque before; 0: none was
    mass_tolerance: float  # relative, of the description's masses
    _level: dict[int, float] = field(default_factory=dict)
    _drowned: dict[int, bool] = field(default_factory=dict)
    _columns: Recent[dict[int, tuple[Array, Array]]] = field(default_factory=partial(Recent, RECENT))
    _made: Recent[tuple[Candidate, dict[int, Array]] | None] = field(default_factory=partial(Recent, CACHED))
    _giving: Recent[Giving] = field(default_factory=partial(Recent, PLACES))

    # -- building ---------------------------------------------------------------------------------------------------

    @staticmethod
    def build(robot: Robot, recordings: Recordings, before: Beforehand | None = None) -> Engine:
        """Prepare recordings and set up the base model: rigid body, rotors, Coulomb and viscous friction."""
        before = before or Beforehand()
        data, tol, known = prepare(recordings), before.tolerance or Tolerance(), before.known
        compensated = recordings.meta.effort == "compensated_torque"
        source, n = ArmSignals(robot, data, compensated), robot.n
        motion = _motions(data)
        folds = np.array([motion[t.unit] % FOLDS for t in data.trials], dtype=np.intp)
        if known:
            source.gain, source.gain_std = known.gain, known.gain_std
        scales = known.scales if known else limit.SCALES
        rows = all_rows(source)
        base = 1 + np.arange(10 * n)
        own = 1 + 10 * n + np.arange(5 * n).reshape(n, 5)  # rotor, Coulomb, viscous, left in the poses, stamps
        sd = np.full(2 + 15 * n, np.inf)
        sd[-1] = 1e-6 if compensated else limit.SAME_DRIVES if known else limit.DRIVES  # torque constants off on all joints alike
        sd[base] = link_tolerance(robot, tol).ravel()
        taken_off = np.isfinite([drive.rotor_inertia for drive in robot.drives]) & (not compensated)
        sd[own[:, 0]] = np.where(taken_off, np.maximum(tol.rotor * robot.rotor, 1e-3), np.inf)
        sd[own[:, 4]] = limit.STAMPS * data.kernel.dt  # a torque held over a sample acts half a sample later than its stamp
        friction, grams, whole = np.zeros((n, 2)), [], []
        for j in range(n):
            X = base_columns(source, rows[j])
            if known:
                sd[own[j, 1:3]] = np.maximum(known.deviation[j], 1e-3)
                X[:, 0] -= X[:, -4:-2] @ known.friction[j]
            off = known.friction[j] if known else np.zeros(2)
            friction[j] = first_friction(X, np.concatenate([sd[base] * 10, sd[-1:], sd[own[j]]]), off)
            whole.append(X)
        left_open = _seen(known.left_open, whole) if known and known.left_open.size else np.zeros((13 * n, 0))
        beside = 2 + 15 * n + np.arange(left_open.shape[1])
        sd = np.concatenate([sd, np.ones(len(beside))])
        for j, X in enumerate(whole):
            f = rows[j].column(np.stack([data.direction[:, j], data.dq[:, j]], axis=1) * friction[j])
            index = np.concatenate([[0], base, [1 + 15 * n], own[j], beside]).astype(np.intp)
            X = np.column_stack([X, _whitened_along(left_open, X, j)])
            shown = np.any(X != 0.0, axis=0) | ~np.isin(index, base)  # of links before a joint its torque shows nothing
            grams.append(JointGram.of(np.ascontiguousarray(X[:, shown]), f, rows[j].trial, folds, FOLDS, index[shown]))
        source.set_friction(friction)
        return Engine(
            robot,
            data,
            source,
            rows,
            folds,
            friction,
            known.friction if known else np.zeros((n, 2)),
            grams,
            sd,
            base.astype(np.intp),
            own[:, 0].astype(np.intp),
            own[:, 4].astype(np.intp),
            1 + 15 * n,
            2 + 15 * n + len(beside),
            scales,
            (1.0,) if known else limit.ROTOR_SCALES,
            left_open,
            known.as_before if known else np.zeros(n, bool),
            known.hidden_before if known else np.full(n, np.inf),
            frozenset(
                (e, tuple(data.joints.index(j) for j in at.split("+") if j))
                for e, _, at in (x.partition(":") for x in before.chosen)
            ),
            before.lag_std,
            tol.mass,
        )

    @property
    def modelled(self) -> bool:
        """Whether recordings are held against a model from others, whose rigid body is known far better than a description's."""
        return self.source.gain_std > 0.0

    def add(self, effect: Effect, joints: tuple[int, ...], shapes: Mapping[str, float]) -> Candidate | None:
        """Append an effect's columns to the Grams; None if it leaves no trace in these motions."""
        return next(iter(self.add_all([(effect, joints, shapes)])), None)

    def add_all(self, wanted: Sequence[tuple[Effect, tuple[int, ...], Mapping[str, float]]]) -> list[Candidate]:
        """`add` many at once: each joint's Gram is bordered once."""
        out: list[Candidate] = []
        pending: dict[int, list[tuple[Array, Index]]] = {}
        for effect, joints, shapes in wanted:
            made = self.make(effect, joints, shapes)
            if made is not None:
                candidate, parts = made
                self.size += len(candidate.cols)
                out.append(candidate)
                for i, w in parts.items():
                    pending.setdefault(i, []).append((w, candidate.cols))
        for i, items in pending.items():
            index = np.concatenate([c for _, c in items])
            self.grams[i] = self.grams[i].bordered(np.column_stack([w for w, _ in items]), index)
        return out

    def make(
        self, effect: Effect, joints: tuple[int, ...], shapes: Mapping[str, float]
    ) -> tuple[Candidate, dict[int, Array]] | None:
        """A candidate with the next free column numbers and its whitened columns by joint; None if it leaves no trace."""
        k = len(effect.terms)
        power, level, count = np.zeros(k), 0.0, 0
        parts = {}
        for i, (moving, still) in self.columns(effect, joints, shapes).items():
            plain = self.rows[i].plain(moving)
            power += (plain**2).sum(axis=0)
            count += len(plain)
            level += len(plain) * self._measure(effect, i) ** 2
            parts[i] = self.rows[i].column(moving, still)
        rms = np.sqrt(power / max(count, 1))
        if count == 0 or not np.all(np.isfinite(rms)) or rms.max(initial=0.0) < EMPTY:
            return None
        share = limit.PRIOR_SHARE * np.array([t.share for t in effect.terms])
        sd = share * np.sqrt(level / count) / np.maximum(rms, 1e-6 * rms.max())
        typical = np.array([t.typical for t in effect.terms])
        sd = np.where(np.isfinite(typical), typical, sd)
        if effect.enters == "inertia" and effect.scope == "joint" and self.robot.rotor[joints[0]] > 0:
            sd = np.minimum(sd, limit.ROTOR_SHIFT * self.robot.rotor[joints[0]])
        span = np.array([t.hi - t.lo for t in effect.terms])
        sd = np.where(np.isfinite(span), np.minimum(sd, span / 2), sd)
        return Candidate(effect, joints, dict(shapes), np.arange(self.size, self.size + k), sd), parts

    def columns(self, effect: Effect, joints: tuple[int, ...], shapes: Mapping[str, float]) -> dict[int, tuple[Array, Array]]:
        """`columns` of a law over rows and poses; the last `RECENT` are kept, as those of a claim are asked for again."""
        key = (effect.name, joints, tuple(shapes.items()))
        return self._columns.of(key, lambda: columns(self.source, effect, joints, shapes))

    def giving(self, place: Place, foot: float) -> Giving:
        """`Giving.of` a place with a foot; the last `PLACES` are kept, as every hypothesis asks for them again."""
        return self._giving.of((place.where, foot), lambda: Giving.of(self.source, place, foot))

    def make_again(
        self, effect: Effect, joints: tuple[int, ...], shapes: Mapping[str, float]
    ) -> tuple[Candidate, dict[int, Array]] | None:
        """`make` for a search that comes back to the same shapes: the last `CACHED` are kept."""
        key = (effect.name, joints, tuple(shapes.items()))
        return self._made.of(key, lambda: self.make(effect, joints, shapes))

    def forget(self, joint: int) -> None:
        """Forget what was computed from other rows of ``joint``."""
        self._made.clear()
        self._columns.clear()
        self._level.pop(joint, None)
        self._drowned.pop(joint, None)

    def level(self, joint: int) -> float:
        """Typical friction torque of a joint [N m], the measure of what is large."""
        if joint not in self._level:
            moving = self.rows[joint].plain(self.data.dq[:, joint])
            speed = float(np.sqrt(np.mean(moving**2))) if len(moving) else 0.0
            self._level[joint] = float(self.friction[joint, 0] + self.friction[joint, 1] * speed) or 1.0
        return self._level[joint]

    def _measure(self, effect: Effect, joint: int) -> float:
        """What an effect's torque at a joint is a share of [N m]: its friction, or, of levers that carry weight, what gravity loads it with."""
        if effect.moment_arms and self.loaded((joint,)):
            return float(np.abs(self.source.gravity[:, joint]).max())
        return self.level(joint)

    def drowned(self, effect: Effect, joints: tuple[int, ...]) -> bool:
        """Whether the acceleration that a law is of holds too much of the position's noise.

        That noise is in the recorded torque's error, too: through the inertia that is known, and through a controller that answers it.  So
        rows agree on an inertia that is short by as large a share as the noise has in the acceleration, or on any other, with
        evidence that grows with their number.
        """
        if effect.needs != ("ddq",):
            return False
        j = joints[0]
        if j not in self._drowned:
            rows, d = self.rows[j], self.data
            moved = float(np.sum(rows.column(d.ddq[:, j, None])[: len(rows.take)] ** 2))
            self._drowned[j] = rows.accelerated(d, d.position_noise[j]) > limit.DROWNED * moved
        return self._drowned[j]

    def loaded(self, joints: Sequence[int]) -> bool:
        """Whether gravity loads one of ``joints`` in these motions."""
        return any(float(np.ptp(self.source.gravity[:, j])) >= limit.FLAT * self.level(j) for j in joints)

    def update_source(self, theta: Array) -> None:
        """Let columns that need the arm as it is, not as described, use the base model of a fit; ``theta``: of `Hypothesis.nuisance`."""
        n = self.data.n
        own = theta[10 * n : 15 * n].reshape(n, 5)[:, :3] + self._open_by(theta)[10 * n :].reshape(3, n).T
        self.source.set_fit(self.body(theta), own + np.column_stack([self.robot.rotor, self.taken_off]))
        self._made.clear()
        self._columns.clear()

    def weigh(self, theta: Array, carried: Array) -> None:
        """Let laws of the load use what a fit says that the links, and the load ``carried`` (10,) by the last one, weigh in the recorded torque;
        ``theta``: of `Hypothesis.nuisance`."""
        weight = self.body(theta) + float(theta[self.drives - 1]) * self.robot.pi.ravel()
        weight[-10:] += self.source.gain * carried
        self.source.set_weight(weight)
        self._made.clear()
        self._columns.clear()

    def body(self, theta: Array) -> Array:
        """(10 n,) how far a fit has the links off what was known of them; ``theta``: of `Hypothesis.nuisance`."""
        n = self.data.n
        return np.asarray(theta[: 10 * n] + self._open_by(theta)[: 10 * n])

    def _open_by(self, theta: Array) -> Array:
        """(13 n,) the part of it that the model had left open."""
        first = 1 + 15 * self.data.n
        return np.asarray(self.left_open @ theta[first : first + self.left_open.shape[1]])


def _whitened_along(directions: Array, X: Array, joint: int) -> Array:
    """`along` of a joint's whitened rows; ``X``: of `base_columns`."""
    return along(directions, joint, X[:, 1 : 1 + len(directions) // 13 * 10], X[:, -5:-2])


def _seen(left_open: Array, columns: Sequence[Array]) -> Array:
    """What a model left open and these rows would see: turned so that the directions show independently, each beyond the noise."""
    shown = np.zeros((left_open.shape[1],) * 2)
    for j, X in enumerate(columns):
        W = _whitened_along(left_open, X, j)
        shown += W.T @ W
    size, turn = np.linalg.eigh(shown)
    return np.asarray((left_open @ turn)[:, size > 1.0])


def _motions(data: Prepared) -> dict[Any, int]:
    """Number of the motion of each unit that is held out together: into how many pieces a recording was cut says nothing."""
    ends: dict[Any, Ends] = {}
    for trial in data.trials:
        at = [trial.fine.start, trial.fine.stop - 1]
        own = Ends(data.t_fine[at], data.q_fine[at], data.dq_fine[at])
        ends[trial.unit] = ends[trial.unit].until(own) if trial.unit in ends else own
    recordings = uncut(list(ends.values()))
    return {unit: list(dict.fromkeys(recordings)).index(r) for unit, r in zip(ends, recordings, strict=True)}
