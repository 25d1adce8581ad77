"""Add recordings to a model without reading its old ones again: what they left is kept in a file beside the model.

*Signals* are kept whole and compressed (`signals_file`): everything is identified anew from them and the new recordings, so the
model is that of all recordings read together, to the last bit, its history aside.

*Sums* have a constant size (`adaptive_file`), for campaigns without end.  For a given nominal model the envelopes by motion,
the figures by trial and the survey's counts are all that the sets, margin and guarantee are made from.  They are maxima,
minima and rows summed in campaign order, so these equal those of all recordings read together with this nominal model
to the last bit.  Recorded stops are kept whole, and brakes and ramps identified from old and new ones.
The nominal model stays as it is, and so do the settings (trap P18); motions it was fitted to are never held out to judge it.
`staleness` says when it is time for a new one.
"""

from __future__ import annotations

import copy
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from stopset.artifact import Model, Revision
from stopset.errors import ModelFileError, RecordingError
from stopset.offline.campaign.conditions import one_condition
from stopset.offline.campaign.map_reduce import TrialCounter
from stopset.offline.campaign.run import Run
from stopset.offline.campaign.settings import settings_of
from stopset.offline.campaign.source import continued, joined, numbered_on
from stopset.offline.campaign.survey import STOPS, Survey, Tally
from stopset.offline.conform.gather import RetainedSums, Sums, sums_of
from stopset.offline.identify.model_file import Identification, concluded, stopped
from stopset.offline.identify.pipeline import identified
from stopset.offline.identify.signals_file import MAGIC, RetainedSignals, load_signals, save_signals
from stopset.offline.inspect.gate import check_signals, left_out
from stopset.offline.update import staleness
from stopset.offline.update.sums_file import load_sums, save_sums
from stopset.progress import Progress, silent
from stopset.recording import Recording, suite_label
from stopset.recording.repetition import POWERED

__all__ = ["load_state", "save_state", "update"]

WIDEST = 10.0  # times: friction up by a half widens torque sets 7.6 times; a load of 2.8 kg did 15 times


def save_state(path: str | Path, retained: RetainedSums | RetainedSignals, model: Model) -> None:
    """Write what is kept of the recordings of ``model``, whole or not at all; ``model`` as saved, with its SHA-256."""
    if isinstance(retained, RetainedSignals):
        save_signals(path, retained, model)
    else:
        save_sums(path, retained, model)


def load_state(path: str | Path, model: Model) -> RetainedSums | RetainedSignals:
    """Read what was kept for ``model``.

    Raises `ModelFileError` for a file that is damaged, foreign, of another version or of another model.
    """
    try:
        with Path(path).open("rb") as file:
            whole = file.read(len(MAGIC)) == MAGIC
    except OSError as e:
        raise ModelFileError(
            f"{path} cannot be read ({e.strerror}); expected what `stopset identify --keep` wrote: identify again with it"
        ) from e
    return load_signals(path, model) if whole else load_sums(path, model)


def update(
    model: Model,
    retained: RetainedSums | RetainedSignals,
    paths: Sequence[str | Path],
    progress: Progress = silent,
    scheduler: str | None = None,
    *,
    wide: bool = False,
) -> Identification:
    """``model`` with the recordings of ``paths`` added to those it was made from, of which ``retained`` is left.

    From signals the result is that of all recordings, history aside; from sums that of all recordings with this nominal model.
    ``wide``: torque sets that grow beyond `WIDEST` are accepted.
    Raises `RecordingError` for recordings that are part of it already, hold another kind of torque, are of another condition, or make the
    torque sets that much wider.
    """
    updated = _again if isinstance(retained, RetainedSignals) else _folded
    fresh = updated(model, retained, paths, progress, scheduler)  # type: ignore[arg-type]
    if not wide:
        _of_one_arm(model, fresh.model)
    return fresh


def _of_one_arm(before: Model, after: Model) -> None:
    """Refuse recordings that widen the torque sets as no other motion of the same arm does, margin aside."""
    key = "sum_U_width_without_margin"
    old, new = (dict(m.revisions[-1].after).get(key) if m.revisions else None for m in (before, after))
    if old is None or new is None or new <= WIDEST * old:
        return
    raise RecordingError(
        f"with these recordings the widths of U would grow from {old:.3g} to {new:.3g} N m in sum; expected at most {WIDEST:g} times as "
        "much of one arm in one condition: look for what differs (payload, tool, day; `stopset inspect --robot` with all files), and "
        "identify them apart, or take them all the same with --accept-wide"
    )


def _again(
    model: Model, retained: RetainedSignals, paths: Sequence[str | Path], progress: Progress, scheduler: str | None
) -> Identification:
    """Everything identified anew from the kept signals and the new recordings."""
    robot, old = model.robot.as_described, retained.campaign.meta
    campaign = continued(retained.campaign, robot, paths, retained.places)
    fresh = identified(robot, campaign, settings_of(model), progress, scheduler, retained.known, "signals")
    names = ", ".join(name for name, _ in campaign.meta.sources[len(old.sources) :])
    note = (
        f"{names} added to {', '.join(name for name, _ in old.sources)}; everything is identified from all of these, as if they had "
        "been read together"
    )
    return replace(fresh, model=_next_revision(model, fresh.model, f"recordings {names}", note))


