"""Diagnosis of compensated torque: the judge is the open-loop simulation on repetitions that were not fitted to.

Such recordings hold ``u`` of eq. (11); there is no rigid body to regress, and torque error alone misleads (a term can lower
it while the simulation diverges).  Joint by joint, every effect of the catalogue that these signals carry is added to the
model, fitted by output error on the even repetitions and simulated on the odd ones.  The best one is claimed while it lowers
the held-out error by at least `OPEN_LOOP_CLAIM`, and in each half of the held-out trials by `OPEN_LOOP_HALVES`; then the next
one is looked for.  The torque error of the held-out trials has a veto: claims that raise it are dropped, unless a later one
of the joint brings it down again.  Those stand together only: a joint that warms while gravity is not right for it, say.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stopset.artifact import Model
from stopset.artifact.inputs import compensated
from stopset.effects import Effect, catalogue, get
from stopset.effects.base import Fitted
from stopset.effects.selection import matches
from stopset.errors import RecordingError
from stopset.offline.abstraction.nominal_part import mean_inertia
from stopset.offline.campaign.survey import Survey, on_grid, survey
from stopset.offline.compare.known import TorqueModel
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.answer import Diagnosis, Parameter, Ranked
from stopset.offline.diagnose.explain import advice
from stopset.offline.diagnose.explain.identifiable import REMEDIES, TRACELESS, UNRECORDED, Blind
from stopset.offline.diagnose.lacking import lacking, rises
from stopset.offline.nominal.open_loop import EffectTerm, JointBatch, joint_batches
from stopset.offline.nominal.output_error import fit_joint, fit_lag, gauss_newton, residuals, start
from stopset.progress import Progress, silent
from stopset.recording import Recording, Recordings
from stopset.types import Array
from stopset.words import many

STEP = 0.016  # [s] the data are averaged to about this: effects of friction and load need no finer step
SCREENING = 2  # steps of the fit that pick the contenders
FINALISTS = 3  # that are fitted to the end
CARRIED = frozenset({"q", "dq", "load", "temp", "warm", "t"})  # signals there are without acceleration and rigid body


@dataclass(frozen=True, slots=True)
class _Trial:
    """An effect tried at a joint: its held-out RMS position error, its least relative fall in a half of the trials, and its parameters."""

    term: EffectTerm
    error: float
    fall: float
    p: Array


@dataclass(frozen=True, slots=True)
class _Claim:
    """An effect claimed at a joint: held-out error ``before`` it, effects that say almost as much, and held-out torque errors with it.

    ``torque`` (B,): as `lacking`; ``together``: effects of this joint without which it would raise them.
    """

    trial: _Trial
    before: float
    rivals: tuple[str, ...]
    torque: Array
    together: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        return self.trial.term.effect.name


@dataclass(frozen=True, slots=True)
class _Joint:
    """A joint's trials, even and odd; the terms its model has; what was claimed beside them, one after another.

    ``refitted``, ``fitted``: numbers of both, estimated together; ``torque`` (B,): as `lacking`, without the claims; ``dropped``:
    what lowers the position's error and raises the torque's.
    """

    name: str
    train: JointBatch
    held: JointBatch
    own: tuple[EffectTerm, ...]
    claims: tuple[_Claim, ...]
    refitted: tuple[Fitted, ...]
    fitted: tuple[Fitted, ...]
    torque: Array
    dropped: tuple[_Claim, ...] = ()

    def ranked(self) -> list[Ranked]:
        return [_ranked(self.name, c, f, self.held.inside.shape[1]) for c, f in zip(self.claims, self.fitted, strict=True)]

    def errors(self, chosen: Sequence[str]) -> tuple[float, Array]:
        """Held-out errors with the claims ``chosen`` by name, in this order: of the position [rad], of the torque as `lacking`."""
        names = [c.name for c in self.claims]
        if list(chosen) == names[: len(chosen)]:
            position = [*(c.before for c in self.claims), *(c.trial.error for c in self.claims[-1:])]
            torque = [self.torque, *(c.torque for c in self.claims)]
            return position[len(chosen)], torque[len(chosen)]
        by = dict(zip(names, self.claims, strict=True))
        terms = [*self.own, *(by[name].trial.term for name in chosen)]
        p = _fitted(self.train, terms)
        return _held_out(self.held, terms, p)[0], lacking(self.held, terms, p)

    def notes(self) -> list[str]:
        """What was looked at and not claimed, for people."""
        before = self.claims[-1].torque if self.claims else self.torque
        return [
            f"{c.name}:{self.name} would lower the simulated position's error from {c.before:.3g} to {c.trial.error:.3g} rad and raise "
            f"the torque's from {_root(before):.3g} to {_root(c.torque):.3g} N m, both on repetitions it was not fitted to: "
            "not claimed"
            for c in self.dropped[:1]
        ]


@dataclass(frozen=True, slots=True)
class JointStep:
    """Held-out errors of a joint before and after a claim: of its position [rad], of its torque, (B,) as `lacking`."""

    position: tuple[float, float]
    torque: tuple[Array, Array]


@dataclass(frozen=True, slots=True)
class OpenLoop:
    """What simulations of compensated torque say is missing, joint by joint."""

    joints: tuple[_Joint, ...]
    trials: int
    rows: int

    def ranked(self) -> tuple[tuple[Ranked, tuple[str, ...]], ...]:
        """Claims with their rivals, the most telling first, but a joint's own in the order they were made in."""
        rows = []
        for joint in self.joints:
            least = np.inf
            for r, claim in zip(joint.ranked(), joint.claims, strict=True):
                least = min(least, r.score)
                rows.append((least, r, claim.rivals))
        return tuple((r, rivals) for _, r, rivals in sorted(rows, key=lambda x: -x[0]))

    def matching(self, name: str) -> list[Ranked]:
        """The claims that ``name`` asks for, in their order."""
        return [r for r, _ in self.ranked() if matches(r.fitted, name)]

    def besides(self, chosen: Sequence[Ranked], joints: Collection[str]) -> tuple[str, ...]:
        """Claims at ``joints`` that are not among the ``chosen``."""
        taken = {r.label for r in chosen}
        return tuple(r.label for r, _ in self.ranked() if r.joints[0] in joints and r.label not in taken)

    def steps(self, chosen: Sequence[Ranked]) -> list[JointStep]:
        """Held-out errors of its joint before and after each of the claims ``chosen``, beside those before it."""
        by, taken, out = {j.name: j for j in self.joints}, dict[str, list[str]](), []
        for r in chosen:
            mine = taken.setdefault(r.joints[0], [])
            joint = by[r.joints[0]]
            before = joint.errors(mine)
            mine.append(r.effect)
            after = joint.errors(mine)
            out.append(JointStep((before[0], after[0]), (before[1], after[1])))
        return out

    def with_claims(self, model: Sequence[Fitted], chosen: Sequence[Ranked]) -> tuple[Fitted, ...]:
        """Effects of a ``model`` once it has the claims ``chosen``; at their joints its own numbers held what was missing until now."""
        touched = {r.joints[0] for r in chosen}
        anew = {f.label: f for joint in self.joints if joint.name in touched for f in joint.refitted}
        return (*(anew.get(f.label, f) for f in model), *(r.fitted for r in chosen))


