"""The score of every candidate against the current model: twice the log Bayes factor, each at its own best hyperparameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from stopset.effects import Effect
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.evidence.candidate import Alike, Candidate, Scored, gain_within
from stopset.offline.diagnose.evidence.evidence import Projection, project
from stopset.offline.diagnose.evidence.hypothesis import Hyper, Hypothesis
from stopset.types import Array, Index


class _Best:
    """The best score of every candidate so far, over hyperparameters; ``rest`` are the columns of a projection."""

    def __init__(self, candidates: Sequence[Candidate]) -> None:
        self.candidates = candidates
        self.scored: dict[int, Scored] = {}
        self.groups: dict[tuple[int, ...], tuple[list[Alike], list[int]]] = {}

    def consider(self, p: Projection, rest: Index, bonus: float, which: Sequence[int]) -> None:
        """Candidates ``which`` by a projection's columns ``rest``, in order."""
        asked = tuple(which)
        if asked not in self.groups:
            self.groups[asked] = Alike.of(self.candidates, asked)
        alike, own = self.groups[asked]
        for k in own:
            ix = np.searchsorted(rest, self.candidates[k].cols)
            self._put(k, bonus, *gain_within(p.S[ix[:, None], ix], p.s[ix], self.candidates[k]))
        for group in alike:
            at = np.searchsorted(rest, group.cols)
            for found in zip(group.which, *group.gains(p.S[at[:, :, None], at[:, None, :]], p.s[at]), strict=True):
                self._put(found[0], bonus, *found[1:])

    def _put(self, k: int, bonus: float, value: float, theta: Array, cov: Array) -> None:
        c = self.candidates[k]
        score = float(value) + (bonus - c.charge)
        if k not in self.scored or score > self.scored[k].score:
            self.scored[k] = Scored(c, score, theta, cov)

    def ranked(self) -> list[Scored]:
        return sorted((self.scored[k] for k in sorted(self.scored)), key=lambda r: -r.score)


def scores(now: Hypothesis, candidates: Sequence[Candidate], hyper: Hyper, *, quick: bool = False) -> list[Scored]:
    """Every candidate against the hypothesis ``now``, best first, each with its own best hyperparameters.

    ``quick``: at the hyperparameters given, for comparing shapes of one effect.
    """
    if not candidates:
        return []
    everyone = range(len(candidates))
    best, nuisance = _Best(candidates), now.nuisance
    rest = np.unique(np.concatenate([c.cols for c in candidates]))
    G, logdet = now.total(hyper)
    p = project(G, 0, nuisance, rest, now.precision(hyper), now.mean)
    reference = now.criterion(p, hyper, logdet)
    best.consider(p, rest, 0.0, everyone)
    if quick:
        return best.ranked()
    for other in now.descriptions(hyper):
        p = project(G, 0, nuisance, rest, now.precision(other), now.mean)
        best.consider(p, rest, now.criterion(p, other, logdet) - reference, everyone)
    for j in range(now.engine.data.n):
        touching = [k for k in everyone if j in candidates[k].joints]
        if touching:
            _other_scatter(now, j, touching, hyper, (G, logdet, reference), best)
    return best.ranked()


def _other_scatter(
    now: Hypothesis, joint: int, touching: Sequence[int], hyper: Hyper, base: tuple[Array, float, float], best: _Best
) -> None:
    """The candidates ``touching`` a joint, tried with every smaller scatter of its friction; only their columns are needed."""
    G, logdet, reference = base
    nuisance = now.nuisance
    rest = np.unique(np.concatenate([best.candidates[k].cols for k in touching]))
    wanted = np.concatenate([[0], nuisance, rest]).astype(np.intp)
    number = np.full(now.engine.size, -1)
    number[wanted] = np.arange(len(wanted))
    gram = now.engine.grams[joint].keep(np.flatnonzero(number[now.engine.grams[joint].index] >= 0), rows=False)
    at = number[gram.index][:, None], number[gram.index]
    few = G[wanted[:, None], wanted]
    here, ld = gram.at(hyper.sigma[joint], hyper.kappa[joint])
    for s in (s for s in limit.SCATTERS if s < hyper.sigma[joint]):
        there, ld2 = gram.at(s, hyper.kappa[joint])
        changed = few.copy()
        changed[at] += there - here
        p = project(changed, 0, number[nuisance], number[rest], now.precision(hyper), now.mean)
        best.consider(p, rest, now.criterion(p, hyper, logdet + ld2 - ld) - reference, touching)


def score_new(
    now: Hypothesis, effect: Effect, joints: tuple[int, ...], shapes: Mapping[str, float], hyper: Hyper, *, quick: bool = False
) -> Scored | None:
    """Score of an effect with new shapes beside ``now``, without keeping its columns in the engine."""
    made = now.engine.make_again(effect, joints, shapes)
    if made is None:
        return None
    candidate, parts = made
    view = now.view()
    own = view.engine
    candidate = replace(candidate, cols=np.arange(own.size, own.size + len(candidate.cols)))
    grams = [g.bordered(parts[i], candidate.cols, rows=False) if i in parts else g for i, g in enumerate(own.grams)]
    wider = replace(own, grams=grams, size=own.size + len(candidate.cols))
    return scores(replace(view, engine=wider), [candidate], hyper, quick=quick)[0]
