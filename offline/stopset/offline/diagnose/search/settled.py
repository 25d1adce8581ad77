"""A contender with the whole model refitted beside it, and how two of them are related."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stopset.effects import catalogue
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.evidence.candidate import Candidate, Scored, has_room
from stopset.offline.diagnose.evidence.evidence import Projection
from stopset.offline.diagnose.evidence.forms import has_no_zero, with_forms
from stopset.offline.diagnose.evidence.hypothesis import Hyper, Hypothesis
from stopset.offline.diagnose.evidence.uncertainty import deviations
from stopset.offline.diagnose.search.refine import sharpened
from stopset.offline.diagnose.side_by_side import side_by_side
from stopset.types import Array

PARTS = 10  # of the recorded rows, by position


@dataclass(frozen=True, slots=True)
class Settled:
    """A contender with the whole model refitted: its ``evidence``; what its own form takes up beyond that; and what evidence it would
    have if its form were off by `SAME_LAW` just as it is best, for nothing."""

    scored: Scored
    now: Hypothesis  # its last effect is the contender
    hyper: Hyper
    fit: Projection
    evidence: float
    taken_up: float
    mended: float

    @property
    def candidate(self) -> Candidate:
        return self.now.active[-1]

    @property
    def possible(self) -> bool:
        """Whether its numbers are what they can be, with the whole model refitted beside it; a swing is made exact later."""
        c = self.candidate
        return c.effect.role == "swing" or replace(self.scored, candidate=c, theta=self.theta).admissible

    @property
    def weighed(self) -> bool:
        """Whether the rows give some number of it a size; a swing is made exact later."""
        c = self.candidate
        if c.effect.role == "swing":
            return True
        (std,) = deviations(self.now, self.hyper, self.fit.theta, [c])
        return any(abs(v) > limit.SURE * std[t.symbol] for t, v in zip(c.effect.terms, self.theta, strict=True))

    @property
    def theta(self) -> Array:
        """Its terms, of the fit."""
        place = {column: k for k, column in enumerate(self.now.nuisance.tolist())}
        return self.fit.theta[[place[k] for k in self.candidate.cols.tolist()]]

    @property
    def inside(self) -> bool:
        """Whether no number of it stands at an end of its range."""
        c = self.candidate
        free = limit.EDGE * c.sd
        terms = all(t.lo + x < v < t.hi - x for t, v, x in zip(c.effect.terms, self.theta, free, strict=True))
        shapes = ((p, c.shapes[p.symbol]) for p in c.effect.shapes)
        return terms and all(p.lo * (1 + limit.EDGE) < v < p.hi * (1 - limit.EDGE) for p, v in shapes)

    @property
    def pulls(self) -> bool:
        """Whether its torque grows with its joint's position all over the recorded range, as that of all that pulls towards one does."""
        engine, c = self.now.engine, self.candidate
        (j,) = c.joints
        rows = engine.rows[j].take
        q = engine.data.q[rows, j]
        torque = (engine.columns(c.effect, c.joints, c.shapes)[j][0] @ self.theta)[rows]
        order = np.argsort(q)
        parts = [x.mean() for x in np.array_split(torque[order], PARTS)]
        return bool(np.all(np.diff(parts) >= 0.0))


def refitted(now: Hypothesis, s: Scored, hyper: Hyper) -> Settled:
    """A contender with the whole model refitted."""
    return all_refitted(now, [s], hyper)[0]


def all_refitted(now: Hypothesis, those: Sequence[Scored], hyper: Hyper) -> list[Settled]:
    """Each of ``those`` by itself."""
    candidates = side_by_side(lambda s: sharpened(now, s, hyper), those)
    columns = [added(now, c) for c in candidates]  # one after the other: each is numbered
    return side_by_side(lambda x: _settled(now, *x, hyper), list(zip(those, columns, strict=True)))


def _settled(now: Hypothesis, s: Scored, c: Candidate, hyper: Hyper) -> Settled:
    with_it = now.plus(_roomy(now, c, hyper))
    h, p = with_it.fit(hyper)
    loose = with_forms(with_it, with_it.active[-1:], p.theta)
    evidence = with_it.evidence(h)
    taken_up = max(loose.evidence(loose.fit(h)[0]) - evidence, 0.0)
    if has_no_zero(now.engine, with_it.active[-1]):
        loose = with_forms(with_it, with_it.active[-1:], p.theta, varying=True)
    off, q = loose.refit(replace(h, forms=(limit.SAME_LAW,)))
    as_it_is = replace(off, forms=())
    mended = with_it.evidence(as_it_is) + with_it.view().project(as_it_is)[0].rss - q.rss
    return Settled(s, with_it, h, p, evidence, taken_up, mended)


def added(now: Hypothesis, candidate: Candidate) -> Candidate:
    """A candidate with columns of its own in the engine."""
    c = now.engine.add(candidate.effect, candidate.joints, candidate.shapes)
    assert c is not None
    return c


def _roomy(now: Hypothesis, c: Candidate, hyper: Hyper) -> Candidate:
    """A law that has room, or whose finer forms have, with its prior as wide as evidence wants it.

    The usual one draws a heavy load towards none at all; and of several forms of a law none is likelier for having more room than another.
    """
    if not c.roomy and not any(c.effect.name in e.refines and has_room(e) for e in catalogue().values()):
        return c
    wide = [replace(c, sd=size * c.sd) for size in limit.SIZES if size >= 1.0]
    return max(wide, key=lambda x: now.plus(x).evidence(hyper))


def refines(finer: Candidate, plainer: Candidate) -> bool:
    """Whether one law is a finer form of the other one, at the same joints."""
    return finer.joints == plainer.joints and plainer.effect.name in finer.effect.refines
