"""Errors of a nominal model on trials it was not fitted to."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from stopset.effects.base import Fitted
from stopset.offline.abstraction.metrics import joint_figures
from stopset.offline.abstraction.nominal_part import fit_nominal, pairs_of, roller
from stopset.offline.campaign.hold_out import HoldOut
from stopset.offline.campaign.run import Run
from stopset.offline.campaign.session import Session
from stopset.offline.campaign.settings import Settings
from stopset.offline.campaign.source import Campaign
from stopset.offline.campaign.survey import survey
from stopset.offline.nominal.low_pass import recorded_low_pass
from stopset.robot import Robot


def nominal_figures(
    robot: Robot, campaign: Campaign, settings: Settings, division: HoldOut, session: Session, known: tuple[Fitted, ...] = ()
) -> dict[str, dict[str, Any]]:
    """Errors per joint, on what judges by the ``division``, of a nominal model fitted to the rest alone."""
    meta, fitted, judging = campaign.meta, division.to_fit(campaign.trials), division.to_judge(campaign.trials)
    found = replace(survey(fitted), session=session)
    if meta.effort != "compensated_torque":
        found = replace(found, low_pass=recorded_low_pass(robot, found.sample))
    nominal = fit_nominal(Run(robot, meta, fitted, found, settings), known)
    judged = replace(survey(judging), session=session)
    pairs = pairs_of(judging, judged, nominal, meta.effort)
    return joint_figures(pairs, nominal.abstraction, robot.joints, judged.dt, roller(nominal, meta.effort, judged))
