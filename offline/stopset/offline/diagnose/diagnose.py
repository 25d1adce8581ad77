"""Which physical effect is missing: the question from outside, and the answer in plain words and in JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from stopset.artifact import Model
from stopset.effects import Effect, Fitted, get
from stopset.effects.selection import of_part
from stopset.errors import EffectError
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.changes import Change, changes
from stopset.offline.diagnose.evidence.baseline import baseline, settled
from stopset.offline.diagnose.evidence.engine import Candidate, Engine, Hyper, Known, Scored
from stopset.offline.diagnose.explain import advice
from stopset.offline.diagnose.explain.doubt import doubt, within
from stopset.offline.diagnose.explain.identifiable import Blind, blind_spots
from stopset.offline.diagnose.explain.leftover import Pattern, pattern
from stopset.offline.diagnose.explain.partial import Partial, partial
from stopset.offline.diagnose.explain.residual import Dependence, dependences, slow_excess
from stopset.offline.diagnose.explain.uncertainty import TWO_SIDES, deviations
from stopset.offline.diagnose.search.held_out import held_out
from stopset.offline.diagnose.search.search import Claim, Found, search
from stopset.offline.nominal.prior import Tolerance
from stopset.recording import Recording, Recordings
from stopset.robot import Robot
from stopset.types import Array

SINCE = "Record the same motion again after a while: what keeps changing wears, what came at once was done to the arm."
MOVE = "Move every joint through its range at several speeds."


@dataclass(frozen=True, slots=True)
class Parameter:
    """A value with unit and standard deviation (None where the recordings do not tell it)."""

    value: float
    unit: str
    std: float | None


@dataclass(frozen=True, slots=True)
class Ranked:
    """One missing effect: where, how sure, how large, what it changes."""

    effect: str
    joints: tuple[str, ...]
    score: float
    error_before: float  # [N m] held-out torque error of its joint (of the worst joint for the whole arm)
    error_after: float
    parameters: dict[str, Parameter]
    look_at: str
    says: str
    unit: str = "N m"  # of the errors: rad where a simulation is judged
    points: Partial | None = None  # to draw what it explains; None where a simulation is judged
    change: Change | None = None  # of a level that the model had
    doubt: str = ""  # why it is no finding after all
    in_model: bool = False  # `identify` chose it by evidence already: what `add` then does is make it a revision of its own

    @property
    def label(self) -> str:
        return self.effect if not self.joints else f"{self.effect}:{'+'.join(self.joints)}"

    @property
    def fitted(self) -> Fitted:
        """As the model file holds it."""
        values = {k: p.value for k, p in self.parameters.items()}
        std = {k: p.std for k, p in self.parameters.items() if p.std is not None}
        return Fitted(self.effect, "+".join(self.joints) or None, values, std)


@dataclass(frozen=True, slots=True)
class Unexplained:
    """What is left of a joint: ``size`` [N m] held-out torque error, ``depends_on`` variables, ``resembles`` claims that are in
    doubt, with the reason of each."""

    joint: str
    size: float
    depends_on: tuple[str, ...]
    resembles: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """``verdict``: missing, none or unknown; see ``interfaces``, diagnose --json."""

    verdict: str
    ranked: tuple[Ranked, ...]
    rivals: tuple[tuple[str, ...], ...]
    depends_on: tuple[str, ...]
    not_identifiable: tuple[Blind, ...]
    next_experiment: str | None
    excess: dict[str, float] = field(default_factory=dict)  # leftover variance over sensor noise, per joint
    friction_scatter: dict[str, float] = field(default_factory=dict)  # from trial to trial, relative
    trials: int = 0
    rows: int = 0
    claims: tuple[Ranked, ...] = ()  # what the evidence speaks for, also where more is missing than it explains
    notes: tuple[str, ...] = ()  # on what the recordings were measured against
    changed: tuple[Change, ...] = ()  # since identification, also beside what is missing
    unexplained: tuple[Unexplained, ...] = ()  # what is left of each joint's torque, where that is more than the sensors' noise

    def as_json(self) -> dict[str, Any]:
        """Plain data of the answer's fixed shape."""
        return {
            "verdict": self.verdict,
            "ranked_effects": [
                {
                    "effect": r.effect,
                    "joint": None if not r.joints else r.joints[0] if len(r.joints) == 1 else list(r.joints),
                    "score": round(r.score, 2),
                    "error_before": r.error_before,
                    "error_after": r.error_after,
                    "unit": r.unit,
                    "parameters": {k: {"value": p.value, "unit": p.unit, "std": p.std} for k, p in r.parameters.items()},
                    "look_at": r.look_at,
                    "says": r.says,
                    "in_model": r.in_model,
                }
                | ({} if r.change is None else {"change": {k: getattr(r.change, k) for k in ("before", "after", "std")}})
                for r in self.ranked
            ],
            "rivals": [list(group) for group in self.rivals],
            "depends_on": list(self.depends_on),
            "not_identifiable": [
                {"effect": b.effect, "joints": list(b.joints), "why": b.why, "experiment": b.experiment}
                for b in self.not_identifiable
            ],
            "unexplained": [
                {
                    "joint": u.joint,
                    "size": u.size,
                    "unit": "N m",
                    "depends_on": list(u.depends_on),
                    "resembles": list(u.resembles),
                }
                for u in self.unexplained
            ],
            "changed": [c.says for c in self.changed],
            "next_experiment": self.next_experiment,
            "notes": list(self.notes),
            "excess": self.excess,
            "friction_scatter": self.friction_scatter,
            "threshold": limit.THRESHOLD,
            "trials": self.trials,
            "rows": self.rows,
        }


