"""Add effects to a model: a new revision that re-identifies everything, judged on data the fit has not seen.

The judgement comes first and is cheap (`stopset.offline.revise.judge`).  Several effects are judged one after another, each beside
those that were taken before it.  Only then is the whole model identified again, once.  An effect that does not help is refused,
with the numbers, unless forced; so is a revision whose torque sets are wider than before.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from typing import TYPE_CHECKING

import numpy as np

from stopset.artifact import Model, Revision
from stopset.effects.selection import parse_effect
from stopset.errors import EffectError, NotConformant, NotCovered
from stopset.offline.abstraction.halves import halves
from stopset.offline.campaign.conditions import one_condition
from stopset.offline.campaign.settings import Settings, settings_of
from stopset.offline.campaign.source import Campaign
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.as_added import alone, retained_effects
from stopset.offline.diagnose.evidence.baseline import own
from stopset.offline.identify.pipeline import Identification, Keep, identified
from stopset.offline.inspect.gate import check_files, check_trials
from stopset.offline.revise.judge import (
    HELD_OUT,
    Judge,
    Judged,
    Judgement,
    by_evidence,
    by_simulation,
)  # fmt: skip
from stopset.progress import Progress, silent
from stopset.reach.stops import stop
from stopset.robot import Robot

if TYPE_CHECKING:
    from stopset.offline.conform.gather import RetainedSums
    from stopset.offline.identify.signals_file import RetainedSignals

WIDTHS = ("sum_U_width", "sum_U_width_without_margin")


@dataclass(frozen=True, slots=True)
class Refused:
    """Why a revision is refused, and the effect that it is refused for; empty where it is taken, and where no one effect is the reason."""

    name: str = ""
    why: str = ""


@dataclass(frozen=True, slots=True)
class Revised:
    """Outcome of `add`: the new model (None if all was refused), held-out errors and model figures before and after."""

    model: Model | None
    before: dict[str, float]
    after: dict[str, float]
    judged: tuple[Judged, ...]
    judged_on: str
    without: Model | None = None  # of the same recordings, which its sets are compared with; None where no sets enclose them
    retained: RetainedSums | RetainedSignals | None = None  # what later recordings can be added to, where that was asked for

    @property
    def helps(self) -> bool:
        """Whether all that was asked for lowers the error on held-out data."""
        return all(j.helps for j in self.judged)


def add(
    model: Model,
    effects: Sequence[str],
    campaign: Campaign,
    *,
    force: bool = False,
    progress: Progress = silent,
    keep: Keep = None,
) -> Revised:
    """A revision of ``model`` with ``effects``, identified from the recordings of ``campaign``.

    They are ``effect:joint`` each, or ``effect`` wherever its scope says, in the order to try them.
    ``keep``: also keep what later recordings can be added to (`stopset.offline.update.update`).
    Raises `EffectError` if an effect or joint is unknown or already part of the model.
    """
    robot, settings = model.robot.as_described, settings_of(model)
    names = _names(effects, robot, settings)
    if not settings.mixed:
        one_condition(campaign.seen.tally.conditions)
        check_files(robot, campaign.meta, campaign.trials(), mixed=False)
        check_trials(robot, campaign.meta, campaign.seen.survey.sample, mixed=False)
    judge = Judge(model, robot, campaign, halves(campaign), progress)
    first = _judged_before(model, campaign)
    ask = by_simulation if model.effort == "compensated_torque" else by_evidence
    verdict = ask(judge, settings, names, first, force=force)
    taken = [j for j in verdict.judged if not j.why]
    if not taken:
        return Revised(None, verdict.first, verdict.judged[-1].after, verdict.judged, verdict.words)
    found, without, refused = _revision(model, campaign, verdict, progress, force=force, keep=keep)
    while refused.name and len(taken) > 1:  # one law speaks against itself, not against what it was named with
        remaining = [j.name for j in taken if j.name != refused.name]
        judgement = ask(judge, settings, remaining, first, force=force)  # the others' errors are not those beside it
        every = {j.name: replace(j, helps=False, why=j.why or refused.why) for j in verdict.judged if j.name not in remaining}
        every |= {j.name: j for j in judgement.judged}
        verdict = replace(judgement, judged=tuple(every[name] for name in names))
        taken = [j for j in verdict.judged if not j.why]
        if not taken:
            return Revised(None, verdict.first, verdict.judged[-1].after, verdict.judged, verdict.words)
        found, without, refused = _revision(model, campaign, verdict, progress, force=force, keep=keep)
    fresh = found.model
    progress("bounding stops before and after")
    before = _figures(model, without) | verdict.first | stop_figures(model, fresh)
    after = taken[-1].after | dict(fresh.revisions[-1].after) | stop_figures(fresh, model)
    if refused.why:
        judged = tuple(replace(j, helps=False, why=j.why or refused.why) for j in verdict.judged)
        return Revised(None, before, after, judged, verdict.words)
    number = model.revisions[-1].number + 1 if model.revisions else 1
    revision = Revision(number, ", ".join(j.name for j in taken), before, after, _note(taken, verdict.words))
    revised = replace(fresh, revisions=(*model.revisions, revision))
    return Revised(revised, before, after, verdict.judged, verdict.words, without, found.retained)


def _revision(
    model: Model, campaign: Campaign, verdict: Judgement, progress: Progress, *, force: bool, keep: Keep
) -> tuple[Identification, Model | None, Refused]:
    """The new revision, the model of the same recordings without what is added (None: no sets enclose them), and why it is refused.

    What is added is to answer for the widths, not friction or an order that happen to be chosen otherwise beside it: a revision that is
    wider is identified again with laws among those that there are without it, and of the order that it is of then.
    """
    robot = model.robot.as_described

    def revision(settings: Settings) -> tuple[Identification, Refused]:
        """What is identified so, and why it is refused."""
        found = identified(robot, campaign, settings, progress, known=verdict.known, keep=keep)
        wider = "" if force else widened(before, found.model.revisions[-1].after)
        return found, Refused("", wider)

    without: Model | None = model
    if not own(model, campaign.meta):
        progress("identifying these recordings without it")
        without = _plain(model, campaign)
    before = _figures(model, without)
    progress("identifying the new revision")
    found, refused = revision(verdict.settings)
    chosen = () if without is None else tuple(without.provenance.get("chosen", ()))
    order = verdict.settings.order if without is None else _same_order(found.model, without, verdict.settings)
    if refused.why and (order != verdict.settings.order or not set(found.model.provenance.get("chosen", ())) <= set(chosen)):
        progress("identifying it with the friction that there is without it, and of the same order")
        found, refused = revision(replace(verdict.settings, friction_among=chosen, order=order))
        if not refused.why and not force:
            refused = next(_refused_alone(model, campaign, verdict, chosen), refused)
    return found, without, refused


def _same_order(found: Model, without: Model, settings: Settings) -> int | None:
    """The order to ask for so that a revision is of the order that there is without what is added; None: as it is chosen."""
    a, b = found.abstraction, without.abstraction
    return b.order if a.kind == b.kind and a.order != b.order else settings.order


def _refused_alone(model: Model, campaign: Campaign, verdict: Judgement, chosen: tuple[str, ...]) -> Iterator[Refused]:
    """Each effect that was taken, as it was asked for, of which a law leaves more of the model's own recordings beside laws ``chosen`` only."""
    for j in verdict.judged:
        for f in verdict.known if not j.why else ():
            new = j.name in (f.label, f.effect) and f.label not in {x.label for x in model.effects}
            if new and (why := alone(model, campaign, f, chosen).why):
                yield Refused(j.name, why)


