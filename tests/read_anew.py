"""An update's sets from all recordings read again: what folding new ones into kept sums must equal to the last bit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from stopset.artifact import Model
from stopset.offline.campaign.run import Run
from stopset.offline.campaign.settings import settings_of
from stopset.offline.campaign.source import campaign_of
from stopset.offline.campaign.survey import STOPS, Tally
from stopset.offline.conform.gather import RetainedSums, sums_of
from stopset.offline.identify.model_file import Identification, concluded, stopped
from stopset.progress import Progress, silent


def from_scratch(
    model: Model, retained: RetainedSums, paths: Sequence[str | Path], progress: Progress = silent, scheduler: str | None = None
) -> Identification:
    """Sets of the nominal part of ``model`` from all of ``paths``, read anew; what an update must equal.

    ``paths`` begin with the files that the model was made from; of ``retained`` only what belongs to the nominal model counts.
    """
    settings, robot = settings_of(model), replace(model.robot.as_described, notes=())
    meta, source = (campaign := campaign_of(robot, paths)).meta, campaign.trials
    progress("reading the recordings")
    tally = Tally(retained.tally.phase)
    stops = []
    for r in source():
        tally.add(r)
        if r.phase in STOPS:
            stops.append(r)
    found = tally.survey(retained.learnt, retained.session, retained.dt)
    run = Run(robot, meta, source, found, settings)
    sums = sums_of(run, retained.nominal, retained.form, keep=True, scheduler=scheduler)
    whole = stopped(concluded(run, retained.nominal, retained.form, sums, tally), stops, progress)
    # the laws that were chosen for the nominal model stay with it
    chosen = {k: x for k, x in model.provenance.items() if k == "chosen"}
    return replace(whole, model=replace(whole.model, provenance={**whole.model.provenance, **chosen}))
