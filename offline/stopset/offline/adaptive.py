"""Add recordings to a model without reading its old ones again: their sums are kept in a file beside the model.

For a given nominal model the envelopes by motion, the figures by trial and the survey's counts are all that the sets,
margin and guarantee are made from.  They are maxima, minima and rows summed in campaign order, so the result equals that
of all recordings read together (`from_scratch`) to the last bit.  Recorded stops are kept whole, and brakes and ramps
identified from old and new ones.  The nominal model stays as it is, and so do the settings (trap P18); motions it was fitted
to are never held out to judge it.  `drift` says when it is time for a new one.
"""

from __future__ import annotations

import copy
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from stopset.artifact import Model, Revision
from stopset.errors import ModelFileError, RecordingError
from stopset.offline import drift
from stopset.offline.adaptive_file import load_state, save_state
from stopset.offline.assembly import STOPS, Identification, concluded, stopped
from stopset.offline.parts import Progress
from stopset.offline.revise import description, settings_of
from stopset.offline.sources import common_meta
from stopset.offline.sums import Kept, Sums, sums_of
from stopset.offline.survey import POWERED, Survey, Tally
from stopset.recording import Meta, Recording, stream_recordings

__all__ = ["from_scratch", "load_state", "save_state", "update"]

Tell = Callable[[str], None]
UPDATED = "updated: "  # begins the note of an update


def update(
    model: Model, kept: Kept, paths: Sequence[str | Path], tell: Tell = lambda _: None, scheduler: str | None = None
) -> Identification:
    """``model`` with the recordings of ``paths`` added to those it was made from, whose sums are ``kept``.

    Raises `RecordingError` for recordings that are part of it already, hold another kind of torque, or no powered motion.
    """
    settings, robot = settings_of(model), replace(description(model), notes=())
    meta = _joined(kept.meta, paths)
    places, files = kept.tally.places, len(kept.meta.sources)

    def source() -> Iterator[Recording]:
        for r in stream_recordings(paths, robot):
            yield replace(r, place=places + r.place, file=files + r.file)

    tell("reading the new recordings")
    tally = copy.deepcopy(kept.tally)
    phases: Counter[str] = Counter()
    stops = list(kept.stops)
    for r in source():
        phases[r.phase] += 1
        tally.add(r)
        if r.phase in STOPS:
            stops.append(r)
    _check_phases(phases, tally, kept)
    found = tally.survey(kept.learnt, kept.session, kept.dt)
    numbers = _numbers(kept, found)
    new, trials = len(set(found.motion.values()) - set(numbers.values())), len(tally.steps) - len(kept.tally.steps)
    tell(f"{trials} {found.phase} trials, {new} new motions beside the {len(set(numbers.values()))} known ones")
    nominal, difference = kept.nominal, None
    if nominal.data is not None:
        nominal = replace(nominal, data=drift.folded(nominal.data, robot, model, source(), found))
        assert nominal.data is not None
        difference = drift.apart(nominal.data, robot, model)
    progress = Progress(trials, tell)
    later = sums_of(source, found, nominal, meta.effort, settings, kept.bands, kept.template, True, scheduler, progress)
    earlier = Sums(kept.sums.gathered.mapped(lambda env: env, numbers), kept.sums.figures)
    tell("identifying the sets")
    fresh = concluded(robot, meta, found, nominal, settings, kept.bands, kept.template, earlier.merge(later), tally)
    assert fresh.kept is not None
    names = ", ".join(name for name, _ in meta.sources[files:])
    note = (
        f"{UPDATED}{trials} trials ({new} new motions) of {names} added; the nominal model stays that of "
        f"{', '.join(dict.fromkeys(name for name, _ in kept.meta.sources[: kept.fitted_files]))}"
    )
    if trials:
        note += "; " + drift.note(model, kept.sums.figures, later.figures, difference)
    if len(stops) > len(kept.stops):
        note += f"; {len(stops) - len(kept.stops)} stops added to {len(kept.stops)}"
    fresh = stopped(replace(fresh, kept=replace(fresh.kept, fitted_files=kept.fitted_files)), stops, tell)
    return replace(fresh, model=_revised(model, fresh.model, f"recordings {names}", note))


