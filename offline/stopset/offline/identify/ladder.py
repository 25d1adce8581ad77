"""The next abstraction: gone to where the sets of the first say too little, or enclose nothing, and explained.

A richer abstraction can only take away what the simpler one lacks beside the full rigid body.  So each rung is asked first what torque
it would still lack over a stop's length, which takes no sets; only one that lacks clearly less is identified.

Source: Liu & Althoff (2018), sec. IV-B, models 1 to 3.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from stopset.errors import NotConformant, StopsetError
from stopset.offline.abstraction.identified import LADDER, WORTH
from stopset.offline.abstraction.nominal_part import NominalPart
from stopset.offline.abstraction.swift import lacking
from stopset.offline.campaign.settings import Settings
from stopset.offline.campaign.survey import Survey
from stopset.offline.conform.tightness import JUDGED, LIMIT, WIDE
from stopset.offline.identify.model_file import Identification
from stopset.progress import Progress

Abstracted = Callable[[Settings], NominalPart]
WithSets = Callable[[Settings, NominalPart], Identification]


def rungs(settings: Settings) -> Iterator[Settings]:
    """What comes after the linear model: the paper's models 2 and 3, as far as their order can be built in seconds."""
    for kind, order in LADDER:
        yield replace(settings, model=kind, order=order, ladder=False)


def too_wide(found: Identification) -> str:
    """Why the sets say too little, in words; empty where they do not."""
    ratio, n = found.tightness.by_joint[JUDGED], found.tightness.half.shape[1] // 2
    if found.tightness.median > WIDE:
        return f"after 0.1 s its tube is {found.tightness.median:.1f} times what was seen, in the median"
    if np.any(ratio > LIMIT):
        joint = found.model.joints[int(np.nanargmax(ratio))]
        return f"after 0.1 s its tube at {joint} is {np.nanmax(ratio):.1f} times what was seen"
    if found.absurd:
        return f"its sets are absurd at {len(found.absurd)} of {n} joints"
    return ""


def climbed(
    first: Callable[[], Identification], start: NominalPart, learnt: Survey, settings: Settings, effort: str,
    steps: tuple[Abstracted, WithSets], progress: Progress,
) -> Identification:  # fmt: skip
    """The first abstraction's identification, or that of a richer one that is clearly tighter, with what was tried in its notes."""
    abstracted, with_sets = steps
    failed: NotConformant | None = None
    best: Identification | None = None
    try:
        best = first()
        why = too_wide(best)
        if not why:
            return best
    except NotConformant as e:
        failed, why = e, "it cannot enclose the recordings"
    progress(f"model 1: {why}; trying the next abstraction")
    before, tried = lacking(start, learnt, effort), list[str]()
    for rung in rungs(settings):
        name = f"model {rung.model} of order {rung.order}"
        try:
            nominal = abstracted(rung)
            share = _lower(before, lacking(nominal, learnt, effort))
            if share < WORTH:
                tried.append(f"{name} would lack {_words(share)} torque over a stop's length")
                continue
            found = with_sets(rung, nominal)
        except StopsetError as e:
            tried.append(f"{name}: {e}")
            continue
        narrower = 1.0 if best is None else _lower(best.tightness.half[JUDGED], found.tightness.half[JUDGED])
        if narrower >= WORTH:
            said = "encloses them" if best is None else f"has tubes {narrower:.0%} narrower after 0.1 s"
            tried.append(f"{name} {said} and was taken")
            return _with_notes(found, why, tried)
        tried.append(f"{name} lacks {share:.0%} less torque, but its tubes after 0.1 s are {_narrow(narrower)}")
    if best is None:
        assert failed is not None
        raise NotConformant("; ".join([str(failed), *tried])) from failed
    return _with_notes(best, why, [*tried, "the linear model stays: what is left is no matter of its abstraction"])


def _lower(before: np.ndarray, after: np.ndarray) -> float:
    """Share by which ``after`` is smaller, in the geometric mean; 0 where it is not known."""
    known = np.isfinite(before) & np.isfinite(after) & (before > 0) & (after > 0)
    return float(1.0 - np.exp(np.mean(np.log(after[known] / before[known])))) if known.any() else 0.0


def _words(share: float) -> str:
    """How much less, beside the linear model."""
    if abs(share) < 0.005:
        return "no less"
    return f"only {share:.0%} less" if share > 0 else f"{-share:.0%} more"


def _narrow(share: float) -> str:
    return f"only {share:.0%} narrower" if share > 0 else f"{-share:.0%} wider"


def _with_notes(found: Identification, why: str, tried: Sequence[str]) -> Identification:
    note = f"next abstraction: {why} with the linear model; {'; '.join(tried)}"
    model = replace(found.model, notes=(*found.model.notes, note))
    return replace(found, model=model)