def _figures(model: Model, without: Model | None) -> dict[str, float]:
    """Figures of the model, with the widths of U of the same recordings: of another day's they are infinite where none enclose them."""
    figures = dict(model.revisions[-1].after) if model.revisions else {}
    if without is model:
        return figures
    return figures | {key: without.revisions[-1].after[key] if without else float("inf") for key in WIDTHS}


def _plain(model: Model, campaign: Campaign) -> Model | None:
    """A model of recordings of another day without what is added; None where no sets enclose them."""
    try:
        return identified(model.robot.as_described, campaign, settings_of(model), silent, known=retained_effects(model)).model
    except NotConformant:
        return None


def widened(before: Mapping[str, float], after: Mapping[str, float]) -> str:
    """Why a revision whose torque sets grew is refused; empty where they did not.

    The rule: an effect that is truly there takes uncertainty away, so the widths of U, summed over the joints and before any
    margin, may not grow by more than `limit.WIDER`.  They do where recordings of different conditions are identified as one.
    Recordings none of which the model was identified from have widths of their own: theirs without the effect are ``before``.
    """
    a, b = (x.get("sum_U_width_without_margin") for x in (before, after))
    if a is None or b is None or b <= (1.0 + limit.WIDER) * a:
        return ""
    return (
        f"the widths of U would grow from {a:.3g} to {b:.3g} N m in sum; expected no more than {limit.WIDER:.0%}, for what is known of an "
        "arm cannot make it less certain: are these recordings all of one condition (payload, tool, day)? give the others apart"
    )


