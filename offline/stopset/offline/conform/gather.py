"""The heavy pass over all trials of a linear model: what it leaves, and what is kept of it for later recordings."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from stopset.artifact import Abstraction
from stopset.offline.abstraction.metrics import Figures
from stopset.offline.abstraction.nominal_part import NominalPart, pairs_of, roller
from stopset.offline.campaign.calibration import split
from stopset.offline.campaign.map_reduce import Range, TrialCounter, in_parts, within
from stopset.offline.campaign.run import Run
from stopset.offline.campaign.session import Session
from stopset.offline.campaign.survey import Tally
from stopset.offline.conform.bands import Bands
from stopset.offline.conform.linear_sets import Gathered, few_motions, gather
from stopset.offline.conform.problem import Options, SetProblem
from stopset.offline.conform.zonotopes import Template, template
from stopset.progress import silent
from stopset.recording import Meta, Recording, SuiteKey
from stopset.types import Array


@dataclass(frozen=True, slots=True)
class Sums:
    """What the heavy pass leaves: running envelopes, and errors trial by trial."""

    gathered: Gathered
    figures: Figures

    def merge(self, later: Sums) -> Sums:
        """Both together; ``later`` holds trials that come after this one's."""
        return Sums(self.gathered.merge(later.gathered), self.figures.merge(later.figures))


@dataclass(frozen=True, slots=True)
class SetForm:
    """What sets there are to be beside boxes for all temperatures: cut into temperature bands, or as zonotopes."""

    bands: Bands | None = None
    template: Template | None = None


@dataclass(frozen=True, slots=True)
class RetainedSums:
    """All that an update needs of recordings that are read no more, for one nominal model."""

    tally: Tally
    sums: Sums
    nominal: NominalPart
    meta: Meta
    learnt: frozenset[SuiteKey]  # suites the nominal model was fitted to
    session: Session  # what it counts warming in
    dt: float  # [s] the sets' grid
    form: SetForm
    motion: dict[SuiteKey, int]
    fitted_files: int  # how many of the files the nominal model was fitted to
    stops: tuple[Recording, ...] = ()  # brakes and ramps do not fold: their recordings, which are short, are kept whole


def template_of(run: Run, nominal: NominalPart) -> Template:
    """What a zonotope is made of, from the trials in memory that judge nothing."""
    found = run.survey
    sample = [r for r in found.sample if r.suite_key not in found.held_out]
    trials = [(np.hstack([r.q, r.dq]), u) for _, r, u in pairs_of(lambda: sample, found, nominal, run.meta.effort)()]
    return template(trials, nominal.abstraction, nominal.robot, found.dt)


def set_problem(run: Run, abstraction: Abstraction, template: Template | None = None) -> SetProblem:
    """What is asked of the sets of a run's model."""
    options = Options(run.settings.conform, run.settings.windows, run.settings.margin)
    return SetProblem(abstraction, run.robot.joints, run.survey.readings, run.survey.dt, run.horizon, options, template)


def sums_of(
    run: Run,
    nominal: NominalPart,
    form: SetForm,
    *,
    keep: bool,
    scheduler: str | None = None,
    counter: TrialCounter | None = None,
) -> Sums:
    """The heavy pass over the trials of a linear model; ``keep``: all that any later recordings could ask for too."""
    problem = set_problem(run, nominal.abstraction, form.template)
    if keep:
        problem = replace(problem, horizon=run.settings.horizon)
    found = replace(run.survey, sample=())  # what a part needs, without the trials kept in memory
    source, effort = run.trials, run.meta.effort
    halves = keep or few_motions(len(split(sorted(set(found.motion.values()))).used))
    in_bands = None if form.bands is None else form.bands.of
    here = counter if scheduler is None else None  # a cluster's parts come back whole

    def part(trials: Range) -> tuple[Gathered, Figures]:
        figures = Figures(nominal.abstraction, found.dt, roller(nominal, effort, found))

        def pairs() -> Iterator[tuple[int, Recording, Array]]:
            for motion, r, u in pairs_of(within(source, trials), found, nominal, effort)():
                figures.add(r, u)
                yield motion, r, u
                if here is not None:
                    here.step()

        return gather(pairs, problem, halves=halves, bands=in_bands), figures

    return Sums(*in_parts(part, found.places, scheduler, silent if counter is None else counter.progress))
