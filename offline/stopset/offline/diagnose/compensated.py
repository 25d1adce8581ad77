"""Diagnosis of compensated torque: the judge is the open-loop simulation on repetitions that were not fitted to.

Such recordings hold ``u`` of eq. (11); there is no rigid body to regress, and torque error alone misleads (a term can lower
it while the simulation diverges).  Joint by joint, every effect of the catalogue that these signals carry is added to the
model, fitted by output error on the even repetitions and simulated on the odd ones.  The best one is claimed while it lowers
the held-out error by at least `OPEN_LOOP_CLAIM`, and in each half of the held-out trials by `OPEN_LOOP_HALVES`; then the next
one is looked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stopset.artifact import Model
from stopset.artifact.inputs import compensated
from stopset.effects import Effect, catalogue, get
from stopset.effects.base import Fitted
from stopset.errors import RecordingError
from stopset.offline.campaign.survey import on_grid, survey
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.answer import Diagnosis, Parameter, Ranked
from stopset.offline.diagnose.explain import advice
from stopset.offline.diagnose.explain.identifiable import REMEDIES, TRACELESS, UNRECORDED, Blind
from stopset.offline.nominal.open_loop import EffectTerm, JointBatch, joint_batches
from stopset.offline.nominal.output_error import JointFit, fit_joint, fit_lag, gauss_newton, residuals
from stopset.progress import Progress, silent
from stopset.recording import Recording, Recordings
from stopset.types import Array

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


def diagnose_open_loop(
    model: Model, recordings: Recordings, names: Sequence[str] | None = None, progress: Progress = silent
) -> Diagnosis:
    """Missing effects of a model of compensated torque. Raises `RecordingError` if no suite was repeated."""
    found = survey(lambda: recordings.trials)
    trials = [r for r in recordings if r.phase == found.phase and len(r.t) > 2]
    even = [r for r in trials if r.repetition % 2 == 0]
    odd = [r for r in trials if r.repetition % 2 == 1]
    if min(len(even), len(odd)) < limit.OPEN_LOOP_TRIALS:
        raise RecordingError(
            f"{len(trials)} trials, {len(odd)} of them odd repetitions; expected suites repeated at least six times: an effect "
            "is fitted on the even repetitions and judged on the odd ones"
        )
    factor = max(1, round(STEP / found.dt))
    dt = found.dt * factor

    def batches(part: list[Recording]) -> list[JointBatch]:
        coarse = [_averaged(on_grid(r, found.dt), factor) for r in part]
        return joint_batches(model.robot, coarse, [found.warm(r) for r in part], dt)

    ranked: list[tuple[Ranked, tuple[str, ...]]] = []
    trained = batches(even)
    for k, (joint, train, held) in enumerate(zip(model.joints, trained, batches(odd), strict=True)):
        progress(
            f"simulating {joint} with every effect: joint {k} of {model.n} done, {len(ranked)} effects found so far", k / model.n
        )
        mine = [f for f in compensated(model.effects, model.abstraction) if f.joint in (joint, None)]
        ranked += _joint(joint, train, held, [_term(f) for f in mine], candidates(train, names))
    ranked.sort(key=lambda r: -r[0].score)
    rivals = tuple((r.label, *others) for r, others in ranked if others)
    return Diagnosis(
        verdict="missing" if ranked else "none",
        ranked=tuple(r for r, _ in ranked),
        rivals=rivals,
        depends_on=(),
        not_identifiable=_blind(model, trained),
        next_experiment=advice.to_decide(rivals),
        trials=len(trials),
        rows=sum(len(r.t) for r in trials),
    )


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
        r, t=r.t[keep], q=r.q[keep], dq=r.dq[keep], tau=tau, temp=None if r.temp is None else r.temp[keep], current=None,
        stop_trigger=None,
    )  # fmt: skip


def _joint(
    joint: str, train: JointBatch, held: JointBatch, terms: list[EffectTerm], pool: list[EffectTerm]
) -> list[tuple[Ranked, tuple[str, ...]]]:
    """Claims at one joint, best first, each with its rivals."""
    p = np.concatenate([fit_lag(train), np.zeros(sum(len(t.effect.terms) for t in terms))])
    p = gauss_newton(train, terms, p) if terms else p
    error, by_trial = _held_out(held, terms, p)
    claims: list[tuple[Ranked, tuple[str, ...]]] = []
    for _ in range(limit.OPEN_LOOP_CLAIMS):
        taken = {t.effect.name for t in terms}
        tried = [_try(train, held, terms, t, p, SCREENING, by_trial) for t in pool if t.effect.name not in taken]
        tried = sorted(tried, key=lambda t: t.error)[:FINALISTS]
        best = sorted((_try(train, held, terms, t.term, t.p, None, by_trial) for t in tried), key=lambda t: t.error)
        if not best or best[0].error > (1 - limit.OPEN_LOOP_CLAIM) * error or best[0].fall < limit.OPEN_LOOP_HALVES:
            break
        top = best[0]
        rivals = tuple(
            dict.fromkeys(
                f"{t.term.effect.name}:{joint}"
                for t in best[1:]
                if t.error < (1 + limit.OPEN_LOOP_RIVAL) * top.error and t.term.effect.name != top.term.effect.name
            )
        )
        terms = [*terms, top.term]
        fit = fit_joint(train, joint, terms)
        claims.append((_ranked(joint, top, fit, error, len(by_trial)), rivals))
        p, error = top.p, top.error
        by_trial = _held_out(held, terms, p)[1]
    return claims


def _try(
    train: JointBatch, held: JointBatch, terms: list[EffectTerm], term: EffectTerm, p: Array, steps: int | None, before: Array
) -> _Trial:
    """One effect beside ``terms``, fitted from ``p`` for a few steps or to the end."""
    more = [*terms, term]
    size = 3 + sum(len(t.effect.terms) for t in more)
    start = np.concatenate([p, np.zeros(size - len(p))])
    fitted = gauss_newton(train, more, start) if steps is None else gauss_newton(train, more, start, steps)
    error, by_trial = _held_out(held, more, fitted)
    halves = [1.0 - float(np.sqrt(by_trial[k::2].sum() / before[k::2].sum())) for k in (0, 1)]
    return _Trial(term, error, min(halves), fitted)


def _held_out(held: JointBatch, terms: list[EffectTerm], p: Array) -> tuple[float, Array]:
    """RMS position error [rad] of the simulation on the held-out trials, and each trial's sum of squares (B,)."""
    N, B = held.inside.shape
    e = residuals(held, terms, p, with_jacobian=False)[0][: N * B].reshape(N, B)
    by_trial = (e**2).sum(axis=0)
    return float(np.sqrt(by_trial.sum() / held.inside.sum())), by_trial


def _ranked(joint: str, top: _Trial, fit: JointFit, before: float, trials: int) -> Ranked:
    effect = top.term.effect
    mine = next(f for f in reversed(fit.effects) if f.effect == effect.name)
    units = {t.symbol: t.unit for t in effect.terms} | {s.symbol: s.unit for s in effect.shapes}
    parameters = {k: Parameter(v, units[k], mine.std.get(k)) for k, v in mine.values.items()}
    # twice the log likelihood ratio if every held-out trial counts once, however many samples it has
    score = 2.0 * trials * float(np.log(before / top.error))
    return Ranked(effect.name, (joint,), score, before, top.error, parameters, effect.look_at, effect.says, "rad")
