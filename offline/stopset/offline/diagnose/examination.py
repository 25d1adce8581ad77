"""The search over recordings that move, and its claims with numbers, errors and doubts."""

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
from stopset.offline.diagnose.answer import Parameter, Ranked
from stopset.offline.diagnose.columns.laws import MOVING, TRANSMITTED
from stopset.offline.diagnose.evidence.baseline import of_model
from stopset.offline.diagnose.evidence.candidate import Candidate, Scored
from stopset.offline.diagnose.evidence.engine import Engine
from stopset.offline.diagnose.evidence.hypothesis import Hypothesis
from stopset.offline.diagnose.evidence.priors import Beforehand
from stopset.offline.diagnose.evidence.uncertainty import BY_ROWS, deviations, drives_scale, fitted_deviations
from stopset.offline.diagnose.evidence.weighing import Misfit, joint_shares, weighed
from stopset.offline.diagnose.explain.objection import objection, within
from stopset.offline.diagnose.explain.partial import partial
from stopset.offline.diagnose.load import joints_disagree, of_a_body, says
from stopset.offline.diagnose.plays import Plays, plays
from stopset.offline.diagnose.remainder import Left, left_of, shakes
from stopset.offline.diagnose.rows.prepare import ROW_STEP
from stopset.offline.diagnose.search.predicts import Step, step, too_little
from stopset.offline.diagnose.search.refine import shortest_lag
from stopset.offline.diagnose.search.search import Claim, Found, label, search, with_own_law
from stopset.offline.diagnose.search.settle import within_reach
from stopset.offline.diagnose.search.settled import added
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


def _sound(found: Found, already: Hypothesis, objections: list[str]) -> dict[int, Step]:
    """The step of each claim to be named, by its place; a claim that lowers the error too little beside those before it, now that all
    are known, gets that as its objection.

    What a free base takes up need not show in motions that were not fitted, unless its like at another joint has numbers that it cannot
    have: what imitates it there may do so here.
    """
    out, before, earlier = dict[int, Step](), found.before, list[Candidate]()
    effects = [claim.scored.candidate.effect for claim in found.claims]
    imitated = {e.name for e, why in zip(effects, objections, strict=True) if why and e.absorbed}
    for k, claim in enumerate(found.claims):
        if objections[k] or len(out) == limit.HANDFUL:
            continue
        c = claim.scored.candidate
        taken = step(already, c, before, found.hyper, earlier, found.excess)
        why = taken.why or (too_little(taken, c, earlier, found.excess) if c.effect.name in imitated else "")
        if why:
            objections[k] = why
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
    joints, seconds = engine.data.joints, float(len(engine.data.t_fine) * engine.data.kernel.dt)
    deviation = deviations(found.now, left.hyper, left.theta, [c.scored.candidate for c in found.claims])
    by_gravity = _by_gravity(found, left)
    scale = drives_scale(found.now, left.theta)
    numbers = [parameters(c.scored, d, scale) for c, d in zip(found.claims, deviation, strict=True)]
    objections, misfit = [], Misfit.of(found.now, left.hyper, left.theta)
    carries = not engine.modelled and any(c.scored.candidate.effect.carried for c in found.claims)
    by_fit = (
        fitted_deviations(found.now, left.hyper, left.theta, [c.scored.candidate for c in found.claims]) if carries else deviation
    )
    for k, (claim, sure) in enumerate(zip(found.claims, by_fit, strict=True)):
        mine = parameters(claim.scored, sure, scale)
        values = {k: p.value for k, p in mine.items()}
        c = claim.scored.candidate
        rotor = float(engine.source.robot.rotor[c.joints[0]]) if c.joints else 0.0
        shortest = shortest_lag(engine, c.joints[0]) if BY_ROWS in sure else 0.0
        why = objection(c.effect, values, sure, seconds, rotor, shortest) or _of_another_joint(engine, claim)
        why = _of_the_structure(structures.get(k)) or why or _of_a_gears_form(found, claim)
        why = why or _of_any_position(engine, claim) or _between_rows(claim) or _as_before(found, claim)
        why = why or _of_single_joints(found, left, claim)
        objections.append(why or _of_the_load(found, left, misfit, claim) or refused.get(label(engine, claim.scored), ""))
    steps = _sound(found, already, objections)
    out, error = [], found.before
    for k, claim in enumerate(found.claims):
        c = claim.scored.candidate
        taken = steps.get(k, Step(error, error, "", c.joints))
        # whether there is a load is no matter of how sure its mass is
        own, disagree = _by_all_joints(found, left, claim, numbers[k])
        own = by_gravity.get(k, own)
        fitted = {x: replace(p, value=within(c.effect, x, p.value)) for x, p in own.items()}
        given = dict(fitted if objections[k] else of_a_body(c.effect, fitted))
        why = objections[k] or ("" if k in steps else f"{limit.HANDFUL} effects are named already: the rest is told in sum")
        surplus = bool(why) and not objections[k]
        lowered = 1.0 - float(taken.stated[1][taken.joint] / taken.stated[0][taken.joint])
        same = alike(engine, claim)
        words = says(c.effect, fitted, given, described=not engine.modelled, lowered=lowered) + disagree
        words += WHILE_MOVING if k in by_gravity else ""
        out.append(
            Ranked(
                c.effect.name, tuple(joints[j] for j in c.joints), claim.score, float(taken.stated[0][taken.joint]),
                float(taken.stated[1][taken.joint]), given, c.effect.look_at, words + (INNER if taken.inner else ""),
                points=partial(found.now, left.hyper, left.theta, c, taken.joint), objection=why, surplus=surplus, at=joints[taken.joint],
                alternatives=same.effects, alike=same.why, telling=same.experiment, transmitted=k in by_gravity,
            )
        )  # fmt: skip
        error = error if why else taken.after
    return tuple(out)


