"""Which of several contenders is claimed: the likeliest, unless a simpler law says as much."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from stopset.effects import get
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.evidence.candidate import Candidate, Scored
from stopset.offline.diagnose.evidence.evidence import Projection
from stopset.offline.diagnose.evidence.forms import with_forms
from stopset.offline.diagnose.evidence.hypothesis import Hyper, Hypothesis
from stopset.offline.diagnose.evidence.scores import score_new
from stopset.offline.diagnose.search.refine import refine, sharpened


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
        place = {column: k for k, column in enumerate(self.now.nuisance.tolist())}
        theta = self.fit.theta[[place[k] for k in c.cols.tolist()]]
        return c.effect.role == "swing" or replace(self.scored, candidate=c, theta=theta).admissible


def settle(now: Hypothesis, best: Sequence[Scored], hyper: Hyper) -> tuple[Settled, tuple[Scored, ...]]:
    """Of contenders, ``best`` first, the one to claim, and its rivals.

    Whoever's score lacks more than a claim's evidence, and at the best one's joints what its form takes up, is out of the question.
    The likeliest is claimed; but of laws that look alike at its joints the simplest that leaves as little, but for a claim's evidence,
    when it may be off by `SAME_LAW`: a finer law must say more than that the plainer one is not quite true.  One that explains the rows
    with numbers that it cannot have, as a spring that pushes, gives way to the likeliest that need not, but to no finer form of itself.
    """
    first = _refitted(now, best[0], hyper)
    lacks = [first.taken_up * _touch(s.candidate, first.candidate) + limit.THRESHOLD for s in best]
    near = [s for s, lack in zip(best[1:], lacks[1:], strict=True) if s.score > best[0].score - lack]
    settled = [first, *(_refitted(now, s, hyper) for s in near)]
    likeliest = max(settled, key=lambda x: x.evidence)
    asked = {x.candidate.key for x in settled}
    plainer = _plainer(now, likeliest, hyper)
    settled += [x for x in plainer if x.candidate.key not in asked and not said_already(now.active, x.candidate)]
    alike = [x for x in settled if _simplifies(x.candidate, likeliest.candidate)]
    enough = [x for x in alike if x.mended > likeliest.evidence - limit.THRESHOLD]
    top = min(enough, key=lambda x: (_size(x.candidate), -x.mended), default=likeliest)
    if not top.possible:
        sound = (x for x in settled if x.possible and not refines(x.candidate, top.candidate))
        top = max(sound, key=lambda x: x.evidence, default=top)
    return top, tuple(s for s in (best[0], *near) if s.candidate.key != top.candidate.key)


def said_already(active: Sequence[Candidate], c: Candidate) -> bool:
    """Whether a law that is ``active`` at the same joints says what ``c`` would: the same one, or another form of the same plainer law.

    What the form of a balancing spring leaves looks like a spring, and is no second one; a finer form may still replace a plainer one.
    """

    def forms(x: Candidate) -> set[str]:
        return {x.effect.name, *x.effect.refines}

    return any(a.joints == c.joints and not refines(c, a) and bool(forms(a) & forms(c)) for a in active)


def refines(finer: Candidate, plainer: Candidate) -> bool:
    """Whether one law is a finer form of the other one, at the same joints."""
    return finer.joints == plainer.joints and plainer.effect.name in finer.effect.refines


def instead(now: Hypothesis, plainer: Candidate, top: Settled, hyper: Hyper) -> Settled:
    """The finer law of ``top`` in the place of a plainer one that was claimed: there is one spring, not two."""
    base = now.without(plainer.key)
    h, _ = base.fit(hyper)
    return _refitted(base, refine(base, top.scored, h), h)


def added(now: Hypothesis, candidate: Candidate) -> Candidate:
    """A candidate with columns of its own in the engine."""
    c = now.engine.add(candidate.effect, candidate.joints, candidate.shapes)
    assert c is not None
    return c


def _roomy(now: Hypothesis, c: Candidate, hyper: Hyper) -> Candidate:
    """A law of many terms with its prior as wide as evidence wants it: the usual one draws a heavy load towards none at all."""
    if len(c.effect.terms) < limit.MANY:
        return c
    wide = [replace(c, sd=size * c.sd) for size in limit.SIZES if size >= 1.0]
    return max(wide, key=lambda x: now.plus(x).evidence(hyper))


def _refitted(now: Hypothesis, s: Scored, hyper: Hyper) -> Settled:
    with_it = now.plus(_roomy(now, added(now, sharpened(now, s, hyper)), hyper))
    h, p = with_it.fit(hyper)
    loose = with_forms(with_it, with_it.active[-1:], p.theta)
    evidence = with_it.evidence(h)
    taken_up = max(loose.evidence(loose.fit(h)[0]) - evidence, 0.0)
    off, q = loose.refit(replace(h, forms=(limit.SAME_LAW,)))
    as_it_is = replace(off, forms=())
    mended = with_it.evidence(as_it_is) + with_it.view().project(as_it_is)[0].rss - q.rss
    return Settled(s, with_it, h, p, evidence, taken_up, mended)


def _plainer(now: Hypothesis, best: Settled, hyper: Hyper) -> list[Settled]:
    """Laws without shapes that look like the one of ``best``, have fewer parameters and could be claimed themselves, at its joints."""
    c = best.candidate
    alike = map(get, dict.fromkeys((*c.effect.refines, *c.effect.looks_like)))
    laws = [e for e in alike if e.scope == c.effect.scope and not (e.shapes or e.base) and len(e.terms) < _size(c)]
    scored = (score_new(now, e, c.joints, {}, hyper) for e in laws if e.enters == c.effect.enters)
    sound = [s for s in scored if s is not None and s.admissible and s.score >= limit.THRESHOLD]
    return [_refitted(now, replace(s, score=min(s.score, best.scored.score)), hyper) for s in sound]


def _touch(a: Candidate, b: Candidate) -> bool:
    """Whether two effects act at one joint."""
    return not a.joints or not b.joints or bool(set(a.joints) & set(b.joints))


def _simplifies(a: Candidate, b: Candidate) -> bool:
    """Whether ``a`` says with fewer parameters what looks like ``b`` at the same joints, or is a plainer form of it."""
    alike = a.effect.name in (*b.effect.looks_like, *b.effect.refines)
    return a.joints == b.joints and alike and _size(a) < _size(b)


def _size(c: Candidate) -> int:
    """Parameters of a candidate's law."""
    return len(c.effect.terms) + len(c.effect.shapes)
