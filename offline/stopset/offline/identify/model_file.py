"""The model file's content put together: sets, guarantee, figures, provenance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from typing import Any

import numpy as np

from stopset.artifact import Domain, Model, Revision, UncertaintySets
from stopset.errors import RecordingError
from stopset.offline.abstraction.metrics import STOP_TIME, Figures
from stopset.offline.abstraction.nominal_part import NominalPart
from stopset.offline.brakes import identify_stops, with_stops
from stopset.offline.brakes.data_sheet import assumed_brakes
from stopset.offline.campaign.run import Run
from stopset.offline.campaign.settings import Settings
from stopset.offline.campaign.survey import Survey, Tally
from stopset.offline.compare.known import rms_left
from stopset.offline.conform.bands import band_sets
from stopset.offline.conform.gather import RetainedSums, SetForm, Sums, set_problem
from stopset.offline.conform.guarantee import union
from stopset.offline.conform.linear_sets import ConformedSets, conform, few_motions
from stopset.offline.conform.tightness import Tightness, of_tube
from stopset.offline.description.agreement import held_to_pinocchio
from stopset.offline.diagnose.examination import excess_left
from stopset.offline.diagnose.question import own_in_time
from stopset.offline.diagnose.standing import moves
from stopset.offline.identify.absurd import absurd, late, silent
from stopset.offline.identify.constants import settings_sha256
from stopset.offline.identify.rests import at_rest
from stopset.offline.identify.signals_file import RetainedSignals
from stopset.offline.nominal.parameter_uncertainty import notes as uncertainty_notes
from stopset.offline.nominal.parameter_uncertainty import widened
from stopset.progress import Progress
from stopset.reach.flowpipe import deviation_tube
from stopset.recording import Meta, Recording


@dataclass(frozen=True, slots=True)
class Identification:
    """The model and what was found on the way to it, for the command's printout and the report."""

    model: Model
    conformance: ConformedSets
    survey: Survey
    settings: Settings
    tightness: Tightness
    absurd: tuple[str, ...]
    retained: RetainedSums | RetainedSignals | None = None  # what later recordings can be added to, where that was asked for


def concluded(run: Run, nominal: NominalPart, form: SetForm, sums: Sums, tally: Tally | None = None) -> Identification:
    """Sets, guarantee and model file of a linear model from the sums of all its recordings; ``tally``: kept with them."""
    robot, meta, found = run.robot, run.meta, run.survey
    problem = set_problem(run, nominal.abstraction, form.template)
    gathered = sums.gathered.mapped(lambda env: env.upto(problem.steps))
    learnt = found.learnt_motions
    result = conform(gathered, problem, found.trials, learnt, nominal.unseen)
    by_band = {}
    if form.bands is not None and found.temp is not None:
        by_band = band_sets(gathered, form.bands, found.temp, result.margins, problem, learnt)
    everything = union(list(gathered.parts.values()))
    across = None if form.template is None else form.template.directions

    def tight(sets: UncertaintySets) -> Tightness:
        return of_tube(deviation_tube(nominal.abstraction, sets, across), everything.hi, everything.lo, robot.n)

    out = packed(run, nominal, sums.figures, result, by_band, tight)
    if tally is None:
        return out
    # what may judge the model later must stay what it was when the nominal model was fitted
    fitted = found.learnt or frozenset(found.motion) - found.held_out
    nominal = replace(nominal, notes=(*robot.notes, *nominal.notes))
    files = len(meta.sources)
    retained = RetainedSums(tally, sums, nominal, meta, fitted, found.session, found.dt, form, found.motion, files)
    return replace(out, retained=retained)


