"""The search: effects are claimed one after another while the evidence for the best one is beyond doubt."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stopset.effects import catalogue, get
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.columns.ripple import RIPPLES, Ripples
from stopset.offline.diagnose.evidence.candidate import Candidate, Scored
from stopset.offline.diagnose.evidence.evidence import Projection
from stopset.offline.diagnose.evidence.hypothesis import Hyper, Hypothesis
from stopset.offline.diagnose.evidence.scores import score_new, scores
from stopset.offline.diagnose.search.held_out import held_out
from stopset.offline.diagnose.search.refine import begun, refined, sharpened
from stopset.offline.diagnose.search.wanted import exact, wanted
from stopset.types import Array

Tell = Callable[[str], None]
UNHEARD = 1e9  # noise variance of rows that are to say nothing


@dataclass(frozen=True, slots=True)
class Claim:
    """An effect found: its score when claimed, parameters, and the contenders it beat narrowly."""

    scored: Scored
    score: float
    rivals: tuple[Scored, ...]
    excess_before: tuple[float, ...]  # residual variance over sensor noise per joint, before the claim
    excess_after: tuple[float, ...]

    @property
    def joints(self) -> tuple[int, ...]:
        return self.scored.candidate.joints


@dataclass(frozen=True, slots=True)
class Found:
    """The search's outcome: claims, the last look at everything else, and the final model."""

    claims: tuple[Claim, ...]
    left: tuple[Scored, ...]
    now: Hypothesis
    hyper: Hyper
    excess: tuple[float, ...]
    before: Array  # (n,) held-out error [N m] of the model without the claims


def search(
    start: Hypothesis, names: Sequence[str] | None = None, threshold: float = limit.THRESHOLD, tell: Tell = lambda _: None
) -> Found:
    """Claim effects beside ``start`` one after another, refit all after each, and drop a claim that later ones made needless.

    ``tell`` is told each claim as it is made.
    """
    engine = start.engine
    candidates = engine.add_all(wanted(engine, names))
    ripple = next((e for e in catalogue().values() if e.periodic and (names is None or e.name in names)), None)
    ripples = Ripples(engine, ripple) if ripple else None
    now = start
    hyper, p = now.fit()
    candidates += engine.add_all(exact(engine, hyper, names))
    excess = now.excesses(p.theta, hyper)
    claims: list[Claim] = []
    left: list[Scored] = []
    first = before = held_out(now, hyper)
    refused = set[tuple[str, tuple[int, ...]]]()
    for _ in range(limit.MAX_CLAIMS):
        found = engine.add_all(ripples.strongest(now, p.theta, hyper)) if ripples else []
        charge = 2 * np.log(len(RIPPLES))
        pool = [*candidates, *(replace(c, charge=charge) for c in found)]
        fit = [c for c in pool if "exact" not in c.shapes or hyper.kappa[c.joints[0]] > limit.LOUD]
        left = scores(now, fit, hyper)
        taken = {c.key for c in now.active}
        best = refined(now, [s for s in left if s.candidate.key not in taken | refused], hyper)
        best = [s for s in best if s.score >= threshold and _stands(now, s, claims, excess, hyper, threshold)]
        if not best:
            break
        near = [s for s in best if s.score > best[0].score - max(12.0, 0.05 * best[0].score)]
        top, new, hyper_new, p_new = _settle(now, near, hyper)
        candidate, earlier = new.active[-1], now
        now, hyper, p = new, hyper_new, p_new
        if candidate.effect.role == "swing":
            now, hyper, p = _with_swings(now, hyper, p)
        error = held_out(now, hyper)
        if not foretells(candidate, _unexcused(earlier, candidate, before, hyper), error):
            now = earlier
            hyper, p = now.fit(hyper)
            refused.add(top.candidate.key)
            continue
        if candidate.effect.role != "swing" and any(c.effect.role == "swing" for c in earlier.active):
            now, hyper, p = _with_swings(now, hyper, p)
            error = held_out(now, hyper)
        before = error
        after = now.excesses(p.theta, hyper)
        rivals = tuple(r for r in near if r.candidate.key != candidate.key)
        claims.append(Claim(top, top.score, rivals, excess, after))
        where = "+".join(engine.data.joints[j] for j in top.candidate.joints) or "the whole arm"
        tell(f"so far: {top.candidate.effect.name} at {where}, score {top.score:.0f}; asking every other again")
        excess = after
    claims = _as_fitted(now, claims, p.theta)
    now, kept = _needed(now, claims, hyper, threshold)
    for k, claim in enumerate(kept):
        now, kept[k] = _settled_again(now, claim, hyper)
    hyper, p = now.fit(hyper)
    return Found(tuple(_as_fitted(now, kept, p.theta)), tuple(left), now, hyper, now.excesses(p.theta, hyper), first)


