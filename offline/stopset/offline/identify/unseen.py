"""What the rest of a motion asks of sets that were found on a part of it, where motions are few and nothing is repeated.

The trials are cut into blocks of time.  Stretches of neighbouring blocks are left out in turn, of the nominal model and of the sets alike,
with a guard interval, and every block left out says by which factor the sets would have had to be larger: model error outside of
the fit, and extremes that a short recording has not seen yet.  Another block, if it is as these were, asks for no more than their quantile;
where there are too few for one, it is Student's t of the factors' logarithms that predicts it, with a usual scatter beside
the seen one, which a few blocks know badly.  Blocks of one motion say nothing of other motions.

Source: Barber, Candes, Ramdas & Tibshirani (2021), Predictive inference with the jackknife+; Smyth (2004), Linear models and empirical
Bayes methods, for the usual scatter beside a seen one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.special import stdtrit

from stopset.effects.base import Fitted
from stopset.errors import NotConformant, RecordingError
from stopset.offline.abstraction.nominal_part import NominalPart, pairs_of, refitted
from stopset.offline.abstraction.swift import swift
from stopset.offline.campaign.hold_out import BLOCK, GUARD
from stopset.offline.campaign.run import Run
from stopset.offline.conform.envelope import Deviations, Envelope
from stopset.offline.conform.gather import set_problem
from stopset.offline.conform.guarantee import reached, union
from stopset.offline.conform.linear_program import fit_sets
from stopset.progress import Progress
from stopset.recording import Recording
from stopset.types import Array

STRETCHES = 4  # left out in turn
FEWEST = 8  # blocks: those of a short recording are shorter
SHORTEST = 0.5  # [s] of a block: in less a prediction hardly leaves the reading it begins with
RISK = 0.1  # that another block leaves the sets
USUAL = 0.3  # scatter of the logarithm of what a block reaches of its tube, as it is on real arms
NOTHING = 0.1  # of a tube: a block in which the arm rests reaches hardly any
FREEDOM = 4.0  # blocks that it counts for beside those seen


@dataclass(frozen=True, slots=True)
class _Stretch:
    """Blocks that are left out together, and the pieces of the trials that are left."""

    out: tuple[Recording, ...]
    rest: tuple[Recording, ...]


def unseen(run: Run, nominal: NominalPart, known: tuple[Fitted, ...], progress: Progress) -> tuple[float | None, str]:
    """Factor by which sets must be larger than what they were found on, and a note of how it came about.

    None where the recording is too short to leave anything out.
    """
    reach: list[float] = []
    for k, s in enumerate(parts := stretches(run)):
        progress(f"leaving out part {k + 1} of {len(parts)}, to see what it asks of the sets")
        try:
            reach += _reached(run, nominal, known, s)
        except (NotConformant, RecordingError):
            continue  # what is left shows too little of the arm
    if len(reach) < FEWEST // 2:
        return None, ""
    factor = factor_expected(np.array(reach))
    long = float(np.median([b.t[-1] - b.t[0] for s in parts for b in s.out]))
    return factor, (
        f"margin {factor:.2f} from {len(reach)} blocks of {long:.1f} s that were left out in turn of fit and sets and asked for {max(reach):.2f} "
        f"at most: another such block of the same motion stays inside with {1 - RISK:.0%}, if it is as these were; of other motions "
        "this says nothing"
    )


def factor_expected(reach: Array) -> float:
    """The factor, at least 1, that another block stays below with a probability of `RISK` to be wrong; ``reach`` (blocks,)."""
    count, x = len(reach), np.log(np.maximum(reach, NOTHING))
    rank = int(np.ceil((count + 1) * (1.0 - RISK)))
    if rank <= count:
        return float(max(1.0, np.sort(reach)[rank - 1]))
    freedom = count - 1.0 + FREEDOM
    scatter = np.sqrt(((count - 1.0) * x.var(ddof=1) + FREEDOM * USUAL**2) / freedom)
    most = x.mean() + stdtrit(freedom, 1.0 - RISK) * scatter * np.sqrt(1.0 + 1.0 / count)
    return float(max(1.0, reach.max(), np.exp(most)))


def stretches(run: Run) -> list[_Stretch]:
    """The trials of the surveyed phase in `STRETCHES` parts of as many neighbouring blocks, each left out once; none if they are short."""
    trials = [r for r in run.trials() if r.phase == run.survey.phase and len(r.t) > 1]
    seconds = np.array([float(r.t[-1] - r.t[0]) for r in trials])
    length = min(BLOCK, float(seconds.sum()) / FEWEST)
    if length < SHORTEST:
        return []
    cut = [(k, b) for k, r in enumerate(trials) for b in _blocks(r, max(1, round(seconds[k] / length)))]
    of = [at * STRETCHES // len(cut) for at in range(len(cut))]
    out = []
    for part in range(STRETCHES):
        mine = {k: [b for (i, b), p in zip(cut, of, strict=True) if (i, p) == (k, part)] for k in range(len(trials))}
        rest = tuple(x for k, r in enumerate(trials) for x in _rest(r, mine[k]))
        out.append(_Stretch(tuple(b for some in mine.values() for b in some), rest))
    return out


def _blocks(r: Recording, count: int) -> list[Recording]:
    """A trial in ``count`` blocks of about as many samples."""
    return [
        r.cut(lo, hi) for lo, hi in pairwise(np.linspace(0, len(r.t), count + 1).round().astype(int).tolist()) if hi - lo >= 3
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
    fitted = refitted(replace(run, trials=lambda: (*others, *s.rest), survey=found), known, nominal)
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