def packed(
    run: Run, nominal: NominalPart, figures: Figures, result: ConformedSets, by_band: dict[str, UncertaintySets],
    tight: Callable[[UncertaintySets], Tightness],
) -> Identification:  # fmt: skip
    """The model file's content from the sets and what was found on the way; ``tight`` judges the sets that go out."""
    robot, meta, found = run.robot, run.meta, run.survey
    errors, u_hull = figures.result(robot.joints), figures.u
    assert u_hull is not None
    seen = result.sets
    if few_motions(result.guarantee.calibration_motions):  # with more, the margin is what unseen motions asked for
        result = replace(
            result, sets=widened(seen, nominal.uncertain_torque), other=widened(result.other, nominal.uncertain_torque)
        )
        by_band = {name: widened(s, nominal.uncertain_torque) for name, s in by_band.items()}
    tightness = tight(result.sets)
    geared = nominal.rotors_shown
    odd = [*silent(found, robot.joints, tightness, geared=geared), *absurd(result.sets, errors, found, geared=geared)]
    rests = at_rest(seen.active, found.sample, robot.joints)
    said = (*late(found, robot.joints), *rests, *tightness.words(robot.joints), *(o.says for o in odd))
    bare = result.table[seen.conform].U  # a margin from few motions differs from one identification to the next
    widths = {"sum_U_width": float(result.sets.U.width.sum()), "sum_U_width_without_margin": float(bare.width.sum())}
    total = widths | _sums(errors)
    notes = list(result.notes)
    if by_band:
        notes.append(
            "the sets of temperature bands have the margin of the whole and enclose all that was recorded at these temperatures; "
            "of motions not yet seen only the whole's sets promise anything"
        )
    model = Model(
        robot=nominal.robot, rotor=nominal.rotor, inertia_std=nominal.inertia_std, rotors_shown=nominal.rotors_shown, effort=meta.effort,
        effects=nominal.effects,
        abstraction=nominal.abstraction,
        sets={"powered": result.sets, f"powered, {result.other.conform}": result.other} | by_band, brakes=assumed_brakes(robot),
        domain=Domain(found.q, found.dq, u_hull, found.temp), guarantee=result.guarantee, errors=errors,
        provenance=_provenance(run, nominal), revisions=(Revision(0, "", {}, total),),
        notes=(*meta.warnings, *robot.notes, *nominal.notes, *uncertainty_notes(seen, result.sets, robot.joints), *notes, *said),
    )  # fmt: skip
    model = _with_own_error(model, run, nominal)
    return Identification(model, result, found, run.settings, tightness, tuple(o.says for o in odd if o.grave))


def _with_own_error(model: Model, run: Run, nominal: NominalPart) -> Model:
    """With the torque that the model leaves of its own recordings, and how far that is beyond their sensors' noise: where it leaves no more
    of others, nothing has changed."""
    if model.effort == "compensated_torque":
        return model
    left, excess = nominal.left_of_own, nominal.excess_of_own
    if left is None:
        own = own_in_time(run, model, model.provenance["taken_out"])
        rms = rms_left(model, own.trials)
        left = tuple(float(x) if np.isfinite(x) else None for x in rms)
        with suppress(RecordingError):  # too short to be diagnosed
            excess = tuple(map(float, excess_left(model, own))) if any(map(moves, own)) else ()
    return replace(model, provenance={**model.provenance, "left_of_own_Nm": list(left), "excess_of_own": list(excess)})


def stopped(found: Identification, stops: Sequence[Recording], progress: Progress) -> Identification:
    """With brakes and ramps from recorded stops, where there are any; else the data sheet's brakes stay, as an assumption."""
    retained = replace(found.retained, stops=tuple(stops)) if isinstance(found.retained, RetainedSums) else None
    if not stops or found.model.effort == "compensated_torque":
        return replace(found, retained=retained)
    progress(f"brakes and ramps from {len(stops)} recorded stops")
    return replace(found, model=with_stops(found.model, identify_stops(found.model, stops)), retained=retained)


def _sums(errors: dict[str, dict[str, Any]]) -> dict[str, float]:
    keys = ("torque_rmse", "velocity_rmse", "position_rmse")
    return {f"sum_{k}": float(sum(row[k] for row in errors.values() if row[k] is not None)) for k in keys}


def _sources(meta: Meta) -> dict[str, str]:
    """File name -> SHA-256; files of one name in several folders are numbered."""
    out: dict[str, str] = {}
    for name, sha256 in meta.sources:
        again = sum(other == name or other.startswith(f"{name} (") for other in out)
        out[f"{name} ({again + 1})" if again else name] = sha256
    return out


def _provenance(run: Run, nominal: NominalPart) -> dict[str, Any]:
    robot, meta, found, settings = run.robot, run.meta, run.survey, run.settings
    return {
        "tool": f"stopset {version('stopset')}",
        "settings": asdict(settings),
        "settings_sha256": settings_sha256(settings),
        # rad and rad/s are not addable (trap P11): what a velocity was weighted by when widths were traded
        "cost": {"velocity_counts_for_s": STOP_TIME, "age_weight": f"1 / (age + {STOP_TIME} s)"},
        "data": _sources(meta),
        "phase": found.phase,
        "trials": found.trials,
        "samples": found.samples,
        "motions": run.motions,
        "session_trials": found.places,
        "velocity": meta.velocity,
        "chosen": [g.name for g in nominal.chosen],
        "taken_out": list(nominal.taken_out),
        "friction_covariance": nominal.friction_covariance,
        "left_open": nominal.left_open.tolist(),
        "description_read_again": asdict(held_to_pinocchio(robot)),
        "clock": "resampled to the grid" if found.irregular else meta.clock,
    }
