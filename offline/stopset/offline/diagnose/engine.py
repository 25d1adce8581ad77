"""The engine of the diagnosis: rows, nuisance and candidate columns of all joints, and the score of every candidate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from stopset.effects import Effect
from stopset.offline.diagnose.columns import Source, columns
from stopset.offline.diagnose.evidence import SIGMAS, JointGram, Projection, gain, project
from stopset.offline.diagnose.prepare import Array, Index, Mask, Prepared, prepare
from stopset.offline.diagnose.rows import JointRows, joint_rows, pose_scatter
from stopset.recording import Recordings
from stopset.robot import Robot

FOLDS = 6
SCALES = (0.3, 1.0, 3.0, 10.0, 30.0)  # how far the CAD may be off, in units of its tolerance; found by evidence
HELD = 1e12  # prior precision of a term held at zero
PRIOR_SHARE = 0.3  # prior deviation of an effect's torque, as a share of the joint's friction: neither tiny nor dominant


@dataclass(frozen=True, slots=True)
class Tolerance:
    """How well the robot description is known, one standard deviation each."""

    mass: float = 0.04  # of each link's mass
    centre: float = 0.003  # [m] of each link's centre of mass
    inertia: float = 0.10  # of each link's inertia
    rotor: float = 0.04  # of each reflected rotor inertia


@dataclass(frozen=True, slots=True)
class Known:
    """What a model from other recordings adds to the description: then only what has *changed* is asked for.

    ``friction``: (n, 2) Coulomb and viscous coefficients; ``spread``: how far they drift from day to day, relative;
    ``gain``: recorded over true torque, common to the drives; ``scales``: how far the rigid body may be off, as `SCALES`.
    """

    friction: Array
    gain: float = 1.0
    spread: float = 0.15
    scales: tuple[float, ...] = (0.1, 0.3)


@dataclass(frozen=True, slots=True)
class Candidate:
    """An effect at its joints with fixed shapes; ``cols``: its global columns; ``sd``: prior deviation of each term."""

    effect: Effect
    joints: tuple[int, ...]
    shapes: Mapping[str, float]
    cols: Index
    sd: Array
    charge: float = 0.0  # evidence to pay for having searched many shapes

    @property
    def key(self) -> tuple[str, tuple[int, ...]]:
        return (self.effect.name, self.joints)


@dataclass(frozen=True, slots=True)
class Scored:
    """A candidate against the current model: ``score`` twice the log Bayes factor; ``theta``, ``cov`` of its terms."""

    candidate: Candidate
    score: float
    theta: Array
    cov: Array

    @property
    def admissible(self) -> bool:
        """Every term within its range, two standard deviations allowed beyond it."""
        sd = np.sqrt(np.maximum(np.diag(self.cov), 0.0))
        return all(t.lo - 2 * s <= v <= t.hi + 2 * s for t, v, s in zip(self.candidate.effect.terms, self.theta, sd, strict=True))


@dataclass(frozen=True, slots=True)
class Hyper:
    """What evidence chooses: friction scale ``sigma`` and noise variance ``kappa`` per joint, CAD error ``scale``."""

    sigma: tuple[float, ...]
    kappa: tuple[float, ...]
    scale: float


@dataclass(slots=True)
class Engine:
    """Everything computed once; `scores` judges candidates against the base model and what has been added to it."""

    robot: Robot
    data: Prepared
    source: Source
    rows: list[JointRows]
    fold_of_trial: Index
    friction: Array  # (n, 2) F_c, F_v of the first fit
    grams: list[JointGram]
    prior_sd: Array  # (1 + base columns,) of y (unused) and the base model; inf: flat
    cad: Index  # base columns whose prior is the robot description
    rotors: Index  # and those whose prior is the data sheet
    size: int  # columns in all; column 0 is y
    scales: tuple[float, ...] = SCALES
    active: list[Candidate] = field(default_factory=list)

    # -- building ---------------------------------------------------------------------------------------------------

    @staticmethod
    def build(robot: Robot, recordings: Recordings, tolerance: Tolerance | None = None, known: Known | None = None) -> Engine:
        """Prepare recordings and set up the base model: rigid body, rotors, Coulomb and viscous friction."""
        data, tol = prepare(recordings), tolerance or Tolerance()
        compensated = recordings.meta.effort == "compensated_torque"
        source, n = Source(robot, data, compensated), robot.n
        units = list(dict.fromkeys(t.unit for t in data.trials))
        folds = np.array([units.index(t.unit) % FOLDS for t in data.trials], dtype=np.intp)
        source.gain = known.gain if known else 1.0
        scales = known.scales if known else SCALES
        rows = _all_rows(source)
        base = 1 + np.arange(10 * n)
        own = 1 + 10 * n + np.arange(5 * n).reshape(n, 5)  # rotor, Coulomb, viscous, left in the poses, stamps
        sd = np.full(1 + 15 * n, np.inf)
        sd[base] = link_tolerance(robot, tol).ravel()
        told = np.isfinite([drive.rotor_inertia for drive in robot.drives]) & (not compensated)
        sd[own[:, 0]] = np.where(told, np.maximum(tol.rotor * robot.rotor, 1e-3), np.inf)
        sd[own[:, 4]] = 0.5 * data.kernel.dt  # a torque held over a sample acts half a sample later than its stamp
        friction, grams = np.zeros((n, 2)), []
        for j in range(n):
            X = _base_columns(source, rows[j])
            if known:
                sd[own[j, 1:3]] = np.maximum(known.spread * known.friction[j], 1e-3)
                X[:, 0] -= X[:, -4:-2] @ known.friction[j]
            friction[j] = known.friction[j] if known else _first_friction(X, np.concatenate([sd[base] * 10, sd[own[j]]]))
            f = rows[j].column(np.stack([data.way[:, j], data.dq[:, j]], axis=1) * friction[j])
            index = np.concatenate([[0], base, own[j]]).astype(np.intp)
            grams.append(JointGram.of(X, f, rows[j].trial, folds, FOLDS, index))
        source.set_friction(friction)
        return Engine(
            robot,
            data,
            source,
            rows,
            folds,
            friction,
            grams,
            sd,
            base.astype(np.intp),
            own[:, 0].astype(np.intp),
            1 + 15 * n,
            scales,
        )

    def add(self, effect: Effect, joints: tuple[int, ...], shapes: Mapping[str, float]) -> Candidate | None:
        """Append an effect's columns to the Grams; None if it leaves no trace in these motions."""
        made = self._make(effect, joints, shapes)
        if made is None:
            return None
        candidate, parts = made
        for i, w in parts.items():
            self.grams[i].append(w, candidate.cols)
        self.size += len(candidate.cols)
        return candidate

    def add_all(self, wanted: Sequence[tuple[Effect, tuple[int, ...], Mapping[str, float]]]) -> list[Candidate]:
        """`add` many at once: each joint's Gram is bordered once."""
        out: list[Candidate] = []
        pending: dict[int, list[tuple[Array, Index]]] = {}
        for effect, joints, shapes in wanted:
            made = self._make(effect, joints, shapes)
            if made is not None:
                candidate, parts = made
                self.size += len(candidate.cols)
                out.append(candidate)
                for i, w in parts.items():
                    pending.setdefault(i, []).append((w, candidate.cols))
        for i, items in pending.items():
            self.grams[i].append(np.column_stack([w for w, _ in items]), np.concatenate([c for _, c in items]))
        return out

    def _make(
        self, effect: Effect, joints: tuple[int, ...], shapes: Mapping[str, float]
    ) -> tuple[Candidate, dict[int, Array]] | None:
        k = len(effect.terms)
        power, level, count = np.zeros(k), 0.0, 0
        parts = {}
        for i, (moving, still) in columns(self.source, effect, joints, shapes).items():
            plain = self.rows[i].plain(moving)
            power += (plain**2).sum(axis=0)
            count += len(plain)
            level += len(plain) * self.level(i) ** 2
            parts[i] = self.rows[i].column(moving, still)
        rms = np.sqrt(power / max(count, 1))
        if count == 0 or not np.all(np.isfinite(rms)) or rms.max(initial=0.0) < 1e-9:
            return None
        sd = PRIOR_SHARE * np.sqrt(level / count) / np.maximum(rms, 1e-6 * rms.max())
        typical = np.array([t.typical for t in effect.terms])
        sd = np.where(np.isfinite(typical), typical, sd)
        span = np.array([t.hi - t.lo for t in effect.terms])
        sd = np.where(np.isfinite(span), np.minimum(sd, span / 2), sd)
        return Candidate(effect, joints, dict(shapes), np.arange(self.size, self.size + k), sd), parts

    def level(self, joint: int) -> float:
        """Typical friction torque of a joint [N m], the measure of what is large."""
        moving = self.rows[joint].plain(self.data.dq)[:, joint]
        speed = float(np.sqrt(np.mean(moving**2))) if len(moving) else 0.0
        return float(self.friction[joint, 0] + self.friction[joint, 1] * speed) or 1.0

    # -- the current model ------------------------------------------------------------------------------------------

    @property
    def nuisance(self) -> Index:
        """Global columns of the base model and of what was added."""
        base = np.arange(1, len(self.prior_sd))
        return np.concatenate([base, *(c.cols for c in self.active)]).astype(np.intp)

    def precision(self, scale: float) -> Array:
        """Prior precision of `nuisance`; ``scale`` widens what the robot description gives."""
        sd = self.prior_sd.copy()
        sd[self.cad] *= scale
        sd[self.rotors] *= max(1.0, scale)  # smoothing itself moves a rotor inertia by a per cent or two
        return 1.0 / np.concatenate([sd[1:], *(c.sd for c in self.active)]) ** 2

    def total(self, hyper: Hyper, folds: Mask | None = None) -> tuple[Array, float]:
        """(C, C) Gram of all joints and the friction scales' log determinant."""
        G, logdet = np.zeros((self.size, self.size)), 0.0
        for gram, s, k in zip(self.grams, hyper.sigma, hyper.kappa, strict=True):
            part, ld = gram.at(s, k, folds)
            G[np.ix_(gram.index, gram.index)] += part
            logdet += ld
        return G, logdet

    def criterion(self, p: Projection, scale: float, logdet: float) -> float:
        """Twice the log evidence of the model without candidate, up to a constant of the data."""
        precision = self.precision(scale)
        return -(p.rss + p.logdet - float(np.log(precision[precision > 0]).sum()) + logdet)

    def fit(self, start: Hyper | None = None) -> tuple[Hyper, Projection]:
        """The current model's hyperparameters by evidence, and its coefficients."""
        n = self.data.n
        view = self._view()
        h = start or Hyper((0.02,) * n, (1.0,) * n, min(1.0, self.scales[-1]))
        for _ in range(3):
            before = h
            for j in range(n):
                h = view._best(h, [replace(h, sigma=_put(h.sigma, j, float(s))) for s in SIGMAS])
            h = view._best(h, [replace(h, scale=s) for s in self.scales])
            p = view._project(h)[0]
            h = replace(h, kappa=tuple(view.kappa(j, p.theta, h.sigma[j]) for j in range(n)))
            if h == before:
                break
        return h, view._project(h)[0]

    def evidence(self, h: Hyper) -> float:
        """Twice the log evidence of the current model at ``h``, comparable between models of the same data."""
        view = self._view()
        p, logdet = view._project(h)
        spread = sum(len(g.X) * float(np.log(k)) for g, k in zip(view.grams, h.kappa, strict=True))
        return view.criterion(p, h.scale, logdet) - spread

    def _view(self) -> Engine:
        """This engine with only the columns of y and the current model: small and quick to refit."""
        wanted = np.concatenate([[0], self.nuisance])
        number = np.full(self.size, -1)
        number[wanted] = np.arange(len(wanted))
        grams = []
        for gram in self.grams:
            small = gram.keep(np.flatnonzero(number[gram.index] >= 0))
            small.index = number[small.index]
            grams.append(small)
        active = [replace(c, cols=number[c.cols]) for c in self.active]
        return replace(self, grams=grams, size=len(wanted), active=active)

    def _project(self, h: Hyper) -> tuple[Projection, float]:
        G, logdet = self.total(h)
        return project(G, 0, self.nuisance, np.zeros(0, np.intp), self.precision(h.scale)), logdet

    def _best(self, now: Hyper, choices: Sequence[Hyper]) -> Hyper:
        """The choice of highest evidence."""
        values = []
        for h in choices:
            p, logdet = self._project(h)
            values.append(self.criterion(p, h.scale, logdet))
        return choices[int(np.argmax(values))] if values else now

    def kappa(self, joint: int, theta: Array, sigma: float) -> float:
        """Residual variance of a joint's rows over the sensors' own noise; 1 where nothing is missing."""
        return max(1.0, self.excess(joint, theta, sigma, 1.0))

    def excess(self, joint: int, theta: Array, sigma: float, kappa: float) -> float:
        """As `kappa`, not cut off at 1; ``theta``: coefficients of `nuisance`."""
        gram = self.grams[joint]
        full = np.zeros(self.size)
        full[0] = -1.0
        full[self.nuisance] = theta
        G, _ = gram.at(sigma, kappa)
        v = full[gram.index]
        return float(v @ G @ v * kappa) / max(1, len(gram.X))

    # -- scores -----------------------------------------------------------------------------------------------------

    def scores(self, candidates: Sequence[Candidate], hyper: Hyper, quick: bool = False) -> list[Scored]:
        """Every candidate against the current model, best first, each with its own best hyperparameters.

        ``quick``: at the hyperparameters given, for comparing shapes of one effect.
        """
        if not candidates:
            return []
        rest = np.unique(np.concatenate([c.cols for c in candidates]))
        place = np.full(self.size, -1)
        place[rest] = np.arange(len(rest))
        base_G, base_logdet = self.total(hyper)
        nuisance = self.nuisance
        base = project(base_G, 0, nuisance, rest, self.precision(hyper.scale))
        reference = self.criterion(base, hyper.scale, base_logdet)
        best: dict[int, Scored] = {}

        def consider(p: Projection, bonus: float, which: Sequence[int]) -> None:
            for k in which:
                c = candidates[k]
                ix = place[c.cols]
                value, theta, cov = _gain_within(p.S[np.ix_(ix, ix)], p.s[ix], c)
                value += bonus - c.charge
                if k not in best or value > best[k].score:
                    best[k] = Scored(c, value, theta, cov)

        everyone = range(len(candidates))
        consider(base, 0.0, everyone)
        if quick:
            return sorted(best.values(), key=lambda r: -r.score)
        for scale in self.scales:
            if scale != hyper.scale:
                p = project(base_G, 0, nuisance, rest, self.precision(scale))
                consider(p, self.criterion(p, scale, base_logdet) - reference, everyone)
        for j in range(self.data.n):
            touching = [k for k in everyone if j in candidates[k].joints]
            smaller = [s for s in SIGMAS if s < hyper.sigma[j]]
            gram = self.grams[j]
            here, ld = gram.at(hyper.sigma[j], hyper.kappa[j])
            for s in smaller if touching else []:
                there, ld2 = gram.at(float(s), hyper.kappa[j])
                G = base_G.copy()
                G[np.ix_(gram.index, gram.index)] += there - here
                p = project(G, 0, nuisance, rest, self.precision(hyper.scale))
                consider(p, self.criterion(p, hyper.scale, base_logdet + ld2 - ld) - reference, touching)
        return sorted(best.values(), key=lambda r: -r.score)

    def score_new(
        self, effect: Effect, joints: tuple[int, ...], shapes: Mapping[str, float], hyper: Hyper, quick: bool = False
    ) -> Scored | None:
        """Score of an effect with new shapes, without keeping its columns."""
        made = self._make(effect, joints, shapes)
        if made is None:
            return None
        candidate, parts = made
        view = self._view()
        candidate = replace(candidate, cols=np.arange(view.size, view.size + len(candidate.cols)))
        for i, w in parts.items():
            view.grams[i].append(w, candidate.cols)
        view.size += len(candidate.cols)
        return view.scores([candidate], hyper, quick)[0]