@dataclass(frozen=True, slots=True)
class Examination:
    """The search over recordings that move, and what it left: all that answers, judgements and estimates are taken from."""

    engine: Engine
    found: Found
    already: tuple[Candidate, ...]  # effects that the model has
    left: _Left
    ranked: tuple[Ranked, ...]

    def matching(self, effect: str, joints: Sequence[str] | None) -> tuple[int, ...]:
        """Which claims are of an effect, at these joints (None: wherever it acts)."""
        wanted = None if joints is None else set(joints)
        return tuple(
            k
            for k, r in enumerate(self.ranked)
            if r.effect == effect and not r.doubt and (wanted is None or set(r.joints) == wanted)
        )

    def errors(self, claims: Sequence[int]) -> list[Array]:
        """Held-out torque error (n,) [N m] without any claim and after each of ``claims`` in turn, the others left out."""
        return _errors(self.engine, self.found, self.already, [self.found.claims[k] for k in claims])


def examine(
    robot: Robot, recordings: Recordings, fitted: Sequence[Fitted] = (), tolerance: Tolerance | None = None,
    names: Sequence[str] | None = None, known: Known | None = None,
) -> Examination:  # fmt: skip
    """Search ``recordings``, of which some trial moves, for what `diagnose` answers about; the arguments are its."""
    engine = Engine.build(robot, recordings, tolerance, known)
    _include(engine, fitted)
    already = tuple(engine.active)
    found = search(engine, names)
    left = _left(found, engine)
    return Examination(engine, found, already, left, _ranked(engine, found, already, left))


def diagnose(
    robot: Robot,
    recordings: Recordings,
    fitted: Sequence[Fitted] = (),
    tolerance: Tolerance | None = None,
    names: Sequence[str] | None = None,
    known: Known | None = None,
) -> Diagnosis:
    """Find the effects that the rigid body of ``robot`` and friction (and ``fitted``) do not explain in ``recordings``.

    ``robot``: description and data sheet, the prior of what is known; ``fitted``: effects the model already has (kept as
    nuisance, refitted); ``names``: look for these effects only; ``known``: a model from other recordings.
    Raises `RecordingError` where no trial moves, `EffectError` for an effect that does not fit the robot.
    """
    if not any(moves(r) for r in recordings):
        return standing(robot, recordings, fitted)
    return answered(examine(robot, recordings, fitted, tolerance, names, known), names)


def answered(x: Examination, names: Sequence[str] | None = None) -> Diagnosis:
    """The answer that an examination gives; ``names``: of these effects only, whatever else was found beside them."""
    engine, found, left = x.engine, x.found, x.left
    ranked = tuple(r for r in x.ranked if not r.doubt and (names is None or r.effect in names))
    claims = [c for c, r in zip(found.claims, x.ranked, strict=True) if r in ranked]
    verdict = _verdict(found, left)
    if verdict == "missing" and not ranked:
        verdict = "unknown" if any(r.doubt for r in x.ranked) else "none"
    blind = blind_spots(engine, found.hyper, [s.candidate for s in found.left], names)
    rivals = _rivals(engine, claims) if verdict == "missing" else ()
    joints = engine.data.joints
    worst, shown = left.worst, None
    if worst is not None and (verdict == "unknown" or left.depends):
        shown = pattern(engine, left.theta, left.hyper, worst, left.ranking[worst], limit.PATTERN)
    next_experiment = {
        "unknown": lambda: None if worst is None else advice.to_explain(joints[worst], shown),
        "missing": lambda: advice.to_decide(rivals),
        "none": lambda: advice.to_see(blind),
    }[verdict]()
    return Diagnosis(
        verdict=verdict,
        ranked=ranked if verdict == "missing" else (),
        claims=ranked,
        rivals=rivals,
        depends_on=_depends(verdict, worst, shown, joints),
        not_identifiable=blind,
        next_experiment=next_experiment,
        unexplained=_unexplained(x),
        excess={j: round(float(x), 3) for j, x in zip(joints, found.excess, strict=True)},
        friction_scatter=dict(zip(joints, found.hyper.sigma, strict=True)),
        trials=len(engine.data.trials),
        rows=sum(r.size for r in engine.rows),
    )