def _with_swings(now: Hypothesis, hyper: Hyper, p: Projection) -> tuple[Hypothesis, Hyper, Projection]:
    """Claimed elasticities estimated again, with all that is known by now, and the whole model with them."""
    for c in now.active:
        if c.effect.role == "swing":
            now.engine.tell_source(p.theta)
            now = now.instead(_added(now, begun(now.without(c.key), c, hyper)))
            hyper, p = now.fit(hyper)
    return now, hyper, p


def _as_fitted(now: Hypothesis, claims: Sequence[Claim], theta: Array) -> list[Claim]:
    """The claims with candidates, shapes and coefficients of the final fit; ``theta``: of the hypothesis's nuisance."""
    place = {column: k for k, column in enumerate(now.nuisance.tolist())}
    active = {c.key: c for c in now.active}
    out = []
    for claim in claims:
        c = active[claim.scored.candidate.key]
        value = theta[[place[k] for k in c.cols.tolist()]]
        out.append(replace(claim, scored=replace(claim.scored, candidate=c, theta=value)))
    return out


def _unexcused(earlier: Hypothesis, candidate: Candidate, before: Array, hyper: Hyper) -> Array:
    """(n,) held-out error before a delay just added, its joint's stamps held: far off, they would imitate a good part of it."""
    if candidate.effect.enters != "input_delay":
        return before
    return held_out(replace(earlier, held=(int(earlier.engine.stamps[candidate.joints[0]]),)), hyper)


def _stands(now: Hypothesis, s: Scored, claims: Sequence[Claim], excess: Sequence[float], hyper: Hyper, threshold: float) -> bool:
    """Whether a contender's evidence is more than what earlier claims' imperfect laws may have left over on the same rows.

    What the whole arm shows may stand without the rows of the joints concerned instead.  ``excess``: by joint, after the claims.
    """
    c = s.candidate
    touching = [x for x in claims if not c.joints or not x.joints or set(c.joints) & set(x.joints)]
    if s.score >= max((_form_error(x, excess) for x in touching), default=0.0):
        return True
    if c.joints or any(not x.joints for x in touching):
        return False
    concerned = {j for x in touching for j in x.joints if s.score < _form_error(x, excess)}
    elsewhere = replace(hyper, kappa=tuple(UNHEARD if j in concerned else k for j, k in enumerate(hyper.kappa)))
    again = score_new(now, c.effect, c.joints, c.shapes, elsewhere)
    return again is not None and again.score >= threshold


def _form_error(claim: Claim, excess: Sequence[float]) -> float:
    """Evidence that a claim's imperfect law may have left over at its joints."""
    left = max(excess[j] for j in claim.joints or range(len(excess)))
    return claim.score * (limit.FORM_ERROR if left > limit.SENSORS else limit.TRUE_FORM)


def foretells(candidate: Candidate, before: Array, after: Array) -> bool:
    """Whether a law foretells motions that it was not fitted to; what a free base model takes up can't show there."""
    where = list(candidate.joints) or list(range(len(before)))
    return candidate.effect.absorbed or bool(np.max(1.0 - after[where] / before[where]) > limit.LOWERED)


Settled = tuple[float, Scored, Hypothesis, Hyper, Projection]  # its last effect is the contender


