"""Friction that a model leaves more torque with than without: one rule for what `diagnose` names and what `add` takes.

What judges an effect leaves the laws in question that identification chose itself, whose numbers were fitted together with all else.  Beside
these it may explain nothing more, or take the place of one that explains more: so it is given to a nominal model of the same recordings.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from stopset.artifact import Abstraction, Model
from stopset.effects import Fitted, get
from stopset.effects.selection import of_part, parse_effect, usual
from stopset.errors import NotConformant, RecordingError
from stopset.offline.abstraction.halves import Halves, halves, nominal_of
from stopset.offline.abstraction.nominal_part import NominalPart, fit_nominal, regressed
from stopset.offline.campaign.run import Run
from stopset.offline.campaign.settings import Settings, settings_of
from stopset.offline.campaign.source import Campaign
from stopset.offline.compare.known import TorqueModel, rms_left
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.evidence.baseline import own, settled
from stopset.offline.diagnose.question import own_in_time
from stopset.offline.diagnose.side_by_side import side_by_side
from stopset.offline.nominal.nominal import LOW_PASS
from stopset.recording import Meta
from stopset.robot import Robot

HELD_BACK = "on held-out data"  # where errors are of, in words
Errors = tuple[Mapping[str, float], Mapping[str, float]]  # [N m] of each joint, without and with what is added


@dataclass(frozen=True, slots=True)
class Alone:
    """How the recordings of a model take a law: ``why`` it is refused, empty where it is not; ``among``: the laws of which identification may
    choose beside it, None: any."""

    why: str = ""
    among: tuple[str, ...] | None = None


def alone(
    model: Model, campaign: Campaign, f: Fitted, among: tuple[str, ...] | None = None, parts: Halves | None = None
) -> Alone:
    """Whether a nominal model with ``f``, and nothing else new, leaves more of its joint than without: in the model's own recordings than the
    model, or, fitted to one of their ``parts``, in the other than one without.

    Alone whatever it is named or added with: each law speaks against itself.  ``among``: as in `Alone`.  Every error is an rms in N m.
    """
    chosen = tuple(model.provenance.get("chosen", ()))
    if not in_question(model, campaign.meta, [f.label]):
        return Alone()
    robot, settings = model.robot.as_described, settings_of(model)
    beside = retained_elsewhere(settings, chosen, [f], robot)
    plain, settings = not_chosen(beside, [f.label], robot), replace(beside, effects=(*beside.effects, f.label))
    before = retained_effects(model)
    known = (*before, f)
    shared = [x for x in model.effects if x.label in chosen and not regressed(get(x.effect))]
    given = (*known, *(x for x in shared if x.label not in {k.label for k in known}))
    run = Run(robot, campaign.meta, campaign.trials, campaign.seen.survey, settings)

    def rise(looks: Iterable[Errors], where: str) -> str:
        return raised(robot, [f.label], looks, chosen, where).get(f.label, "")

    def asked(among: tuple[str, ...] | None) -> tuple[str, set[str]]:
        """Why it is refused, and the laws that identification chose beside it."""
        without, revision = (s if among is None else replace(s, friction_among=among) for s in (plain, settings))
        part = fit_nominal(_learning(replace(run, settings=revision), model), given)
        mine = NominalPart(model.robot, model.rotor, model.effects, _plain_damping(model, part), (), taken_out=_taken_out(model))
        laws = {g.name for g in part.chosen}
        if why := rise(zip(left(run, mine), left(run, part), strict=True), "in these recordings"):
            return why, laws
        try:
            divided = parts or halves(campaign)
            two = side_by_side(lambda x: nominal_of(robot, campaign.meta, divided, *x), [(without, before), (revision, known)])
        except (RecordingError, NotConformant):
            return "", laws  # too short to be divided, or a part of which no arm can be made: nothing is held back
        judging = Run(robot, campaign.meta, divided.judging, divided.judged, settings)
        return rise(zip(*(left(judging, x) for x in two), strict=True), HELD_BACK), laws | {g.name for g in two[1].chosen}

    why, laws = asked(among)
    if why and among is None and not laws <= set(chosen):
        return Alone(asked(chosen)[0], chosen)  # a law is to answer for it itself, not another that is chosen beside it
    return Alone(why, among)


def in_question(model: Model, meta: Meta, names: Sequence[str]) -> list[str]:
    """Those of ``names`` that are asked of a model's own recordings: friction whose torque is all in that error (`levelled`).

    A law that identification chose itself was judged on what was held out: to the recordings that it was fitted to its own number is the nearest.
    """
    if not names or model.effort == "compensated_torque" or not _of_all(model, meta):
        return []
    chosen = tuple(model.provenance.get("chosen", ()))
    return [x for x in names if x not in chosen and levelled(x, model.robot)]


def raised(robot: Robot, names: Sequence[str], looks: Iterable[Errors], chosen: Sequence[str], where: str) -> dict[str, str]:
    """The friction among ``names`` with which more torque is left of its joint than without in every one of ``looks``, each with the reason.

    ``chosen``: laws that identification chose; ``where``: the errors are of, in words.  A joint whose error is not known is not asked.
    """
    asked, first = [x for x in names if levelled(x, robot)], dict[str, str]()
    for errors in looks:
        worse = {x: why for x in asked if (why := _rise(robot, x, errors, chosen, where))}
        asked, first = list(worse), worse | first
        if not asked:
            break
    return {x: first[x] for x in asked}


def _rise(robot: Robot, name: str, errors: Errors, chosen: Sequence[str], where: str) -> str:
    """Why a law is refused by one look; empty where it is not."""
    for j in parse_effect(name, robot)[1]:
        a, b = (x.get(j, float("nan")) for x in errors)
        if b > (1.0 + limit.RISES) * a:
            return _worse_words(name, j, (a, b), chosen, where)
    return ""


def left(run: Run, part: NominalPart) -> Iterator[dict[str, float]]:
    """[N m] what a nominal model leaves of each joint in all recordings of a run: with its laws as they are, then behind the torque's filter.

    Both, for about a reversal either errs: a true Stribeck effect of 0.4 left 0.355 N m for 0.332 beside torque without its peaks, 0.331 for
    0.327 behind the filter; and behind it a true cubic law 0.073 for 0.071, as the step of dry friction rings at an instant that stamps do
    not tell, 0.073 for 0.074 beside it.
    """
    body = TorqueModel(part.robot, part.rotor, part.effects, part.abstraction)
    trials = own_in_time(run, body, part.taken_out).trials
    for filtered in (False, True):
        yield dict(zip(part.robot.joints, rms_left(body, trials, filtered=filtered).tolist(), strict=True))


def retained_effects(model: Model) -> tuple[Fitted, ...]:
    """Effects beyond plain friction that a revision of a model keeps, with their numbers."""
    return tuple(f for f in settled(model) if not get(f.effect).base)


def retained_elsewhere(settings: Settings, chosen: Sequence[str], added: Sequence[Fitted], robot: Robot) -> Settings:
    """``settings`` in which the laws that identification has ``chosen`` in the same recordings are those of all joints but those of what is
    ``added``, where any may be chosen.

    Which laws there are is told by a few percent of a short recording's error: asked again beside a number that is given, they come out
    otherwise at other joints.  Of a UR10e, the very number that a regression had found for a law of one joint, given to it, made the error of
    another joint a fifth larger on motions not seen, for that one had lost its law.
    """
    at = {j for f in added for j in f.joints}
    if settings.friction != "evidence" or any(not f.joints for f in added):
        return settings
    stay = tuple(x for x in chosen if x.partition(":")[2] not in at)
    there = tuple(f"{x}:{j}" for x in usual() for j in robot.joints if j in at)
    return replace(settings, friction_among=(*stay, *there), friction_retained=stay)


def not_chosen(settings: Settings, labels: Collection[str], robot: Robot) -> Settings:
    """``settings`` by which none of the laws ``labels`` is chosen: what a model is without them, one with them is held against.

    One that chooses such a law itself has it with a number that was fitted to the very same recordings, and the law would be refused for its own.
    """
    anywhere = tuple(f"{x}:{j}" for x in usual() for j in robot.joints)
    among = anywhere if settings.friction_among is None else settings.friction_among
    return replace(settings, friction_among=tuple(x for x in among if x not in labels))


def levelled(name: str, robot: Robot) -> bool:
    """Whether an effect is friction that does not warm up: of that all that it does is in the torque error of a nominal model."""
    effect = parse_effect(name, robot)[0]
    return effect.role == "friction" and "warm" not in effect.needs


def _of_all(model: Model, meta: Meta) -> bool:
    """Whether a model was identified from these recordings and no others."""
    return own(model, meta) and sorted(dict(model.provenance["data"]).values()) == sorted(sha for _, sha in meta.sources)


def _learning(run: Run, model: Model) -> Run:
    """What may shape the nominal model of a run, with the low-pass that its identification found."""
    cutoff = next((float(x["value"]) for x in _taken_out(model) if x["what"] == LOW_PASS), 0.0)
    learning = run.learning
    return replace(learning, survey=replace(learning.survey, low_pass=cutoff))


def _taken_out(model: Model) -> tuple[dict[str, Any], ...]:
    return tuple(model.provenance.get("taken_out", ()))


def _plain_damping(model: Model, part: NominalPart) -> Abstraction:
    """The linear abstraction of ``part`` with the damping of the model: what a model leaves hangs on no abstraction else."""
    law = of_part("damping")
    damping = {f.joint: f.values[law.terms[0].symbol] for f in model.effects if f.effect == law.name}
    viscous = np.array([[max(damping.get(j, 0.0), 0.0)] for j in model.joints])
    return replace(part.abstraction, viscous=viscous)


def _worse_words(name: str, joint: str, errors: tuple[float, float], chosen: Sequence[str], where: str) -> str:
    """Why friction is refused that raises the torque error [N m] that a model leaves of a joint."""
    a, b = errors
    rise = f"the torque that the model leaves of {joint} would rise from {a:.3g} to {b:.3g} N m {where}"
    laws = ", ".join(x for x in chosen if joint in x.partition(":")[2].split("+"))
    of = " than gravity's part of the load" if "load" in get(name.partition(":")[0]).needs else ""
    there = f"the model has {laws} there already" if laws else f"what the model has there already explains more{of}"
    return f"{rise}; expected it to fall: {there}"