def diagnose_model(model: Model, recordings: Recordings, names: Sequence[str] | None = None) -> tuple[Diagnosis, str]:
    """`diagnose` for a model file, with ``names`` of these effects only; also says what the recordings were measured against.

    The whole catalogue is searched whatever is asked for: an effect looked for alone takes up what another one does.
    """
    if model.effort == "compensated_torque":
        from stopset.offline.diagnose.compensated import diagnose_open_loop

        return diagnose_open_loop(model, recordings, names), "open-loop simulation from each trial's start"
    base = baseline(model, recordings)
    # what `identify` chose itself stays in question on its own recordings; against others the model stands as it is
    fitted = settled(model) if base.known is None else model.effects
    if not any(moves(r) for r in recordings):
        return replace(standing(base.robot, recordings, fitted), notes=base.notes), base.against
    found = answered(examine(base.robot, recordings, fitted, known=base.known), names)
    chosen = {f.label for f in model.effects} - {f.label for f in fitted}

    def marked(ranked: tuple[Ranked, ...]) -> tuple[Ranked, ...]:
        return tuple(replace(r, in_model=r.label in chosen) for r in ranked)

    found = replace(found, ranked=marked(found.ranked), claims=marked(found.claims), notes=base.notes)
    if base.known is None or names is not None:
        return found, base.against
    return _with_changes(found, changes(model, [r for r in recordings if moves(r)])), base.against


def _with_changes(found: Diagnosis, told: Sequence[Change]) -> Diagnosis:
    """The answer with what changed since identification: that is the verdict where nothing is missing besides."""
    if not told:
        return found
    if found.verdict == "missing":
        return replace(found, changed=tuple(told))
    ranked = tuple(
        Ranked(
            c.effect, () if c.joint is None else (c.joint,), abs(c.after - c.before) / max(c.std, 1e-12), c.error_before, c.error_after,
            {c.symbol: Parameter(c.after - c.before, c.unit, c.std)}, "torque against the model", c.says, change=c,
        )
        for c in told
    )  # fmt: skip
    return replace(found, verdict="changed", ranked=ranked, changed=tuple(told), next_experiment=SINCE)


def moves(r: Recording) -> bool:
    """Whether a trial is one in which some joint moves."""
    return r.phase != "static" and bool(np.max(np.ptp(r.q, axis=0)) > limit.STANDING)


def standing(robot: Robot, recordings: Recordings, fitted: Sequence[Fitted] = ()) -> Diagnosis:
    """Recordings in which no joint moves: torque that changes there by more than friction can hold comes from outside."""
    dry = of_part("dry friction")
    level = {f.joint: f.values.get(dry.terms[0].symbol, 0.0) for f in fitted if f.effect == dry.name}
    pushed = []
    for j, name in enumerate(robot.joints):
        limit = robot.torque_limit[j] if np.isfinite(robot.torque_limit[j]) else 100.0
        friction = level.get(name, 0.05 * limit)
        swing = max(float(np.ptp(np.quantile(r.tau[:, j], [0.01, 0.99]))) for r in recordings)
        if swing > 2 * friction + 0.02 * limit:
            pushed.append((swing / limit, name))
    names = tuple(f"time at standstill (torque of {name})" for _, name in sorted(pushed, reverse=True))
    return Diagnosis(
        verdict="unknown" if pushed else "none", ranked=(), rivals=(), depends_on=names,
        not_identifiable=(Blind("every effect of motion", (), "no joint moves in these recordings", MOVE),),
        next_experiment=(
            "The torque changes while every joint stands still: something touches the arm. Repeat with nothing in contact."
            if pushed else MOVE
        ),
        trials=len(recordings),
    )  # fmt: skip


