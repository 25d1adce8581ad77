"""Whether what looks like an elastic gear is rather a structure that gives: a pedestal that rocks, a link that bends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.columns.structure import Giving, places
from stopset.offline.diagnose.evidence.candidate import Candidate
from stopset.offline.diagnose.evidence.hypothesis import Hyper, Hypothesis
from stopset.offline.diagnose.evidence.scores import score_new, scores
from stopset.types import Array

RATES = (6.0, 9.0, 13.0, 19.0, 27.0, 38.0, 53.0, 70.0)  # [rad/s] at which it may swing, to begin with
FINER = (1.15, 1.0 / 1.15, 1.07, 1.0 / 1.07)  # times the best of them
LIGHTLY = 0.1  # damping of the search, of the root of stiffness times inertia


def may_sit_at(now: Hypothesis, gear: Candidate, says: float, hyper: Hyper) -> tuple[str, ...]:
    """Where a structure may give that explains more than the claimed ``gear`` by a claim's evidence, likeliest first.

    ``now``: the model without it; ``says``: the evidence that the gear adds to that.  A structure is asked at all joints with the swing that its
    description alone gives.  A gear so, too, at its own; as claimed it shakes the joints beside it.
    """
    (j,) = gear.joints
    M, K = float(np.median(now.engine.source.mass[:, j, j])), gear.shapes["K"]
    damped = (gear.shapes["D"], LIGHTLY * float(np.sqrt(K * M)))
    own = [score_new(now, gear.effect, (j,), {"K": K * x, "D": D}, hyper, quick=True) for x in (1.0, *FINER) for D in damped]
    best = max(says, *(s.score for s in own if s is not None))
    found = dict[str, float]()
    for place in places(now.engine.robot):
        giving = Giving.of(now.engine.source, place)
        if giving.inertia > 0.0:
            found[place.where] = max(found.get(place.where, -np.inf), _score(now, gear, giving, hyper))
    return tuple(w for w in sorted(found, key=lambda w: -found[w]) if found[w] > best + limit.THRESHOLD)


def _score(now: Hypothesis, gear: Candidate, giving: Giving, hyper: Hyper) -> float:
    """Of a structure at this place, with the stiffness of most evidence."""
    M = giving.inertia

    def value(w: float) -> float:
        return _of(now, gear, giving.columns(w * w * M, LIGHTLY * w * M), hyper)

    rates = {w: value(w) for w in RATES}
    top = max(rates, key=lambda w: rates[w])
    return max(rates[top], *(value(top * x) for x in FINER))


def _of(now: Hypothesis, gear: Candidate, moving: Array, hyper: Hyper) -> float:
    """Score of a swing with these rows (N, n) at all joints, priced and sized as the gear's."""
    view, rows = now.view(), now.engine.rows
    own = view.engine
    cols = np.array([own.size])
    grams = [
        g.bordered(r.column(moving[:, j, None]), cols, rows=False) for j, (g, r) in enumerate(zip(own.grams, rows, strict=True))
    ]
    candidate = Candidate(gear.effect, (), gear.shapes, cols, gear.sd)
    wider = replace(view, engine=replace(own, grams=grams, size=own.size + 1))
    return scores(wider, [candidate], hyper, quick=True)[0].score
