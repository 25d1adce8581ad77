"""Errors of a nominal model on trials it was not fitted to."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from stopset.effects.base import Fitted
from stopset.offline.campaign.source import common_meta
from stopset.offline.campaign.survey import Source, survey
from stopset.offline.compare.metrics import joint_figures
from stopset.offline.identify.settings import Settings
from stopset.offline.nominal.model import fit_nominal, pairs_of, roller
from stopset.recording import Recording, stream_recordings
from stopset.robot import Robot


def nominal_figures(
    robot: Robot, paths: Sequence[str | Path], settings: Settings, train: Callable[[Recording], bool],
    held: Callable[[Recording], bool], known: tuple[Fitted, ...] = (),
) -> dict[str, dict[str, Any]]:  # fmt: skip
    """Errors per joint on the ``held`` trials of a nominal model fitted to the ``train`` trials alone."""
    meta = common_meta(paths)
    everything = survey(lambda: stream_recordings(paths, robot))

    def part(keep: Callable[[Recording], bool]) -> Source:
        # poses at rest belong to no motion: both halves may know them
        return lambda: (r for r in stream_recordings(paths, robot) if r.phase == "static" or keep(r))

    found = replace(survey(part(train)), session=everything.session)
    nominal = fit_nominal(robot, meta, part(train), found, settings, known)
    judged = replace(survey(part(held)), session=everything.session)
    pairs = pairs_of(part(held), judged, nominal, meta.effort)
    return joint_figures(pairs, nominal.abstraction, robot.joints, found.dt, roller(nominal, meta.effort, judged))