def _folded(
    model: Model, retained: RetainedSums, paths: Sequence[str | Path], progress: Progress, scheduler: str | None
) -> Identification:
    """The new recordings folded into sums; raises `RecordingError` too if they hold neither powered motion nor stops."""
    settings, robot = settings_of(model), replace(model.robot.as_described, notes=())
    meta, files = joined(retained.meta, paths), len(retained.meta.sources)

    def source() -> Iterator[Recording]:
        return numbered_on(retained.meta, robot, paths, retained.tally.places)

    progress("reading the new recordings")
    tally = copy.deepcopy(retained.tally)
    phases: Counter[str] = Counter()
    stops = list(retained.stops)
    for r in source():
        phases[r.phase] += 1
        tally.add(r)
        if r.phase in STOPS:
            stops.append(r)
    if not settings.mixed:
        one_condition(tally.conditions)
    _check_phases(phases, tally, retained)
    found = tally.survey(retained.learnt, retained.session, retained.dt)
    check_signals(robot, meta, found.sample)
    numbers = _numbers(retained, found)
    new, trials = len(set(found.motion.values()) - set(numbers.values())), len(tally.steps) - len(retained.tally.steps)
    progress(f"{trials} {found.phase} trials, {new} new motions beside the {len(set(numbers.values()))} known ones")
    nominal, difference = retained.nominal, None
    if nominal.data is not None:
        nominal = replace(nominal, data=staleness.folded(nominal.data, robot, model, source(), found))
        assert nominal.data is not None
        difference = staleness.torque_difference(nominal.data, robot, model)
    counter = TrialCounter(trials, progress)
    run = Run(robot, meta, source, found, settings)
    later = sums_of(run, nominal, retained.form, keep=True, scheduler=scheduler, counter=counter)
    earlier = Sums(retained.sums.gathered.mapped(lambda env: env, numbers), retained.sums.figures)
    progress("identifying the sets")
    fresh = concluded(run, nominal, retained.form, earlier.merge(later), tally)
    assert isinstance(fresh.retained, RetainedSums)
    names = ", ".join(name for name, _ in meta.sources[files:])
    note = (
        f"{trials} trials ({new} new motions) of {names} added; the nominal model stays that of "
        f"{', '.join(dict.fromkeys(name for name, _ in retained.meta.sources[: retained.fitted_files]))}"
    )
    if trials:
        note += "; " + staleness.note(model, retained.sums.figures, later.figures, difference)
    if len(stops) > len(retained.stops):
        note += f"; {len(stops) - len(retained.stops)} stops added to {len(retained.stops)}"
    note += "".join(f"; {text}" for text in left_out(robot, found.spikes[len(retained.tally.spikes) :]))
    fresh = stopped(replace(fresh, retained=replace(fresh.retained, fitted_files=retained.fitted_files)), stops, progress)
    return replace(fresh, model=_revised(model, fresh.model, f"recordings {names}", note))


def _check_phases(phases: Counter[str], tally: Tally, retained: RetainedSums) -> None:
    best = next((p for p in POWERED if phases[p]), None)
    if best is not None and POWERED.index(best) < POWERED.index(tally.phase):
        raise RecordingError(
            f"the new recordings hold {best} trials, the model's sets rest on {tally.phase} ones; identify again from all recordings"
        )
    if len(tally.steps) > len(retained.tally.steps) or any(phases[p] for p in STOPS):
        return
    raise RecordingError(
        f"the new recordings hold only {', '.join(sorted(phases))} trials and none of three samples that the model rests on; "
        f"expected {tally.phase} trials or stops: record some"
    )


def _numbers(retained: RetainedSums, found: Survey) -> dict[int, int]:
    """Old number of each motion -> new one; a new recording may show two old motions to be one."""
    out: dict[int, int] = {}
    for suite, number in retained.motion.items():
        if out.setdefault(number, found.motion[suite]) != found.motion[suite]:
            raise ModelFileError(
                f"motion {number} of the kept state falls apart ({suite_label(suite)}); expected motions to be told apart as "
                "before: identify again from all recordings"
            )
    return out


def _revised(old: Model, fresh: Model, added: str, note: str) -> Model:
    """``fresh`` as the next revision of ``old``, with what no recording tells anything about, and the laws chosen for the nominal model, which
    stays; the note is among its notes too."""
    chosen = {k: v for k, v in old.provenance.items() if k == "chosen"}
    fresh = replace(
        fresh, domain=replace(fresh.domain, payload=old.domain.payload), provenance={**old.provenance, **fresh.provenance, **chosen},
        notes=(*fresh.notes, f"updated: {note}"),
    )  # fmt: skip
    return _next_revision(old, fresh, added, note)


def _next_revision(old: Model, fresh: Model, added: str, note: str) -> Model:
    number = old.revisions[-1].number + 1 if old.revisions else 1
    before = dict(old.revisions[-1].after) if old.revisions else {}
    revision = Revision(number, added, before, dict(fresh.revisions[-1].after), note)
    return replace(fresh, revisions=(*old.revisions, revision))