def diagnose_open_loop(
    model: Model, recordings: Recordings, names: Sequence[str] | None = None, progress: Progress = silent
) -> Diagnosis:
    """Missing effects of a model of compensated torque, of ``names`` only. Raises `RecordingError` if no suite was repeated."""
    found = search_open_loop(model, recordings, survey(lambda: recordings.trials), progress)
    ranked = [(r, rivals) for r, rivals in found.ranked() if names is None or r.effect in names or r.label in names]
    rivals = tuple((r.label, *others) for r, others in ranked if others)
    return Diagnosis(
        verdict="missing" if ranked else "none",
        ranked=tuple(r for r, _ in ranked),
        rivals=rivals,
        depends_on=(),
        not_identifiable=_blind(model, [j.train for j in found.joints]),
        next_experiment=advice.to_decide(rivals),
        trials=found.trials,
        rows=found.rows,
        notes=tuple(note for j in found.joints for note in j.notes()),
    )


def search_open_loop(
    model: Model | TorqueModel,
    recordings: Recordings,
    found: Survey,
    progress: Progress = silent,
    *,
    joints: Collection[str] | None = None,
) -> OpenLoop:
    """The search that `diagnose`, `add` and `identify --effects` share; ``found``: the campaign's survey.

    The whole catalogue is searched whoever asks: an effect looked for alone takes up what another one does.  ``joints``: of these
    only, for in compensated torque every joint is a system of its own.  Motions that a model's sets are judged on are left out.
    Errors are those of odd repetitions, which the fit has not seen; the numbers come from all.
    Raises `RecordingError` if no suite was repeated.
    """
    trials = [r for r in recordings if r.phase == found.phase and len(r.t) > 2 and r.suite_key not in found.held_out]
    even = [r for r in trials if r.repetition % 2 == 0]
    odd = [r for r in trials if r.repetition % 2 == 1]
    if min(len(even), len(odd)) < limit.OPEN_LOOP_TRIALS:
        raise RecordingError(
            f"{many(len(trials), 'trial')}, {len(odd)} of them odd repetitions; expected suites repeated at least six times: an effect "
            "is fitted on the even repetitions and judged on the odd ones"
        )
    factor = max(1, round(STEP / found.dt))

    def batches(part: list[Recording], factor: int) -> list[JointBatch]:
        grid = [on_grid(r, found.dt) for r in part]
        coarse = [_averaged(r, factor) for r in grid] if factor > 1 else grid
        return joint_batches(model.robot, coarse, [found.warm(r) for r in part], found.dt * factor)

    searched: list[_Joint] = []
    material = zip(model.robot.joints, batches(even, factor), batches(odd, factor), batches(trials, 1), strict=True)
    asked = [(j, m) for j, m in enumerate(material) if joints is None or m[0] in joints]
    inertia = np.diag(mean_inertia(model.robot, model.robot.rotor, found))
    for k, (j, (name, train, held, whole)) in enumerate(asked):
        so_far = sum(len(x.claims) for x in searched)
        progress(
            f"simulating {name} with every effect: joint {k} of {len(asked)} done, {so_far} effects found so far", k / len(asked)
        )
        own = tuple(_term(f) for f in compensated(model.effects, model.abstraction) if f.joint in (name, None))
        found_there = tuple(_claims(name, train, held, list(own), candidates(train, None)))
        torque = lacking(held, own, _fitted(train, own))
        claims = standing(torque, found_there)
        terms = [*own, *(c.trial.term for c in claims)]
        fitted = fit_joint(whole, name, terms, float(inertia[j])).effects if claims else ()
        searched.append(
            _Joint(name, train, held, own, claims, fitted[: len(own)], fitted[len(own) :], torque, found_there[len(claims) :])
        )
    return OpenLoop(tuple(searched), len(trials), sum(len(r.t) for r in trials))


