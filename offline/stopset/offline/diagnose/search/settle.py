"""Which of several contenders is claimed: the likeliest, unless a simpler law says as much."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stopset.effects import get
from stopset.effects.base import Shape
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.evidence.candidate import Candidate, Scored
from stopset.offline.diagnose.evidence.engine import Engine
from stopset.offline.diagnose.evidence.evidence import Projection
from stopset.offline.diagnose.evidence.forms import with_forms
from stopset.offline.diagnose.evidence.hypothesis import Hyper, Hypothesis
from stopset.offline.diagnose.evidence.scores import score_new
from stopset.offline.diagnose.search.refine import refine, sharpened
from stopset.types import Array

PARTS = 10  # of the recorded rows, by position
ALONG = 8  # values of a lever
CLIMB = 80  # columns tried on the path to one top
SEARCHES = 3  # of levers at the noise that is left, which then falls: they settle in two
FALLS = 2.0  # times, by which noise that falls tells other levers: by 689 and more where they were wrong, by 1.2 where nothing was gained


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


def settle(now: Hypothesis, best: Sequence[Scored], hyper: Hyper) -> tuple[Settled, tuple[Scored, ...]]:
    """Of contenders, ``best`` first, the one to claim, and its rivals.

    Whoever's score lacks more than a claim's evidence, and at the best one's joints what its form takes up, is out of the question.
    The likeliest is claimed; but of laws that look alike at its joints the simplest that leaves as little, but for a claim's evidence,
    when it may be off by `SAME_LAW`: a finer law must say more than that the plainer one is not quite true, as one with levers of its
    own does that is `_distinct`.  One that explains the rows with numbers that it cannot have, as a spring that
    pushes, gives way to the likeliest that need not, but to no finer form of itself.
    """
    first = _refitted(now, best[0], hyper)
    lacks = [first.taken_up * _touch(s.candidate, first.candidate) + limit.THRESHOLD for s in best]
    near = [s for s, lack in zip(best[1:], lacks[1:], strict=True) if s.score > best[0].score - lack]
    settled = [first, *(_refitted(now, s, hyper) for s in near)]
    settled = _geared(settled, now, hyper)
    likeliest = max(settled, key=lambda x: x.evidence)
    asked = {x.candidate.key for x in settled}
    plainer = _plainer(now, likeliest, hyper)
    settled += [x for x in plainer if x.candidate.key not in asked and not said_already(now.active, x.candidate)]
    distinct = [x for x in settled if x.evidence > likeliest.evidence - limit.THRESHOLD and _distinct(x, settled)]
    likeliest = max(distinct, key=lambda x: x.evidence, default=likeliest)
    alike = [x for x in settled if not distinct and _simplifies(x.candidate, likeliest.candidate)]
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


def _distinct(finer: Settled, settled: Sequence[Settled]) -> bool:
    """Whether a law with levers of its own is clearly likelier than all that it refines, whose forms pay for being off, and than their
    other forms; its levers pay for having been sought.

    A curve that bends as it likes takes up what any form leaves, and says only that a plainer law is not quite true; a place and levers
    say more.  A curve that pushes somewhere, or bends as its own law cannot, is none of a spring's forms.
    """
    c = finer.candidate
    if not (_geometric(c) and finer.possible and finer.inside):
        return False
    plainer = [x.evidence + x.taken_up for x in settled if refines(c, x.candidate) and x.possible]
    others = [x.evidence for x in settled if _other_form(c, x.candidate) and x.inside and x.pulls]
    return finer.evidence - limit.SWING_PRICE > max([*plainer, *others], default=-np.inf) + limit.THRESHOLD


def _other_form(a: Candidate, b: Candidate) -> bool:
    """Whether two laws refine the same plainer one, at the same joints."""
    return a.key != b.key and a.joints == b.joints and bool(set(a.effect.refines) & set(b.effect.refines))


def _sought_again(now: Hypothesis, x: Settled, hyper: Hyper) -> Settled:
    """A contender with levers of its own, which are sought again all over their ranges at the noise of ``hyper``.

    Where a large effect is not known yet all that is unexplained counts as noise, beside which one shape is as good as another.  Each top
    along the place is climbed: levers that stretch the other way have one of their own.
    """
    c = x.candidate
    first, *rest = c.effect.shapes
    along = []
    for place in first.grid:
        tried = (
            {first.symbol: place} | dict(zip([p.symbol for p in rest], v, strict=True))
            for v in itertools.product(*map(_starts, rest))
        )
        scored = [score_new(now, c.effect, c.joints, shapes, hyper, quick=True) for shapes in tried]
        along.append(max((s for s in scored if s is not None and s.admissible), key=lambda s: s.score, default=None))
    heights = np.array([-np.inf, *(-np.inf if s is None else s.score for s in along), -np.inf])
    tops = [s for k, s in enumerate(along, 1) if s is not None and heights[k] >= max(heights[k - 1], heights[k + 1])]
    again = [_refitted(now, replace(_summit(now, s, hyper), score=x.scored.score), hyper) for s in tops]
    return max((x, *(s for s in again if s.inside)), key=lambda s: s.evidence)  # a top at an end was not found


def _summit(now: Hypothesis, start: Scored, hyper: Hyper) -> Scored:
    """The shapes of most evidence near ``start``'s, whose ridge may run askew to each of them."""
    from scipy.optimize import minimize  # half a second, for what few recordings need

    c, best = start.candidate, start

    def lost(values: Array) -> float:
        nonlocal best
        shapes = dict(zip(symbols, values.tolist(), strict=True))
        s = score_new(now, c.effect, c.joints, shapes, hyper, quick=True)
        if s is None or not s.admissible:
            return np.inf
        best = max(best, s, key=lambda x: x.score)
        return -s.score

    symbols = [p.symbol for p in c.effect.shapes]
    at = np.array([c.shapes[k] for k in symbols])
    steps = np.diag([0.1 * (p.hi - p.lo) / (len(p.grid) if len(p.grid) > 1 else 1) for p in c.effect.shapes])
    minimize(
        lost, at, method="Nelder-Mead", bounds=[(p.lo, p.hi) for p in c.effect.shapes],
        options={"initial_simplex": np.vstack([at, at + 3 * steps]), "maxfev": CLIMB, "xatol": 1e-3, "fatol": 0.1},
    )  # fmt: skip
    return best


