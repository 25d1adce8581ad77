"""Identify: from recordings to the model file, in the order of the house: nominal model, abstraction, sets, guarantee."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from stopset.artifact import Abstraction, UncertaintySets
from stopset.effects.base import Fitted
from stopset.effects.selection import matches
from stopset.errors import NotConformant, NotCovered
from stopset.offline.abstraction.grid import coarser
from stopset.offline.abstraction.metrics import Figures
from stopset.offline.abstraction.nominal_part import NominalPart, fit_nominal, pairs_of
from stopset.offline.abstraction.order_selection import abstracted
from stopset.offline.abstraction.swift import swift
from stopset.offline.campaign.calibration import split
from stopset.offline.campaign.conditions import one_condition
from stopset.offline.campaign.map_reduce import TrialCounter, passing
from stopset.offline.campaign.run import Run
from stopset.offline.campaign.settings import Settings
from stopset.offline.campaign.source import Campaign, campaign_of
from stopset.offline.campaign.survey import Tally
from stopset.offline.campaign.trials import Pairs
from stopset.offline.conform.bands import Bands, cut
from stopset.offline.conform.bands import name as band_name
from stopset.offline.conform.gather import SetForm, set_problem, sums_of, template_of
from stopset.offline.conform.linear_sets import ConformedSets, few_motions
from stopset.offline.conform.nonlinear import NEAREST, Diverges
from stopset.offline.conform.nonlinear_sets import conform_nonlinear
from stopset.offline.conform.tightness import Along, Tightness
from stopset.offline.description.agreement import held_to_pinocchio
from stopset.offline.identify.asked_effects import asked_effects
from stopset.offline.identify.ladder import Abstracted, WithSets, climbed
from stopset.offline.identify.model_file import Identification, concluded, packed, stopped
from stopset.offline.identify.signals_file import RetainedSignals
from stopset.offline.identify.unseen import unseen
from stopset.offline.inspect.gate import check_files, check_signals, check_trials, left_out
from stopset.offline.nominal.friction_choice import Gain
from stopset.offline.nominal.low_pass import in_words, recorded_low_pass
from stopset.offline.nominal.pair_choice import coupled
from stopset.offline.nominal.preprocess import Preprocessing
from stopset.progress import Progress, silent
from stopset.robot import Robot
from stopset.words import many

__all__ = ["Identification", "Keep", "Settings", "identified", "identify"]

PASSES = 8  # about, over the recordings: shared motors, friction laws, the nominal model, and again on one half of the motions
FITTING = "fitting the nominal model"
Keep = Literal["signals", "sums"] | None


def identify(
    robot: Robot, paths: Sequence[str | Path], settings: Settings | None = None, progress: Progress = silent,
    scheduler: str | None = None, known: tuple[Fitted, ...] = (), keep: Keep = None,
) -> Identification:  # fmt: skip
    """Identify a reachset-conformant model of ``robot`` from the recordings in ``paths``.

    ``progress`` is given each step; ``scheduler``: address of a Dask scheduler to run the heavy pass on; ``keep``: keep what
    later recordings can be added to (`stopset.offline.update.update`), the signals themselves or sums of constant size;
    ``known``: numbers of those of ``settings.effects`` that were estimated before (motor torque only).

    Raises `RecordingError`, `NotConformant`.
    """
    return identified(robot, campaign_of(robot, paths), settings or Settings(), progress, scheduler, known, keep)


def identified(
    robot: Robot, campaign: Campaign, chosen: Settings, progress: Progress = silent, scheduler: str | None = None,
    known: tuple[Fitted, ...] = (), keep: Keep = None,
) -> Identification:  # fmt: skip
    """`identify` from the trials of a ``campaign``, wherever they come from."""
    meta, source = campaign.meta, campaign.trials
    held_to_pinocchio(robot)
    progress("reading the recordings")
    tally, stops, found = campaign.seen
    if not chosen.mixed:
        one_condition(tally.conditions)
    warnings = (
        *check_signals(robot, meta, found.sample),
        *left_out(robot, found.spikes, found.polled, found.held),
        *check_files(robot, meta, source(), mixed=chosen.mixed),
        *check_trials(robot, meta, found.sample, mixed=chosen.mixed),
    )
    for text in warnings:
        progress(text)
    meta = replace(meta, warnings=(*meta.warnings, *warnings))
    progress(f"{many(found.trials, f'{found.phase} trial')}, {found.samples} samples")
    run = Run(robot, meta, source, found, chosen)
    learning = run.learning
    learnt = learning.survey
    if meta.effort != "compensated_torque" and (cutoff := recorded_low_pass(robot, learnt.sample)):
        learnt = replace(learnt, low_pass=cutoff)
        progress(in_words(cutoff))
    fitting = replace(run, trials=passing(learning.trials, len(learnt.sample), PASSES, FITTING, progress), survey=learnt)
    shared = _shared(fitting, known)
    numbers = asked_effects(fitting, known, [g.name for g in shared])
    shared = tuple(g for g in shared if any(matches(f, g.name) for f in numbers))
    nominal = fit_nominal(fitting, numbers)
    plain = replace(nominal, chosen=(*shared, *nominal.chosen), notes=(*(g.says for g in shared), *nominal.notes))
    if chosen.margin is None and found.session.repeats < 2 and few_motions(len(split(sorted(set(found.motion.values()))).used)):
        factor, note = unseen(fitting, nominal, numbers, progress)
        plain = replace(plain, unseen=factor, notes=(*plain.notes, *filter(None, [note])))

    def formed(asked: Settings) -> NominalPart:
        return swift(abstracted(replace(fitting, settings=asked), numbers, plain), learnt, meta.effort)

    def with_sets(asked: Settings, part: NominalPart) -> Identification:
        try:
            return _with_sets(
                replace(run, settings=asked), part, progress, scheduler, deepcopy(tally) if keep == "sums" else None
            )
        except NotConformant as e:
            raise type(e)("; ".join([str(e), *part.limited])) from e

    first = replace(chosen, ladder=False)
    nominal = formed(first)
    _check_linear(chosen, nominal.abstraction, keep)
    if chosen.ladder and keep is None and meta.effort != "compensated_torque":
        out = climbed(
            lambda: _bounded(first, nominal, (formed, with_sets), progress),
            nominal,
            learnt,
            chosen,
            meta.effort,
            (formed, with_sets),
            progress,
        )
    else:
        out = _bounded(first, nominal, (formed, with_sets), progress)
    out = stopped(out, stops, progress)
    return replace(out, retained=RetainedSignals(campaign, found.places, known)) if keep == "signals" else out


def _check_linear(chosen: Settings, found: Abstraction, keep: Keep) -> None:
    """Raises `NotCovered` where what was asked for is there for the linear model only."""
    if chosen.shape == "zonotope" and not found.linear:
        raise NotCovered(
            f"zonotopes are found for the linear model only, this is model {found.kind} of order {found.order}; leave --shape out, or "
            "take --model 1 --order 1"
        )
    if keep == "sums" and not found.linear:
        raise NotCovered(
            f"model {chosen.model} of order {found.order} does not fold: its windows are looked at together; keep signals, or take the "
            "linear model (--model 1 --order 1)"
        )


def _bounded(settings: Settings, nominal: NominalPart, steps: tuple[Abstracted, WithSets], progress: Progress) -> Identification:
    """Of the order that predicts best, or where its predictions run away and nobody has asked for it, of the linear model."""
    formed, with_sets = steps
    try:
        return with_sets(settings, nominal)
    except Diverges as e:
        if settings.order is not None or settings.model != 1 or nominal.abstraction.order == 1:
            raise
        progress(f"{e}; the linear model is taken")
        linear = formed(replace(settings, order=1))
        note = f"order {nominal.abstraction.order} predicts best and runs away from some motion: order 1 was taken"
        return with_sets(settings, replace(linear, notes=(*linear.notes, note)))


def _shared(run: Run, known: Sequence[Fitted]) -> tuple[Gain, ...]:
    """Pairs of joints that share a motor by the evidence, where that is to be looked for and nobody has said so already."""
    if run.meta.effort == "compensated_torque" or run.settings.friction != "evidence":
        return ()
    stated = {f.label for f in known} | set(run.settings.effects)
    found = coupled(run.robot, run.trials, run.survey.sample, Preprocessing(low_pass=run.survey.low_pass))
    return tuple(g for g in found if g.effect not in stated and g.name not in stated)


def _with_sets(run: Run, nominal: NominalPart, progress: Progress, scheduler: str | None, tally: Tally | None) -> Identification:
    found, settings = run.survey, run.settings
    bands = cut(found.means, found.temp, settings.bands) if settings.bands else None
    progress(f"{many(run.motions, 'independent motion')}; deviations of every prediction up to {run.horizon:.2f} s ahead")
    if nominal.abstraction.linear:
        form = SetForm(bands, template_of(run, nominal) if settings.shape == "zonotope" else None)
        counter = TrialCounter(found.trials, progress)
        sums = sums_of(run, nominal, form, keep=tally is not None, scheduler=scheduler, counter=counter)
        progress("identifying the sets")
        return concluded(run, nominal, form, sums, tally)
    # its windows do not fold into an envelope: trials in memory, one process
    figures = Figures(nominal.abstraction, found.dt)
    pairs = pairs_of(run.trials, found, nominal, run.meta.effort)
    for _, r, u in pairs():
        figures.add(r, u)
    progress("identifying the sets along the nominal solutions")

    problem = set_problem(run, nominal.abstraction)

    def sets_of(some: Pairs, margin: float | None) -> ConformedSets:
        return conform_nonlinear(
            some, replace(problem, options=replace(problem.options, margin=margin)), found.trials, progress, nominal.unseen
        )

    while True:
        try:
            result = sets_of(pairs, settings.margin)
            break
        except Diverges:
            if problem.horizon <= NEAREST:
                raise
            problem = replace(problem, horizon=max(0.5 * problem.horizon, NEAREST))
            short = f"predictions run away further ahead: the sets of this model reach {problem.horizon:.3g} s ahead"
            progress(short)
    if problem.horizon < run.horizon:
        nominal = replace(nominal, notes=(*nominal.notes, short))
    by_band = {}
    if bands is not None and found.temp is not None:
        for k in range(bands.number):
            sets = sets_of(_in_band(pairs, bands, k), float(result.margins.max())).sets
            by_band[band_name(k)] = replace(sets, temp=bands.band(k, found.temp))

    def tight(sets: UncertaintySets) -> Tightness:
        judge, every = Along(nominal.abstraction, sets), round(sets.dt / found.dt)
        for _, r, u in pairs():
            judge.add(coarser([(np.hstack([r.q, r.dq]), u)], every)[0])
        return judge.result()

    return packed(run, nominal, figures, result, by_band, tight)


def _in_band(pairs: Pairs, bands: Bands, k: int) -> Pairs:
    return lambda: (p for p in pairs() if k in bands.of(p[1]))
