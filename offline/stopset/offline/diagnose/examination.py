"""The search over recordings that move, and its claims with numbers, errors and objections."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from stopset.artifact import Model
from stopset.effects import Fitted, get
from stopset.errors import EffectError
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.alike import alike
from stopset.offline.diagnose.answer import Ranked
from stopset.offline.diagnose.evidence.baseline import of_model
from stopset.offline.diagnose.evidence.candidate import Candidate
from stopset.offline.diagnose.evidence.engine import Engine
from stopset.offline.diagnose.evidence.hypothesis import Hypothesis
from stopset.offline.diagnose.evidence.priors import Beforehand
from stopset.offline.diagnose.evidence.uncertainty import deviations, drives_scale, fitted_deviations
from stopset.offline.diagnose.explain.objection import within
from stopset.offline.diagnose.explain.partial import partial
from stopset.offline.diagnose.load import of_a_body, says
from stopset.offline.diagnose.numbers import by_all_joints, by_gravity, parameters
from stopset.offline.diagnose.objections import objections
from stopset.offline.diagnose.plays import Plays, plays
from stopset.offline.diagnose.remainder import Left, left_of
from stopset.offline.diagnose.search.predicts import Step, step, too_little
from stopset.offline.diagnose.search.search import Claim, Found, search, with_own_law
from stopset.offline.diagnose.search.structures import Structure, explaining, of_what_is_left
from stopset.progress import Progress, silent
from stopset.recording import Recordings
from stopset.robot import Robot
from stopset.types import Array
from stopset.words import many

WHILE_MOVING = (
    " Here it grows with all that the gear transmits, what moves the arm besides what it weighs; its numbers are of gravity's load alone, as a "
    "model takes it."
)
INNER = " These errors are within the motions, whatever scale their friction has: how it scatters between them hides what this explains."


@dataclass(frozen=True, slots=True)
class Examination:
    """The search over recordings that move, and what it left: all that answers, judgements and estimates are taken from."""

    already: Hypothesis  # the base with the effects that the model has
    found: Found
    left: Left
    ranked: tuple[Ranked, ...]
    plays: Plays  # what angles behind the gears say, beside all torque
    structures: Mapping[int, Structure]  # by place among the claims, what explains more than the gear that is claimed
    refused: tuple[Ranked, ...] = ()  # what gave way to the model's own law at its joint, and why

    @property
    def engine(self) -> Engine:
        return self.already.engine

    def matching(self, effect: str, joints: Sequence[str] | None) -> tuple[int, ...]:
        """Which claims are of an effect, at these joints (None: wherever it acts)."""
        wanted = None if joints is None else set(joints)
        return tuple(
            k
            for k, r in enumerate(self.ranked)
            if r.effect == effect and not r.objection and (wanted is None or set(r.joints) == wanted)
        )

    def steps(self, claims: Sequence[int]) -> list[Step]:
        """Held-out errors before and after each of ``claims`` in turn, the others left out."""
        return _steps(self.found, self.already, [self.found.claims[k] for k in claims])

    def structure(self) -> Structure | None:
        """The structure that explains most of what the model leaves without any claim, and more than the best of them; None: none does.

        Beside what is claimed, much of little may be left: that takes no name away.
        """
        if len(self.found.claims) == 1 and self.structures:  # asked already, beside the same model
            found = self.structures[0]
            return found if found.telling else None
        hyper, _ = self.already.fit()
        return of_what_is_left(self.already, max((c.score for c in self.found.claims), default=0.0), hyper)


def examine(
    robot: Robot,
    recordings: Recordings,
    fitted: Sequence[Fitted] = (),
    before: Beforehand | None = None,
    names: Sequence[str] | None = None,
    progress: Progress = silent,
) -> Examination:
    """Search ``recordings``, of which some trial moves, for what `diagnose` answers about; the arguments are its.

    ``before``: what is known before; ``progress`` is given each step.
    """
    progress(f"{many(len(recordings), 'recording')}; preparing their rows")
    engine = Engine.build(robot, recordings, before)
    already = _with_own(Hypothesis(engine), fitted)
    progress(f"{sum(r.size for r in engine.rows)} rows of {engine.data.n} joints; asking every effect of the catalogue")
    found = search(already, names, progress=progress)
    progress("what is left, and what these recordings cannot tell")
    left = left_of(found)
    # what bends a gear is the torque of the arm as it is, with what it carries and all: a description may be any times off
    as_fitted = robot.with_parameters(robot.pi + engine.body(left.theta).reshape(robot.pi.shape))
    structures = {k: s for k, c in enumerate(found.claims) if (s := _structure(found, c)) is not None}
    ranked = _ranked(found, already, left, structures)
    return Examination(already, found, left, ranked, plays(as_fitted, recordings), structures)


def refusing(x: Examination, refused: Mapping[str, str]) -> Examination:
    """The examination with claims, by their label, that are ``refused`` for a reason: all that is said of the others is without them.

    In the place of each stands the law that identification chose at its joint, where that is a rival of it.
    """
    found, refusals = x.found, list(x.refused)
    for k, r in enumerate(x.ranked):
        if r.label in refused and not r.objection:
            found, before = with_own_law(found, k), found
            refusals += [replace(r, objection=refused[r.label])] if found is not before else []
    left = x.left if found is x.found else left_of(found)
    return replace(
        x, found=found, left=left, ranked=_ranked(found, x.already, left, x.structures, refused), refused=tuple(refusals)
    )


def excess_left(model: Model, recordings: Recordings) -> Array:
    """(n,) residual variance over the sensors' noise that a model leaves of recordings, as a search in them would begin with it."""
    base = of_model(model)
    engine = Engine.build(base.robot, recordings, Beforehand(None, base.known))
    now = _with_own(Hypothesis(engine), model.effects)
    hyper, p = now.fit()
    return np.array(now.excesses(p.theta, hyper))