def _by_gravity(found: Found, left: Left) -> dict[int, dict[str, Parameter]]:
    """By place among the claims, the numbers of a law of all torque that a gear transmits in the form that a model has it, of gravity's."""
    now, places = found.now, [k for k, c in enumerate(found.claims) if TRANSMITTED in c.scored.candidate.shapes]
    forms = [added(now, replace(found.claims[k].scored.candidate, shapes={})) for k in places]
    for c in forms:
        now = now.instead(c).plus(added(now, replace(c, shapes={MOVING: 1.0})))
    if not forms:
        return {}
    hyper, p = now.fit(left.hyper)
    place = {column: k for k, column in enumerate(now.nuisance.tolist())}
    thetas = [p.theta[[place[k] for k in c.cols.tolist()]] for c in forms]
    std = deviations(now, hyper, p.theta, forms)
    scored = [replace(found.claims[k].scored, candidate=c, theta=x) for k, c, x in zip(places, forms, thetas, strict=True)]
    return {k: parameters(s, d) for k, s, d in zip(places, scored, std, strict=True)}


def _of_the_load(found: Found, left: Left, misfit: Misfit | None, claim: Claim) -> str:
    """Why a claim beside a load is no finding: what the load's own torque may be off by explains most of what it is claimed for."""
    c = claim.scored.candidate
    if misfit is None or c.effect.carried:
        return ""
    alone, beside = misfit.leaves(found.now, left.hyper, c)
    if beside >= limit.TELLING * alone:
        return ""
    return (
        f"what the load's torque may be off by at single joints explains most of it (score {max(beside, 0.0):.0f} beside that, {alone:.0f} "
        "where the load is taken to be told exactly)"
    )


def _of_single_joints(found: Found, left: Left, claim: Claim) -> str:
    """Why a law of the whole arm is no finding: that each joint has a share of its own is as sure as an effect must be that is named, and one is
    off by twice what a law's form is ever taken to be off.

    Its number is one for all joints, however it came about; of a load they may disagree by their drives (`weighed`).
    """
    c = claim.scored.candidate
    if c.joints or c.effect.carried:
        return ""
    gain, shares = joint_shares(found.now, left.hyper, left.theta, c)
    if gain < limit.THRESHOLD or max(map(abs, shares.values())) < limit.SURE * limit.FORMS[-1]:
        return ""
    each = ", ".join(
        f"{found.now.engine.data.joints[j]} {1.0 + s:.2g}" for j, s in sorted(shares.items(), key=lambda x: -abs(x[1]))[:2]
    )
    return f"the joints do not agree on it (times what they say together: {each}; score {gain:.0f}): what it explains is of each by itself"


def _by_all_joints(
    found: Found, left: Left, claim: Claim, numbers: Mapping[str, Parameter]
) -> tuple[Mapping[str, Parameter], str]:
    """``numbers`` of a claim; of a load against a model those that all joints say together, each of which may be off (`weighed`), and
    which of them do not agree, in words.

    Against a description alone a fit takes such shares for masses of the links, and its interval holds how far these may be off.
    """
    now, c = found.now, claim.scored.candidate
    if not (c.effect.carried and now.engine.modelled):
        return numbers, ""
    w = weighed(now, left.hyper, left.theta, c)
    disagree = {now.engine.data.joints[j]: share for j, share in w.disagreeing().items()}
    return parameters(replace(claim.scored, theta=w.theta), w.deviation), joints_disagree(disagree)


def _as_before(found: Found, claim: Claim) -> str:
    """Why a claim is none: the model leaves no more of the joints that it explains than it left of its own recordings.

    What a model could not explain when it was identified is still there, and no change; but what is more than its own recordings held beside
    their sensors' noise is new, however little of all that is left it is.  A gear explains what it shakes, too.
    """
    engine, c = found.now.engine, claim.scored.candidate
    at = c.joints or tuple(np.flatnonzero(np.array(claim.excess_before) > np.array(claim.excess_after)).tolist())
    at = (*at, *(j for j in range(engine.data.n) if shakes(claim, j)))
    explained = np.array(claim.excess_before) - np.array(claim.excess_after)
    if at and all(engine.as_before[j] and explained[j] <= engine.hidden_before[j] for j in at):
        return "the model leaves no more there than it left of its own recordings, so it is no change since"
    return ""