def _include(engine: Engine, fitted: Sequence[Fitted]) -> None:
    """The model's own effects become part of the base."""
    for f in fitted:
        effect = get(f.effect)
        if effect.base:
            continue
        unknown = set(f.joints) - set(engine.data.joints)
        if unknown:
            raise EffectError(f"effect {f.label}: no joint {', '.join(unknown)}; expected {', '.join(engine.data.joints)}")
        place = tuple(engine.data.joints.index(j) for j in f.joints)
        shapes: dict[str, float] = {p.symbol: f.values[p.symbol] for p in effect.shapes if p.symbol in f.values}
        if effect.enters == "input_delay":
            lag = f.values.get(effect.terms[0].symbol, 0.0)
            shapes = {"d0": lag} if lag else {}
        elif effect.role == "swing":
            shapes |= {"exact": 1.0, "begun": 1.0}
        candidate = engine.add(effect, place, shapes)
        if candidate is not None:
            engine.active.append(candidate)


def _errors(engine: Engine, found: Found, already: Sequence[Candidate], claims: Sequence[Claim]) -> list[Array]:
    """Held-out error (n,) of the model without any claim, and after each of ``claims`` in turn."""
    if not claims:
        return [found.before]
    active, out = list(engine.active), [found.before]
    for k in range(len(claims)):
        engine.active = [*already, *(c.scored.candidate for c in claims[: k + 1])]
        out.append(held_out(engine, found.hyper))
    engine.active = active
    return out


def _ranked(engine: Engine, found: Found, already: Sequence[Candidate], left: _Left) -> tuple[Ranked, ...]:
    """Every claim with its numbers, one entry each; errors before and after count those without doubt only, in this order."""
    joints, seconds = engine.data.joints, float(len(engine.data.t_fine) * engine.data.kernel.dt)
    deviation = deviations(engine, left.hyper, left.theta, [c.scored.candidate for c in found.claims])
    numbers = [parameters(c.scored, d) for c, d in zip(found.claims, deviation, strict=True)]
    doubts = []
    for claim, mine in zip(found.claims, numbers, strict=True):
        values, std = {k: p.value for k, p in mine.items()}, {k: p.std for k, p in mine.items()}
        doubts.append(doubt(claim.scored.candidate.effect, values, std, seconds))
    sound = [k for k, why in enumerate(doubts) if not why][: limit.HANDFUL]
    errors = dict(zip([-1, *sound], _errors(engine, found, already, [found.claims[k] for k in sound]), strict=True))
    out, before = [], errors[-1]
    for k, claim in enumerate(found.claims):
        c, after = claim.scored.candidate, errors.get(k, before)
        where = list(c.joints) or list(range(len(joints)))
        worst = max(where, key=lambda j: before[j] - after[j])
        given = {x: replace(p, value=within(c.effect, x, p.value)) for x, p in numbers[k].items()}
        why = doubts[k] or ("" if k in errors else f"{limit.HANDFUL} effects are named already: the rest is told in sum")
        out.append(
            Ranked(
                c.effect.name, tuple(joints[j] for j in c.joints), claim.score, float(before[worst]), float(after[worst]), given,
                c.effect.look_at, _says(c.effect, given), points=partial(engine, left.hyper, left.theta, c, worst), doubt=why,
            )
        )  # fmt: skip
        before = after
    return tuple(out)


def _says(effect: Effect, told: Mapping[str, Parameter]) -> str:
    """The effect's sentence; of a payload also what it weighs, in an interval, and where its centre is."""
    m = told["m"] if effect.carried else None
    if m is None or m.std is None:
        return effect.says
    half = TWO_SIDES * m.std
    text = f"{effect.says} {m.value:.2f} kg (95 %: {m.value - half:.2f} to {m.value + half:.2f} kg)"
    if abs(m.value) < half:
        return f"{text}."
    centre = ", ".join(f"{told[k].value / m.value:.3f}" for k in ("mx", "my", "mz"))
    return f"{text}, centre at ({centre}) m in the last link's frame."


def parameters(scored: Scored, deviation: Mapping[str, float]) -> dict[str, Parameter]:
    """Terms, then shapes, each with its standard ``deviation``."""
    c = scored.candidate
    values = {t.symbol: (float(v), t.unit) for t, v in zip(c.effect.terms, scored.theta, strict=True)}
    values |= {p.symbol: (float(c.shapes[p.symbol]), p.unit) for p in c.effect.shapes}
    if c.effect.enters == "input_delay" and "d0" in c.shapes:
        symbol = c.effect.terms[0].symbol
        values[symbol] = (float(c.shapes["d0"]), values[symbol][1])
    return {symbol: Parameter(v, unit, deviation.get(symbol)) for symbol, (v, unit) in values.items()}