def candidates(batch: JointBatch, names: Sequence[str] | None) -> list[EffectTerm]:
    """Effects that these signals carry, each with the start values of its shapes."""
    out = []
    for effect in catalogue().values():
        if effect.base or effect.scope != "joint" or effect.states or not set(effect.needs) <= CARRIED:
            continue
        if names is not None and effect.name not in names:
            continue
        if _left_out(effect) or _silent(effect, batch):
            continue
        grids = {s.symbol: s.grid for s in effect.shapes}
        shapes = [{}] if not grids else [{k: g[i] for k, g in grids.items()} for i in range(min(map(len, grids.values())))]
        out += [EffectTerm(effect, s) for s in shapes]
    return out


def _blind(model: Model, batches: Sequence[JointBatch]) -> tuple[Blind, ...]:
    """Effects of the catalogue that compensated torque cannot show, or these motions do not."""
    out = []
    for effect in catalogue().values():
        if effect.base:
            continue
        if effect.scope != "joint" or effect.states or not set(effect.needs) <= CARRIED or _left_out(effect):
            out.append(Blind(effect.name, (), "compensated torque does not carry it", "Record the torque of the motors itself."))
            continue
        silent = tuple(j for j, batch in zip(model.joints, batches, strict=True) if _silent(effect, batch))
        if silent and "temp" in effect.needs:
            out.append(Blind(effect.name, (), UNRECORDED, REMEDIES[UNRECORDED]))
        elif silent and "warm" not in effect.needs:
            out.append(Blind(effect.name, silent, TRACELESS, effect.distinguished_by))
    return tuple(out)


def _left_out(effect: Effect) -> bool:
    """What repeats within a turn is too fast for this step; a constant torque is in every model."""
    return effect.periodic or effect.part == "constant torque"


def _silent(effect: Effect, batch: JointBatch) -> bool:
    """Whether a signal the effect lives on does not vary here: no temperature recorded, no load on an upright axis."""
    if "temp" in effect.needs:
        return not np.ptp(batch.temp) > 0
    if "warm" in effect.needs:
        return bool(np.ptp(batch.temp) > 0) or not np.ptp(batch.warm) > 0
    return "load" in effect.needs and not np.ptp(batch.load) > limit.OPEN_LOOP_LOAD


def _term(f: Fitted) -> EffectTerm:
    effect = get(f.effect)
    return EffectTerm(effect, {s.symbol: f.values[s.symbol] for s in effect.shapes})


def _averaged(r: Recording, factor: int) -> Recording:
    """Every ``factor``-th state, with the mean torque until the next one: the same impulse on a coarser grid."""
    rows = len(r.t) // factor
    keep = slice(0, rows * factor, factor)
    tau = r.tau[: rows * factor].reshape(rows, factor, -1).mean(axis=1)
    return replace(
        r, t=r.t[keep], q=r.q[keep], dq=r.dq[keep], tau=tau, q_link=None, temp=None if r.temp is None else r.temp[keep], current=None,
        stop_trigger=None,
    )  # fmt: skip