def _geared(settled: list[Settled], now: Hypothesis, hyper: Hyper) -> list[Settled]:
    """The contenders, those with levers of their own at the noise that the likeliest leaves, which falls as they come to explain more.

    ``hyper``: at which they were sought; where the likeliest leaves almost as much, other levers would be no better.
    """

    def sought(x: Settled, least: Hyper) -> Settled:
        c = x.candidate
        falls = _geometric(c) and any(hyper.kappa[j] > FALLS * least.kappa[j] for j in c.joints)
        return _sought_again(now, x, least) if falls else x

    for _ in range(SEARCHES):
        likeliest = max(settled, key=lambda x: x.evidence)
        again = [sought(x, likeliest.hyper) for x in settled]
        if max(x.evidence - y.evidence for x, y in zip(again, settled, strict=True)) < 1.0:
            break
        settled = again
    return settled


def _starts(p: Shape) -> Sequence[float]:
    """Where a shape is sought from: its grid; all over the range of one that has a single value."""
    return p.grid if len(p.grid) > 1 else np.linspace(p.lo, p.hi, ALONG).tolist()


def _geometric(c: Candidate) -> bool:
    """Whether a law has a place and levers of its own, and refines a plainer one."""
    return bool(c.effect.shapes and c.effect.refines)


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


def other_gears(now: Hypothesis, gear: Settled, hyper: Hyper) -> tuple[Scored, ...]:
    """Gears of other joints that explain nearly as much as a claimed one whose link swings faster than was looked for.

    Its stiffness came out beyond `SWINGS`, where no other joint's was asked; a gear shakes its neighbours at its own frequency.
    """
    c = gear.candidate
    if c.effect.role != "swing" or within_reach(now.engine, c):
        return ()
    M = np.median(np.diagonal(now.engine.source.mass, axis1=1, axis2=2), axis=0)
    ratio = M / M[c.joints[0]]
    found = []
    for j in (j for j, x in enumerate(ratio) if x > 0 and j not in c.joints and now.engine.rows[j].size > limit.FEWEST_ROWS):
        s = score_new(
            now,
            c.effect,
            (j,),
            {**gear.scored.candidate.shapes, "K": c.shapes["K"] * ratio[j], "D": c.shapes["D"] * ratio[j]},
            hyper,
        )
        if s is not None and s.score > 0:
            found.append(refine(now, s, hyper))
    least = gear.scored.score - gear.taken_up - limit.THRESHOLD
    return tuple(s for s in found if s.admissible and s.score > least)


def within_reach(engine: Engine, c: Candidate) -> bool:
    """Whether a gear's link swings as slowly as was looked for."""
    M = float(np.median(engine.source.mass[:, c.joints[0], c.joints[0]]))
    return c.shapes["K"] < limit.SWINGS[1] ** 2 * M


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
