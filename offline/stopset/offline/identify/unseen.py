"""What the rest of a motion asks of sets that were found on a part of it, where motions are few and nothing is repeated.

The trials are cut into blocks of time.  Stretches of neighbouring blocks are left out in turn, of the nominal model and of the sets alike,
with a guard interval, and every block left out says by which factor the sets would have had to be larger: model error outside of
the fit, and extremes that a short recording has not seen yet.  Another block is foretold by Student's t of the factors' logarithms,
whose scatter a few blocks know badly: a usual one counts beside theirs.  Blocks of one motion say nothing of other motions.

Source: Smyth (2004), Linear models and empirical Bayes methods, for the usual scatter beside a seen one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import t as student

from stopset.effects.base import Fitted
from stopset.errors import NotConformant, RecordingError
from stopset.offline.abstraction.swift import swift
from stopset.offline.campaign.hold_out import GUARD, blocks
from stopset.offline.campaign.run import Run
from stopset.offline.conform.envelope import Deviations, Envelope
from stopset.offline.conform.gather import set_problem
from stopset.offline.conform.guarantee import reached, union
from stopset.offline.conform.linear_program import fit_sets
from stopset.offline.nominal.model import NominalPart, pairs_of, refitted
from stopset.progress import Tell
from stopset.recording import Recording
from stopset.types import Array

STRETCHES = 4  # left out in turn
RISK = 0.1  # that another block leaves the sets
USUAL = 0.3  # scatter of the logarithm of what a block reaches of its tube, as it is on real arms
NOTHING = 0.1  # of a tube: a block in which the arm rests reaches hardly any
FREEDOM = 4.0  # blocks that it counts for beside those seen


@dataclass(frozen=True, slots=True)
class _Stretch:
    """Blocks that are left out together, and the pieces of the trials that are left."""

    out: tuple[Recording, ...]
    rest: tuple[Recording, ...]


def unseen(run: Run, nominal: NominalPart, known: tuple[Fitted, ...], tell: Tell) -> tuple[float | None, str]:
    """Factor by which sets must be larger than what they were found on, and a note of how it came about.

    None where the recording is too short to leave anything out.
    """
    reach: list[float] = []
    for k, s in enumerate(parts := stretches(run)):
        tell(f"leaving out stretch {k + 1} of {len(parts)}")
        try:
            reach += _reached(run, nominal, known, s)
        except (NotConformant, RecordingError):
            continue  # what is left shows too little of the arm
    if len(reach) < 2:
        return None, ""
    factor = foretold(np.array(reach))
    return factor, (
        f"margin {factor:.2f} from {len(reach)} blocks of time that were left out in turn of fit and sets and asked for {max(reach):.2f} at "
        f"most: another such block of the same motion stays inside at {1 - RISK:.0%}, if it is as these were"
    )


def foretold(reach: Array) -> float:
    """The factor, at least 1 and what any block reached, that another block stays below; ``reach`` (blocks,)."""
    count, x = len(reach), np.log(np.maximum(reach, NOTHING))
    freedom = count - 1.0 + FREEDOM
    scatter = np.sqrt(((count - 1.0) * x.var(ddof=1) + FREEDOM * USUAL**2) / freedom)
    most = x.mean() + student.ppf(1.0 - RISK, freedom) * scatter * np.sqrt(1.0 + 1.0 / count)
    return float(max(1.0, reach.max(), np.exp(most)))


def stretches(run: Run) -> list[_Stretch]:
    """The trials of the surveyed phase in at most `STRETCHES` parts of as many neighbouring blocks, each left out once."""
    trials = [r for r in run.trials() if r.phase == run.survey.phase]
    cut = [(k, b) for k, r in enumerate(trials) for b in blocks(r, 0.0)]
    parts = min(STRETCHES, len(cut))
    of = np.arange(len(cut)) * parts // max(len(cut), 1)
    if parts < 2:
        return []
    return [
        _Stretch(
            tuple(b for (_, b), p in zip(cut, of, strict=True) if p == part),
            tuple(x for k, r in enumerate(trials) for x in _rest(r, [b for (i, b), p in zip(cut, of, strict=True) if i == k and p == part])),
        )
        for part in range(parts)
    ]


def _rest(r: Recording, out: Sequence[Recording]) -> Iterator[Recording]:
    """What is left of a trial without neighbouring blocks ``out`` of it and a guard to both sides."""
    if not out:
        yield r
        return
    before, after = np.searchsorted(r.t, [out[0].t[0] - GUARD, out[-1].t[-1] + GUARD])
    yield from (x for x in (r.cut(0, int(before)), r.cut(int(after), len(r.t))) if len(x.t) >= 3)


def _reached(run: Run, nominal: NominalPart, known: tuple[Fitted, ...], s: _Stretch) -> list[float]:
    """What each block left out reaches of the sets found on the rest."""
    found = replace(run.survey, sample=s.rest)
    others = tuple(r for r in run.trials() if r.phase != found.phase)
    fitted = refitted(run.robot, run.meta, lambda: (*others, *s.rest), found, run.settings, known, nominal)
    fitted = swift(fitted, found, run.meta.effort)
    problem = set_problem(run, fitted.abstraction)
    deviations, R = Deviations(problem.abstraction, problem.dt, problem.steps, problem.options.windows), problem.responses()

    def envelopes(pieces: Sequence[Recording]) -> list[Envelope]:
        return [deviations.of(r, u) for _, r, u in pairs_of(lambda: pieces, found, fitted, run.meta.effort)()]

    together = union(envelopes(s.rest))
    whole = problem.asking("all")
    fit = fit_sets(together, R, whole)
    if problem.options.conform == "position":
        fit = fit_sets(together, R, problem.reading(fit.V))
    return [float(reached(fit, R, env).max()) for env in envelopes(s.out)]