def _settle(now: Hypothesis, near: Sequence[Scored], hyper: Hyper) -> tuple[Scored, Hypothesis, Hyper, Projection]:
    """Among contenders of nearly equal score, the one with which the whole model, refitted, is most likely.

    Of two that look alike at the same joint and are as good as equally likely, the simpler one; and the plainer form of a law
    where it explains as good as all of what the finer one does, however sure the rest is.
    """
    settled: list[Settled] = []
    for s in near:
        with_it = now.plus(_added(now, sharpened(now, s, hyper)))
        h, p = with_it.fit(hyper)
        settled.append((with_it.evidence(h), s, with_it, h, p))
    best = max(settled, key=lambda x: x[0])
    simpler = [x for x in settled if _simplifies(_last(x), _last(best)) and x[0] > best[0] - limit.SIMPLER * best[1].score]
    best = max(simpler, key=lambda x: x[0], default=best)
    return max(_plainer(now, best, hyper), key=lambda x: x[0], default=best)[1:]


def _last(x: Settled) -> Candidate:
    return x[2].active[-1]


def _plainer(now: Hypothesis, best: Settled, hyper: Hyper) -> list[Settled]:
    """The plainer forms of a law that explain as much of its joints' leftover variance, but for `PLAIN` of it."""
    c, out = _last(best), list[Settled]()
    if not c.effect.refines:
        return out
    h, p = now.fit(hyper)
    where = list(c.joints) or list(range(now.engine.data.n))
    _, _, finest, finest_h, finest_p = best
    before, finer = np.asarray(now.excesses(p.theta, h))[where], np.asarray(finest.excesses(finest_p.theta, finest_h))[where]
    claimed = {x.key for x in now.active}
    for effect in (e for e in map(get, c.effect.refines) if (e.name, c.joints) not in claimed):
        s = score_new(now, effect, c.joints, {}, hyper)
        if s is None or not s.admissible:
            continue
        with_it = now.plus(_added(now, s.candidate))
        h, p = with_it.fit(hyper)
        left = np.asarray(with_it.excesses(p.theta, h))[where]
        if np.all(left - finer <= limit.PLAIN * (before - finer)):
            mine = replace(s, score=min(s.score, best[1].score), candidate=with_it.active[-1])
            out.append((with_it.evidence(h), mine, with_it, h, p))
    return out


def _settled_again(now: Hypothesis, claim: Claim, hyper: Hyper) -> tuple[Hypothesis, Claim]:
    """A narrow decision between contenders taken again, now that all the other causes are known."""
    if not claim.rivals or claim.scored.candidate.effect.role == "swing":
        return now, claim
    key = claim.scored.candidate.key
    top, other, _, _ = _settle(now.without(key), [claim.scored, *claim.rivals], hyper)
    candidate = other.active[-1]
    if candidate.key == key:
        return now, claim
    rivals = tuple(r for r in (claim.scored, *claim.rivals) if r.candidate.key != candidate.key)
    return now.instead(candidate, key), replace(claim, scored=top, score=top.score, rivals=rivals)


def _added(now: Hypothesis, candidate: Candidate) -> Candidate:
    """A candidate with columns of its own in the engine."""
    c = now.engine.add(candidate.effect, candidate.joints, candidate.shapes)
    assert c is not None
    return c


def _simplifies(a: Candidate, b: Candidate) -> bool:
    """Whether ``a`` says with fewer parameters what looks like ``b`` at the same joints."""

    def parameters(c: Candidate) -> int:
        return len(c.effect.terms) + len(c.effect.shapes)

    return a.joints == b.joints and a.effect.name in b.effect.looks_like and parameters(a) < parameters(b)


def _needed(now: Hypothesis, claims: Sequence[Claim], hyper: Hyper, threshold: float) -> tuple[Hypothesis, list[Claim]]:
    """The claims that still stand when tried against all the others; what a later one made needless is dropped."""
    kept = list(claims)
    for claim in claims[:-1]:
        c = claim.scored.candidate
        if scores(now.without(c.key), [c], hyper)[0].score < threshold:
            now = now.without(c.key)
            kept = [_heir(claim, k) for k in kept if k.scored.candidate.key != c.key]
    return now, kept


def _heir(dropped: Claim, claim: Claim) -> Claim:
    """A claim whose finer law has made its plainer form at the same joint needless explains what that did, too."""
    old, new = dropped.scored.candidate, claim.scored.candidate
    if old.effect.name not in new.effect.refines or old.joints != new.joints:
        return claim
    score = dropped.score + claim.score
    return replace(claim, scored=replace(claim.scored, score=score), score=score, excess_before=dropped.excess_before)