@dataclass(frozen=True, slots=True)
class _Left:
    """What the claims leave: ``depends`` by joint, best variable first; ``loud`` joints have too much variance, in rows or slowly.

    ``hyper``, ``theta``: the whole model refitted with the claims; ``ranking``: all variables by joint.
    """

    hyper: Hyper
    theta: Array
    ranking: dict[int, list[Dependence]]
    depends: dict[int, list[Dependence]]
    loud: tuple[int, ...]
    contradicted: tuple[int, ...]  # joints whose own claims leave much of what they should have explained
    restless: tuple[int, ...]

    @property
    def worst(self) -> int | None:
        if self.depends:
            return max(self.depends, key=lambda j: self.depends[j][0].gain)
        return next(iter((*self.loud, *self.restless)), None)


def _left(found: Found, engine: Engine) -> _Left:
    hyper, p = engine.fit(found.hyper)
    depends, contradicted, wandering = {}, [], []
    ranking: dict[int, list[Dependence]] = {j: [] for j in range(engine.data.n)}
    for j in range(engine.data.n):
        if len(engine.rows[j].take) < 100:
            continue
        ranked = ranking[j] = dependences(engine, p.theta, hyper, j)
        if slow_excess(engine, p.theta, hyper, j) > limit.WANDER:
            wandering.append(j)
        claimed = sum(c.score for c in found.claims if not c.joints or j in c.joints)
        if ranked[0].gain > limit.PATTERN:
            depends[j] = ranked
            if claimed and ranked[0].gain > limit.PATTERN_SHARE * claimed:
                contradicted.append(j)
    loud = tuple(dict.fromkeys([*wandering, *(j for j, e in enumerate(found.excess) if e > limit.QUIET)]))
    restless = tuple(j for j, s in enumerate(found.hyper.sigma) if s > limit.RESTLESS)
    return _Left(hyper, p.theta, ranking, depends, loud, tuple(contradicted), restless)


def _verdict(found: Found, left: _Left) -> str:
    """unknown: something is left that no claim accounts for, and nothing found explains a good part of it."""
    if left.contradicted:
        return "unknown"
    if (left.depends or left.loud) and not _telling(found.claims):
        return "unknown"
    if found.claims:
        return "missing"
    return "unknown" if left.restless else "none"


def _telling(claims: Sequence[Claim]) -> bool:
    """Whether one claim alone takes away a good part of what some joint's rows left unexplained."""
    for c in claims:
        for before, after in zip(c.excess_before, c.excess_after, strict=True):
            if before > limit.SENSORS and before - after > limit.TELLING * (before - 1.0):
                return True
    return False


def _depends(verdict: str, worst: int | None, shown: Pattern | None, joints: Sequence[str]) -> tuple[str, ...]:
    """The variables by name; for an unknown cause that follows none of them, that."""
    if shown is not None:
        return shown.variables
    return (f"no recorded variable (joint {joints[worst]})",) if verdict == "unknown" and worst is not None else ()


def _unexplained(x: Examination) -> tuple[Unexplained, ...]:
    """What is left at each joint that holds more than its sensors' noise, or a claim in doubt."""
    sound = [k for k, r in enumerate(x.ranked) if not r.doubt]
    error = x.errors(sound)[-1]
    out = []
    for j, joint in enumerate(x.engine.data.joints):
        doubted = tuple(f"{r.label}: {r.doubt}" for r in x.ranked if r.doubt and joint in (r.joints or x.engine.data.joints[:1]))
        if x.found.excess[j] > limit.QUIET or j in x.left.depends or doubted:
            names = tuple(d.variable for d in x.left.depends.get(j, ())[:2])
            out.append(Unexplained(joint, float(error[j]), names, doubted))
    return tuple(out)


def _rivals(engine: Engine, claims: Sequence[Claim]) -> tuple[tuple[str, ...], ...]:
    groups = []
    for claim in claims:
        if claim.rivals:
            groups.append(tuple(label(engine, s) for s in (claim.scored, *claim.rivals)))
    return tuple(groups)


def label(engine: Engine, scored: Scored) -> str:
    """``effect:joint``."""
    c = scored.candidate
    where = "+".join(engine.data.joints[j] for j in c.joints)
    return f"{c.effect.name}:{where}" if where else c.effect.name
