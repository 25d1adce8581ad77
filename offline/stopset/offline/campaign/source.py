"""What an identification reads: the trials of files, or those of a kept state with later files behind them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

from stopset.errors import RecordingError
from stopset.offline.campaign.survey import Survey, Tally, tallied
from stopset.offline.campaign.trials import ReadOnce, Source
from stopset.recording import Meta, Recording, read_meta, sources_of, stream_recordings
from stopset.robot import Robot


class Surveyed(NamedTuple):
    """What one pass over a campaign finds; the stops are short and needed whole."""

    tally: Tally
    stops: tuple[Recording, ...]
    survey: Survey


@dataclass(frozen=True, slots=True)
class Campaign:
    """Recordings of one arm: what is known of them together, and their trials, anew at every call."""

    meta: Meta
    trials: Source
    _seen: list[Surveyed] = field(default_factory=list, init=False, repr=False, compare=False)

    @property
    def seen(self) -> Surveyed:
        """What is found in the trials, looked for once; who adds to the tally adds to a copy.

        Raises `RecordingError` if no trial has powered motion.
        """
        if not self._seen:
            tally, stops = tallied(self.trials)
            self._seen.append(Surveyed(tally, tuple(stops), tally.survey()))
        return self._seen[0]


def campaign_of(robot: Robot, paths: Sequence[str | Path]) -> Campaign:
    """The recordings in ``paths``, in this order. Raises `RecordingError` if they hold different kinds of torque."""
    return Campaign(common_meta(paths), ReadOnce(lambda: stream_recordings(paths, robot)))


def continued(earlier: Campaign, robot: Robot, paths: Sequence[str | Path], places: int) -> Campaign:
    """``earlier``, which holds ``places`` trials, with the recordings in ``paths`` behind them, as if all had been read together.

    Raises `RecordingError` for recordings that are part of it already or hold another kind of torque.
    """

    def trials() -> Iterator[Recording]:
        yield from earlier.trials()
        yield from numbered_on(earlier.meta, robot, paths, places)

    return Campaign(joined(earlier.meta, paths), trials)


def numbered_on(earlier: Meta, robot: Robot, paths: Sequence[str | Path], places: int) -> Iterator[Recording]:
    """The trials in ``paths`` with the places and file numbers they have behind ``places`` trials of ``earlier`` files."""
    files = len(earlier.sources)
    for r in stream_recordings(paths, robot):
        yield replace(r, place=places + r.place, file=files + r.file)


def common_meta(paths: Sequence[str | Path]) -> Meta:
    metas = [read_meta(p) for p in paths]
    kinds = {m.effort for m in metas}
    if len(kinds) != 1:
        raise RecordingError(f"the recordings hold {' and '.join(sorted(kinds))}; one identification takes one kind of torque")
    return replace(metas[0], sources=sources_of(metas), warnings=tuple(w for m in metas for w in m.warnings))


def joined(old: Meta, paths: Sequence[str | Path]) -> Meta:
    """What is known of old and new recordings together."""
    new = common_meta(paths)
    seen = {sha256: name for name, sha256 in old.sources}
    for name, sha256 in new.sources:
        if sha256 in seen:
            raise RecordingError(
                f"{name} (SHA-256 {sha256[:16]}...) is part of this model already, as {seen[sha256]}; expected new recordings: "
                "leave it out"
            )
    if new.effort != old.effort:
        raise RecordingError(
            f"the new recordings hold {new.effort}, the model was identified from {old.effort}; give the same kind of torque"
        )
    return replace(old, sources=old.sources + new.sources, warnings=old.warnings + new.warnings)