def _gain_within(S: Array, s: Array, c: Candidate) -> tuple[float, Array, Array]:
    """`gain`; of several terms those that come out beyond their range are held at zero, where that lies in it."""
    value, theta, cov = gain(S, s, 1.0 / c.sd**2)
    terms = c.effect.terms
    beyond = np.array([not t.lo <= v <= t.hi and t.lo <= 0.0 <= t.hi for t, v in zip(terms, theta, strict=True)])
    if len(terms) == 1 or not beyond.any() or beyond.all():
        return value, theta, cov
    return gain(S, s, np.where(beyond, HELD, 1.0 / c.sd**2))


def _put(values: tuple[float, ...], j: int, value: float) -> tuple[float, ...]:
    return (*values[:j], value, *values[j + 1 :])


def _all_rows(source: Source) -> list[JointRows]:
    d, Ys = source.data, source.regressor_still
    thin = slice(None, None, max(1, len(d.q) // 500))
    typical = np.sqrt(np.mean(source.mass[thin] ** 2, axis=0)) + np.diag(source.robot.rotor)
    scatter = [pose_scatter(Ys[:, j], d.tau_still[:, j]) if len(Ys) else float("inf") for j in range(d.n)]
    return [joint_rows(d, j, typical[j], scatter[j]) for j in range(d.n)]


def _base_columns(source: Source, rows: JointRows) -> Array:
    """y (against the description), rigid body, and the joint's rotor, friction, friction left in the poses, stamps."""
    d, j = source.data, rows.joint
    y = d.tau[:, j] - source.link[:, j] - source.robot.rotor[j] * d.ddq[:, j]
    moving = [y, d.ddq[:, j], d.way[:, j], d.dq[:, j], np.zeros(len(d.q)), -source.rigid(j).dtau]
    still = np.zeros((len(d.q_still), len(moving)))
    still[:, 0] = d.tau_still[:, j] - (0.0 if source.compensated else 1.0) * source.load_still[:, j]
    still[:, 4] = 1.0
    own = rows.column(np.stack(moving, axis=1), still)
    share = 0.0 if source.compensated else 1.0
    body = rows.column(share * source.regressor[:, j], share * source.regressor_still[:, j])
    return np.column_stack([own[:, 0], body, own[:, 1:]])


def _first_friction(X: Array, sd: Array) -> Array:
    """Coulomb and viscous coefficients of a joint fitted alone: the shape of its friction's random scale."""
    A = X[:, 1:].T @ X[:, 1:] + np.diag(1.0 / sd**2 + 1e-9)
    theta = np.linalg.lstsq(A, X[:, 1:].T @ X[:, 0], rcond=1e-14)[0]
    out: Array = np.maximum(theta[-4:-2], 0.0)
    return out


def link_tolerance(robot: Robot, tol: Tolerance) -> Array:
    """(n, 10) standard deviations of the links' standard parameters from the description's tolerance."""
    pi = robot.pi
    m = pi[:, :1]
    first = np.sqrt((tol.mass * pi[:, 1:4]) ** 2 + (tol.centre * m) ** 2)
    size = np.maximum(np.abs(pi[:, [4, 6, 9]]).max(axis=1, keepdims=True), 1e-4)
    return np.concatenate([tol.mass * m, first, np.repeat(tol.inertia * size, 6, axis=1)], axis=1)