def _with_own(now: Hypothesis, fitted: Sequence[Fitted]) -> Hypothesis:
    """The model's own effects beside the base."""
    engine = now.engine
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
            now = now.plus(candidate)
    return now


def _steps(found: Found, already: Hypothesis, claims: Sequence[Claim]) -> list[Step]:
    """Each of ``claims`` beside those before it."""
    out, before, earlier = list[Step](), found.before, list[Candidate]()
    for c in (claim.scored.candidate for claim in claims):
        out.append(step(already, c, before, found.hyper, earlier, found.excess))
        already, before, earlier = already.plus(c), out[-1].after, [*earlier, c]
    return out


def _sound(found: Found, already: Hypothesis, against: list[str]) -> dict[int, Step]:
    """The step of each claim to be named, by its place; a claim that lowers the error too little beside those before it, now that all
    are known, gets that as its objection.

    What a free base takes up need not show in motions that were not fitted, unless its like at another joint has numbers that it cannot
    have: what imitates it there may do so here.
    """
    out, before, earlier = dict[int, Step](), found.before, list[Candidate]()
    effects = [claim.scored.candidate.effect for claim in found.claims]
    imitated = {e.name for e, why in zip(effects, against, strict=True) if why and e.absorbed}
    for k, claim in enumerate(found.claims):
        if against[k] or len(out) == limit.HANDFUL:
            continue
        c = claim.scored.candidate
        taken = step(already, c, before, found.hyper, earlier, found.excess)
        why = taken.why or (too_little(taken, c, earlier, found.excess) if c.effect.name in imitated else "")
        if why:
            against[k] = why
            continue
        out[k], already, before, earlier = taken, already.plus(c), taken.after, [*earlier, c]
    return out


def _ranked(
    found: Found,
    already: Hypothesis,
    left: Left,
    structures: Mapping[int, Structure],
    refused: Mapping[str, str] = MappingProxyType({}),
) -> tuple[Ranked, ...]:
    """Every claim with its numbers, one entry each; errors before and after count those that are findings only, in this order."""
    engine = already.engine
    joints = engine.data.joints
    deviation = deviations(found.now, left.hyper, left.theta, [c.scored.candidate for c in found.claims])
    transmitted = by_gravity(found, left)
    scale = drives_scale(found.now, left.theta)
    numbers = [parameters(c.scored, d, scale) for c, d in zip(found.claims, deviation, strict=True)]
    carries = not engine.modelled and any(c.scored.candidate.effect.carried for c in found.claims)
    by_fit = (
        fitted_deviations(found.now, left.hyper, left.theta, [c.scored.candidate for c in found.claims]) if carries else deviation
    )
    against = objections(found, left, by_fit, structures, refused)
    steps = _sound(found, already, against)
    out, error = [], found.before
    for k, claim in enumerate(found.claims):
        c = claim.scored.candidate
        taken = steps.get(k, Step(error, error, "", c.joints))
        # whether there is a load is no matter of how sure its mass is
        own, disagree = by_all_joints(found, left, claim, numbers[k])
        own = transmitted.get(k, own)
        fitted = {x: replace(p, value=within(c.effect, x, p.value)) for x, p in own.items()}
        given = dict(fitted if against[k] else of_a_body(c.effect, fitted))
        why = against[k] or ("" if k in steps else f"{limit.HANDFUL} effects are named already: the rest is told in sum")
        surplus = bool(why) and not against[k]
        lowered = 1.0 - float(taken.stated[1][taken.joint] / taken.stated[0][taken.joint])
        same = alike(engine, claim)
        words = says(c.effect, fitted, given, described=not engine.modelled, lowered=lowered) + disagree
        words += WHILE_MOVING if k in transmitted else ""
        out.append(
            Ranked(
                c.effect.name, tuple(joints[j] for j in c.joints), claim.score, float(taken.stated[0][taken.joint]),
                float(taken.stated[1][taken.joint]), given, c.effect.look_at, words + (INNER if taken.inner else ""),
                points=partial(found.now, left.hyper, left.theta, c, taken.joint), objection=why, surplus=surplus, at=joints[taken.joint],
                alternatives=same.effects, alike=same.why, telling=same.experiment, transmitted=k in transmitted,
            )
        )  # fmt: skip
        error = error if why else taken.after
    return tuple(out)


def _structure(found: Found, claim: Claim) -> Structure | None:
    """What explains more than a gear that is claimed, if what holds the arm, or a link of it, gives."""
    c = claim.scored.candidate
    if c.effect.role != "swing":
        return None
    base = found.now.without(c.key)
    return explaining(base, found.now.evidence(found.hyper) - base.evidence(base.fit(found.hyper)[0]), found.hyper)
