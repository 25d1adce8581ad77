"""Conditions of recordings (payload, tool, day, temperature): told by a column or a flag, never mixed without being told.

One model is one condition: a load that some recordings carry and others do not would end in the torque sets of all.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from stopset.errors import RecordingError
from stopset.offline.campaign.source import Campaign
from stopset.recording import Recording


def tagged(campaign: Campaign, flags: Sequence[str], paths: Sequence[str | Path]) -> Campaign:
    """``campaign`` of the files ``paths`` with the conditions of ``flags``: ``KEY=VALUE@FILE``, or ``KEY=VALUE`` for every file.

    Raises `RecordingError` for a flag of another form, or of a file that is not among them.
    """
    stated: dict[int, list[str]] = {}
    for flag in flags:
        text, _, name = flag.partition("@")
        key, equals, value = text.partition("=")
        if not (key and equals and value):
            raise RecordingError(
                f"--condition {flag}: expected KEY=VALUE@FILE (or KEY=VALUE for all files), e.g. payload=2.8@a.parquet"
            )
        which = [k for k, p in enumerate(paths) if not name or str(p) == name or Path(p).name == name]
        if not which:
            raise RecordingError(f"--condition {flag}: {name} is not among the recordings of --data; name one of them")
        for k in which:
            stated.setdefault(k, []).append(f"{key}={value}")
    if not stated:
        return campaign

    def trials() -> Iterator[Recording]:
        for r in campaign.trials():
            own = [r.condition] if r.condition else []
            yield replace(r, condition=", ".join([*own, *stated.get(r.file, [])]))

    return replace(campaign, trials=trials)


def one_condition(found: Iterable[str]) -> None:
    """Refuse recordings of several conditions. Raises `RecordingError`."""
    conditions = sorted(set(found))
    if len(conditions) > 1:
        said = "; ".join(c or "none stated" for c in conditions)
        raise RecordingError(
            f"recordings of {len(conditions)} conditions ({said}); expected one, for a model of several holds all their differences in "
            "its sets: identify them apart, or say --mixed to take them as one"
        )