def _claims(joint: str, train: JointBatch, held: JointBatch, terms: list[EffectTerm], pool: list[EffectTerm]) -> Iterator[_Claim]:
    """Claims at one joint, one after another."""
    p = _fitted(train, terms)
    error, by_trial = _held_out(held, terms, p)
    for _ in range(limit.OPEN_LOOP_CLAIMS):
        taken = {t.effect.name for t in terms}
        tried = [_try(train, held, terms, t, p, SCREENING, by_trial) for t in pool if t.effect.name not in taken]
        tried = sorted(tried, key=lambda t: t.error)[:FINALISTS]
        best = sorted((_try(train, held, terms, t.term, t.p, None, by_trial) for t in tried), key=lambda t: t.error)
        if not best or best[0].error > (1 - limit.OPEN_LOOP_CLAIM) * error or best[0].fall < limit.OPEN_LOOP_HALVES:
            return
        top = best[0]
        rivals = tuple(
            dict.fromkeys(
                f"{t.term.effect.name}:{joint}"
                for t in best[1:]
                if t.error < (1 + limit.OPEN_LOOP_RIVAL) * top.error and t.term.effect.name != top.term.effect.name
            )
        )
        terms = [*terms, top.term]
        yield _Claim(top, error, rivals, lacking(held, terms, top.p))
        p, error = top.p, top.error
        by_trial = _held_out(held, terms, p)[1]


def standing(torque: Array, claims: Sequence[_Claim]) -> tuple[_Claim, ...]:
    """The claims of a joint, in order, that do not raise its held-out ``torque`` error (B,), alone or with those they stand together with."""
    out: list[_Claim] = []
    for k, claim in enumerate(claims):
        if not rises(torque, claim.torque):
            group = claims[len(out) : k + 1]
            out += [replace(c, together=tuple(x.name for x in group if x is not c)) for c in group]
            torque = claim.torque
    return tuple(out)


def _root(mean_squares: Array) -> float:
    return float(np.sqrt(mean_squares.mean()))


def _fitted(train: JointBatch, terms: Sequence[EffectTerm]) -> Array:
    """Parameters of a joint with ``terms``."""
    p = fit_lag(train)
    return gauss_newton(train, terms, start(train, terms, p)) if terms else p


def _try(
    train: JointBatch, held: JointBatch, terms: list[EffectTerm], term: EffectTerm, p: Array, steps: int | None, before: Array
) -> _Trial:
    """One effect beside ``terms``, fitted from ``p`` for a few steps or to the end."""
    more = [*terms, term]
    size = 3 + sum(len(t.effect.terms) for t in more)
    begun = np.concatenate([p, np.zeros(size - len(p))])
    fitted = gauss_newton(train, more, begun) if steps is None else gauss_newton(train, more, begun, steps)
    error, by_trial = _held_out(held, more, fitted)
    halves = [1.0 - float(np.sqrt(by_trial[k::2].sum() / before[k::2].sum())) for k in (0, 1)]
    return _Trial(term, error, min(halves), fitted)


def _held_out(held: JointBatch, terms: list[EffectTerm], p: Array) -> tuple[float, Array]:
    """RMS position error [rad] of the simulation on the held-out trials, and each trial's sum of squares (B,)."""
    N, B = held.inside.shape
    e = residuals(held, terms, p, with_jacobian=False)[0][: N * B].reshape(N, B)
    by_trial = (e**2).sum(axis=0)
    return float(np.sqrt(by_trial.sum() / held.inside.sum())), by_trial


def _ranked(joint: str, claim: _Claim, fitted: Fitted, trials: int) -> Ranked:
    effect, error = claim.trial.term.effect, claim.trial.error
    units = {t.symbol: t.unit for t in effect.terms} | {s.symbol: s.unit for s in effect.shapes}
    parameters = {k: Parameter(v, units[k], fitted.std.get(k)) for k, v in fitted.values.items()}
    # twice the log likelihood ratio if every held-out trial counts once, however many samples it has
    score = 2.0 * trials * float(np.log(claim.before / error))
    together = tuple(f"{name}:{joint}" for name in claim.together)
    says = (
        f"{effect.says} Add it with {', '.join(together)}: alone it would raise the torque's error." if together else effect.says
    )
    return Ranked(
        effect.name, (joint,), score, claim.before, error, parameters, effect.look_at, says, "rad", together=together
    )  # fmt: skip