def _names(effects: Sequence[str], robot: Robot, settings: Settings) -> tuple[str, ...]:
    """Effects as ``effect`` or ``effect:joint``, each known, fitting the robot and new to the model."""
    names = tuple(effects)
    for k, name in enumerate(names):
        if parse_effect(name, robot)[0].base:
            raise EffectError(
                f"{name}: every model has it, and its level is found at each identification; identify again from recordings of today "
                "(`stopset identify`)"
            )
        if name in settings.effects:
            raise EffectError(f"{name} is already part of this model; name another effect, or identify again with other data")
        if name in names[:k]:
            raise EffectError(f"{name} is named twice; name every effect once")
    return names


def _judged_before(model: Model, campaign: Campaign) -> dict[str, float] | None:
    """Held-out errors of this very model on these very recordings, where its last revision was judged on them."""
    same = set(dict(model.provenance.get("data", {})).values()) == {sha for _, sha in campaign.meta.sources}
    tool = model.provenance.get("tool") == f"stopset {version('stopset')}"
    last = dict(model.revisions[-1].after) if model.revisions else {}
    found = {k: v for k, v in last.items() if k.partition(":")[0] in HELD_OUT}
    return found if same and tool and len(found) == len(HELD_OUT) * (model.n + 1) else None


def _note(taken: Sequence[Judged], judged_on: str) -> str:
    """What the model file says of a revision: where each effect went, which were forced, and which kept their numbers."""

    def said(j: Judged) -> str:
        if j.stays:
            return ": the model had it, and its numbers stay"
        return "" if j.helps else " (forced: it does not help on held-out data)"

    parts = [f"{j.name} enters {j.enters}{said(j)}" for j in taken]
    return "; ".join([*parts, f"judged on {judged_on}"])


def stop_figures(model: Model, other: Model) -> dict[str, float]:
    """STOP 0 angle bound [rad] of single-axis stops from the largest speed and mid pose that both models saw: ``stop0_angle``
    the mean, ``stop0_angle:<joint>`` each; empty where not every one of them can be proved, as with an effect that no stop
    is bounded with."""
    angles = {}
    seen = [m.domain for m in (model, other)]
    middle = (np.maximum(*(d.q.lo for d in seen)) + np.minimum(*(d.q.hi for d in seen))) / 2
    slowest, fastest = np.maximum(*(d.dq.lo for d in seen)), np.minimum(*(d.dq.hi for d in seen))
    for joint, name in enumerate(model.joints):
        speed = np.zeros(model.n)
        speed[joint] = max(slowest[joint], fastest[joint], key=abs)
        try:
            bound = stop(model, middle, speed, "0").angle
        except NotCovered:
            return {}
        if bound is None:
            return {}
        angles[f"stop0_angle:{name}"] = float(bound[joint])
    return {"stop0_angle": float(np.mean(list(angles.values())))} | angles
