"""Errors of a nominal model on trials it was not fitted to."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from stopset.effects.base import Fitted
from stopset.offline.abstraction.metrics import joint_figures
from stopset.offline.abstraction.nominal_part import NominalPart, fit_nominal, pairs_of, roller
from stopset.offline.campaign.hold_out import hold_out
from stopset.offline.campaign.run import Run
from stopset.offline.campaign.settings import Settings
from stopset.offline.campaign.source import Campaign
from stopset.offline.campaign.survey import Survey, survey
from stopset.offline.campaign.trials import Source
from stopset.offline.nominal.low_pass import recorded_low_pass
from stopset.recording import Meta
from stopset.robot import Robot


@dataclass(frozen=True, slots=True)
class Halves:
    """Trials to fit and trials that judge, each with its survey in the session of the whole; ``words``: what judges, for people."""

    fitted: Source
    learnt: Survey
    judging: Source
    judged: Survey
    words: str


def halves(campaign: Campaign) -> Halves:
    """The division of a campaign in which a nominal model is judged."""
    whole = campaign.seen.survey
    division = hold_out(whole)
    fitted, judging = division.to_fit(campaign.trials), division.to_judge(campaign.trials)
    learnt, judged = (replace(survey(half), session=whole.session) for half in (fitted, judging))
    return Halves(fitted, learnt, judging, judged, division.words)


def nominal_of(robot: Robot, meta: Meta, parts: Halves, settings: Settings, known: tuple[Fitted, ...] = ()) -> NominalPart:
    """The nominal model of what does not judge alone."""
    found = parts.learnt
    if meta.effort != "compensated_torque":
        found = replace(found, low_pass=recorded_low_pass(robot, found.sample))
    return fit_nominal(Run(robot, meta, parts.fitted, found, settings), known)


def nominal_figures(nominal: NominalPart, meta: Meta, parts: Halves) -> dict[str, dict[str, Any]]:
    """Errors per joint of a nominal model on what judges."""
    pairs = pairs_of(parts.judging, parts.judged, nominal, meta.effort)
    joints, roll = nominal.robot.joints, roller(nominal, meta.effort, parts.judged)
    return joint_figures(pairs, nominal.abstraction, joints, parts.judged.dt, roll)