def _of_another_joint(engine: Engine, claim: Claim) -> str:
    """Why a gear whose link would swing faster than was looked for is no finding: another joint's explains nearly as much."""
    c = claim.scored.candidate
    if c.effect.role != "swing" or within_reach(engine, c):
        return ""
    others = [engine.data.joints[s.candidate.joints[0]] for s in claim.rivals if s.candidate.effect is c.effect]
    which = ", ".join(dict.fromkeys(others))
    return f"a soft gear at {which} explains nearly as much, and both swing faster than was looked for" if others else ""


def _structure(found: Found, claim: Claim) -> Structure | None:
    """What explains more than a gear that is claimed, if what holds the arm, or a link of it, gives."""
    c = claim.scored.candidate
    if c.effect.role != "swing":
        return None
    base = found.now.without(c.key)
    return explaining(base, found.now.evidence(found.hyper) - base.evidence(base.fit(found.hyper)[0]), found.hyper)


def _of_the_structure(structure: Structure | None) -> str:
    """Why a gear is no finding where a ``structure`` explains more."""
    return "" if structure is None else f"a flexible structure explains more: {structure.where}"


def _of_a_gears_form(found: Found, claim: Claim) -> str:
    """Why a law claimed after a gear, of a joint that this shakes, is no finding: next to what the gear took away it takes nothing.

    What is left of a soft gear's swing is of its form, and a law of friction or of the position takes up a part of anything.
    """
    c = claim.scored.candidate
    earlier = found.claims[: found.claims.index(claim)]
    if len(c.joints) != 1 or c.effect.role == "swing":
        return ""
    (j,) = c.joints
    gears = [k.excess_before[j] - k.excess_after[j] for k in earlier if shakes(k, j)]
    share = (claim.excess_before[j] - claim.excess_after[j]) / sum(gears) if gears else np.inf
    if share > limit.PATTERN_SIZE:
        return ""
    return f"it takes away {share:.1%} of what an elastic gear took away there: what that gear's form leaves"


def _of_any_position(engine: Engine, claim: Claim) -> str:
    """Why a constant torque is no finding where its joint moved so little that any law of the position is all but constant.

    One that rests a radian away varies over `TRAVEL` by no more than a law's form may be off and still be as likely.
    """
    c = claim.scored.candidate
    if len(c.joints) != 1 or c.effect.enters != "compensation" or "stiff" in c.effect.needs:
        return ""
    j = c.joints[0]
    rows = engine.rows[j]
    torque = rows.plain(engine.columns(c.effect, c.joints, c.shapes)[j][0] @ claim.scored.theta)
    travel = float(np.ptp(rows.plain(engine.data.q[:, j])))
    if travel >= limit.TRAVEL or float(np.ptp(torque)) > limit.EDGE * float(np.abs(torque).max(initial=0.0)):
        return ""
    return (
        f"its joint moved by {travel:.2g} rad only: a spring, a cable pack, a gas spring and friction that differs between the directions look "
        "alike there"
    )


def _between_rows(claim: Claim) -> str:
    """Why friction that builds up over a way is no finding where every joint that moves at all has passed that way from one row to the next.

    Rows then show none of its curve, and what a filter of the torque makes of a reversal looks like it.
    """
    c, least = claim.scored.candidate, limit.CREEP * ROW_STEP
    travels = [c.shapes[p.symbol] for p in c.effect.shapes if p.unit == "rad" and c.effect.states]
    if not travels or min(travels) >= least:
        return ""
    return f"its way of {min(travels):.2g} rad is passed from one row to the next at any speed that is asked ({least:.2g} rad)"


def parameters(scored: Scored, deviation: Mapping[str, float], scale: float = 1.0) -> dict[str, Parameter]:
    """Terms, then shapes, each with its standard ``deviation``; a load is weighed in true torque, the recorded one over ``scale``."""
    c = scored.candidate
    per = scale if c.effect.carried else 1.0
    values = {t.symbol: (float(v) / per, t.unit) for t, v in zip(c.effect.terms, scored.theta, strict=True)}
    values |= {p.symbol: (float(c.shapes[p.symbol]), p.unit) for p in c.effect.shapes}
    if c.effect.enters == "input_delay" and "d0" in c.shapes:
        symbol = c.effect.terms[0].symbol
        values[symbol] = (float(c.shapes["d0"]), values[symbol][1])
    return {symbol: Parameter(v, unit, deviation.get(symbol)) for symbol, (v, unit) in values.items()}