def from_scratch(
    model: Model, kept: Kept, paths: Sequence[str | Path], tell: Tell = lambda _: None, scheduler: str | None = None
) -> Identification:
    """Sets of the nominal part of ``model`` from all of ``paths``, read anew; what an update must equal.

    ``paths`` begin with the files that the model was made from; of ``kept`` only what belongs to the nominal model counts.
    """
    settings, robot = settings_of(model), replace(description(model), notes=())
    meta = common_meta(paths)

    def source() -> Iterator[Recording]:
        return stream_recordings(paths, robot)

    tell("reading the recordings")
    tally = Tally(kept.tally.phase)
    stops = []
    for r in source():
        tally.add(r)
        if r.phase in STOPS:
            stops.append(r)
    found = tally.survey(kept.learnt, kept.session, kept.dt)
    sums = sums_of(source, found, kept.nominal, meta.effort, settings, kept.bands, kept.template, True, scheduler)
    return stopped(concluded(robot, meta, found, kept.nominal, settings, kept.bands, kept.template, sums, tally), stops, tell)


def _joined(old: Meta, paths: Sequence[str | Path]) -> Meta:
    """What is known of old and new recordings together."""
    new = common_meta(paths)
    seen = {sha256: name for name, sha256 in old.sources}
    for name, sha256 in new.sources:
        if sha256 in seen:
            raise RecordingError(
                f"{name} (SHA-256 {sha256[:16]}...) is part of this model already, as {seen[sha256]}; expected new recordings: "
                "leave it out"
            )
        seen[sha256] = name
    if new.effort != old.effort:
        raise RecordingError(
            f"the new recordings hold {new.effort}, the model was identified from {old.effort}; give the same kind of torque"
        )
    return replace(old, sources=old.sources + new.sources, warnings=old.warnings + new.warnings)


def _check_phases(phases: Counter[str], tally: Tally, kept: Kept) -> None:
    best = next((p for p in POWERED if phases[p]), None)
    if best is not None and POWERED.index(best) < POWERED.index(tally.phase):
        raise RecordingError(
            f"the new recordings hold {best} trials, the model's sets rest on {tally.phase} ones; identify again from all recordings"
        )
    if len(tally.steps) > len(kept.tally.steps) or any(phases[p] for p in STOPS):
        return
    raise RecordingError(
        f"the new recordings hold only {', '.join(sorted(phases))} trials and none of three samples that the model rests on; "
        f"expected {tally.phase} trials or stops: record some"
    )


def _numbers(kept: Kept, found: Survey) -> dict[int, int]:
    """Old number of each motion -> new one; a new recording may show two old motions to be one."""
    out: dict[int, int] = {}
    for suite, number in kept.motion.items():
        if out.setdefault(number, found.motion[suite]) != found.motion[suite]:
            raise ModelFileError(
                f"motion {number} of the kept state falls apart ({suite[0]} suite {suite[1]}); expected motions to be told apart as "
                "before: identify again from all recordings"
            )
    return out


def _revised(old: Model, fresh: Model, added: str, note: str) -> Model:
    """``fresh`` as the next revision of ``old``, with what no recording tells anything about."""
    number = old.revisions[-1].number + 1 if old.revisions else 1
    before = dict(old.revisions[-1].after) if old.revisions else {}
    revision = Revision(number, added, before, dict(fresh.revisions[-1].after), note.removeprefix(UPDATED))
    return replace(
        fresh, domain=replace(fresh.domain, payload=old.domain.payload), provenance={**old.provenance, **fresh.provenance},
        revisions=(*old.revisions, revision), notes=(*fresh.notes, note),
    )  # fmt: skip
