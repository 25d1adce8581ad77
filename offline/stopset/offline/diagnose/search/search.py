"""The search: effects are claimed one after another while the evidence for the best one is beyond doubt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stopset.effects import catalogue, get
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.columns.ripple import RIPPLES, Ripples
from stopset.offline.diagnose.evidence.engine import Candidate, Engine, Hyper, Scored
from stopset.offline.diagnose.evidence.evidence import Projection
from stopset.offline.diagnose.evidence.scores import score_new, scores
from stopset.offline.diagnose.search.held_out import held_out
from stopset.offline.diagnose.search.refine import begun, refined, sharpened
from stopset.offline.diagnose.search.wanted import exact, wanted
from stopset.progress import Tell, silent
from stopset.types import Array

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
    hyper: Hyper
    excess: tuple[float, ...]
    before: Array  # (n,) held-out error [N m] of the model without the claims


def search(engine: Engine, names: Sequence[str] | None = None, threshold: float = limit.THRESHOLD, tell: Tell = silent) -> Found:
    """Claim effects one after another, refit all after each, and drop a claim that the later ones made needless.

    ``tell`` is told each claim as it is made.
    """
    candidates = engine.add_all(wanted(engine, names))
    ripple = next((e for e in catalogue().values() if e.periodic and (names is None or e.name in names)), None)
    ripples = Ripples(engine, ripple) if ripple else None
    hyper, p = engine.fit()
    candidates += engine.add_all(exact(engine, hyper, names))
    excess = _excess(engine, p.theta, hyper)
    claims: list[Claim] = []
    left: list[Scored] = []
    first = before = held_out(engine, hyper)
    refused = set[tuple[str, tuple[int, ...]]]()
    for _ in range(limit.MAX_CLAIMS):
        found = engine.add_all(ripples.strongest(p.theta, hyper)) if ripples else []
        charge = 2 * np.log(len(RIPPLES))
        pool = [*candidates, *(replace(c, charge=charge) for c in found)]
        fit = [c for c in pool if "exact" not in c.shapes or hyper.kappa[c.joints[0]] > limit.LOUD]
        left = scores(engine, fit, hyper)
        taken = {c.key for c in engine.active}
        best = refined(engine, [s for s in left if s.candidate.key not in taken | refused], hyper)
        best = [s for s in best if s.score >= threshold and _stands(engine, s, claims, excess, hyper, threshold)]
        if not best:
            break
        near = [s for s in best if s.score > best[0].score - max(12.0, 0.05 * best[0].score)]
        top, candidate, hyper, p = _settle(engine, near, hyper)
        earlier = list(engine.active)
        engine.active.append(candidate)
        if candidate.effect.role == "swing":
            hyper, p = _with_swings(engine, hyper, p)
        error = held_out(engine, hyper)
        if not foretells(candidate, _unexcused(engine, candidate, before, hyper), error):
            engine.active = earlier
            hyper, p = engine.fit(hyper)
            refused.add(top.candidate.key)
            continue
        if candidate.effect.role != "swing" and any(c.effect.role == "swing" for c in earlier):
            hyper, p = _with_swings(engine, hyper, p)
            error = held_out(engine, hyper)
        before = error
        after = _excess(engine, p.theta, hyper)
        rivals = tuple(r for r in near if r.candidate.key != candidate.key)
        claims.append(Claim(top, top.score, rivals, excess, after))
        where = "+".join(engine.data.joints[j] for j in top.candidate.joints) or "the whole arm"
        tell(f"so far: {top.candidate.effect.name} at {where}, score {top.score:.0f}; asking every other again")
        excess = after
    kept = _needed(engine, _as_fitted(engine, claims, p.theta), hyper, threshold)
    kept = [_settled_again(engine, claim, hyper) for claim in kept]
    hyper, p = engine.fit(hyper)
    return Found(tuple(_as_fitted(engine, kept, p.theta)), tuple(left), hyper, _excess(engine, p.theta, hyper), first)


def _with_swings(engine: Engine, hyper: Hyper, p: Projection) -> tuple[Hyper, Projection]:
    """Claimed elasticities estimated again, with all that is known by now, and the whole model with them."""
    for k, c in enumerate(engine.active):
        if c.effect.role == "swing":
            engine.tell_source(p.theta)
            engine.active.pop(k)
            engine.active.insert(k, _added(engine, begun(engine, c, hyper)))
            hyper, p = engine.fit(hyper)
    return hyper, p


def _as_fitted(engine: Engine, claims: Sequence[Claim], theta: Array) -> list[Claim]:
    """The claims with candidates, shapes and coefficients of the final fit; ``theta``: of the engine's nuisance."""
    place = {column: k for k, column in enumerate(engine.nuisance.tolist())}
    now = {c.key: c for c in engine.active}
    out = []
    for claim in claims:
        c = now[claim.scored.candidate.key]
        value = theta[[place[k] for k in c.cols.tolist()]]
        out.append(replace(claim, scored=replace(claim.scored, candidate=c, theta=value)))
    return out


def _unexcused(engine: Engine, candidate: Candidate, before: Array, hyper: Hyper) -> Array:
    """(n,) held-out error before a delay just added, its joint's stamps held: far off, they would imitate a good part of it."""
    if candidate.effect.enters != "input_delay":
        return before
    engine.active.pop()
    engine.hold((int(engine.stamps[candidate.joints[0]]),))
    error = held_out(engine, hyper)
    engine.hold(())
    engine.active.append(candidate)
    return error


def _stands(engine: Engine, s: Scored, claims: Sequence[Claim], excess: Sequence[float], hyper: Hyper, threshold: float) -> bool:
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
    again = score_new(engine, c.effect, c.joints, c.shapes, elsewhere)
    return again is not None and again.score >= threshold


def _form_error(claim: Claim, excess: Sequence[float]) -> float:
    """Evidence that a claim's imperfect law may have left over at its joints."""
    left = max(excess[j] for j in claim.joints or range(len(excess)))
    return claim.score * (limit.FORM_ERROR if left > limit.SENSORS else limit.TRUE_FORM)


def foretells(candidate: Candidate, before: Array, after: Array) -> bool:
    """Whether a law foretells motions that it was not fitted to; what a free base model takes up can't show there."""
    where = list(candidate.joints) or list(range(len(before)))
    return candidate.effect.absorbed or bool(np.max(1.0 - after[where] / before[where]) > limit.LOWERED)


Settled = tuple[float, Scored, Candidate, Hyper, Projection]


def _settle(engine: Engine, near: Sequence[Scored], hyper: Hyper) -> tuple[Scored, Candidate, Hyper, Projection]:
    """Among contenders of nearly equal score, the one with which the whole model, refitted, is most likely.

    Of two that look alike at the same joint and are as good as equally likely, the simpler one; and the plainer form of a law
    where it explains as good as all of what the finer one does, however sure the rest is.
    """
    settled: list[Settled] = []
    for s in near:
        candidate = _added(engine, sharpened(engine, s, hyper))
        engine.active.append(candidate)
        h, p = engine.fit(hyper)
        settled.append((engine.evidence(h), s, candidate, h, p))
        engine.active.pop()
    best = max(settled, key=lambda x: x[0])
    simpler = [x for x in settled if _simplifies(x[2], best[2]) and x[0] > best[0] - limit.SIMPLER * best[1].score]
    best = max(simpler, key=lambda x: x[0], default=best)
    return max(_plainer(engine, best, hyper), key=lambda x: x[0], default=best)[1:]


def _plainer(engine: Engine, best: Settled, hyper: Hyper) -> list[Settled]:
    """The plainer forms of a law that explain as much of its joints' leftover variance, but for `PLAIN` of it."""
    c, out = best[2], list[Settled]()
    if not c.effect.refines:
        return out
    h, p = engine.fit(hyper)
    where = list(c.joints) or list(range(engine.data.n))
    before, finer = (np.asarray(_excess(engine, p.theta, h))[where], np.asarray(_excess_with(engine, best))[where])
    claimed = {x.key for x in engine.active}
    for effect in (e for e in map(get, c.effect.refines) if (e.name, c.joints) not in claimed):
        s = score_new(engine, effect, c.joints, {}, hyper)
        if s is None or not s.admissible:
            continue
        added = _added(engine, s.candidate)
        engine.active.append(added)
        h, p = engine.fit(hyper)
        left = np.asarray(_excess(engine, p.theta, h))[where]
        if np.all(left - finer <= limit.PLAIN * (before - finer)):
            out.append((engine.evidence(h), replace(s, score=min(s.score, best[1].score), candidate=added), added, h, p))
        engine.active.pop()
    return out


def _excess_with(engine: Engine, settled: Settled) -> tuple[float, ...]:
    """Leftover variance by joint with a contender."""
    _, _, candidate, h, p = settled
    engine.active.append(candidate)
    out = _excess(engine, p.theta, h)
    engine.active.pop()
    return out


def _settled_again(engine: Engine, claim: Claim, hyper: Hyper) -> Claim:
    """A narrow decision between contenders taken again, now that all the other causes are known."""
    if not claim.rivals or claim.scored.candidate.effect.role == "swing":
        return claim
    mine = next(k for k, c in enumerate(engine.active) if c.key == claim.scored.candidate.key)
    here = engine.active.pop(mine)
    top, candidate, _, _ = _settle(engine, [claim.scored, *claim.rivals], hyper)
    same = candidate.key == here.key
    engine.active.insert(mine, here if same else candidate)
    if same:
        return claim
    rivals = tuple(r for r in (claim.scored, *claim.rivals) if r.candidate.key != candidate.key)
    return replace(claim, scored=top, score=top.score, rivals=rivals)


def _added(engine: Engine, candidate: Candidate) -> Candidate:
    """A candidate with columns of its own in the engine."""
    c = engine.add(candidate.effect, candidate.joints, candidate.shapes)
    assert c is not None
    return c


def _simplifies(a: Candidate, b: Candidate) -> bool:
    """Whether ``a`` says with fewer parameters what looks like ``b`` at the same joints."""

    def parameters(c: Candidate) -> int:
        return len(c.effect.terms) + len(c.effect.shapes)

    return a.joints == b.joints and a.effect.name in b.effect.looks_like and parameters(a) < parameters(b)


def _needed(engine: Engine, claims: Sequence[Claim], hyper: Hyper, threshold: float) -> list[Claim]:
    """The claims that still stand when tried against all the others; what a later one made needless is dropped."""
    kept = list(claims)
    claimed = [c.scored.candidate for c in claims]
    known = [c for c in engine.active if not any(c is x for x in claimed)]
    for claim in claims[:-1]:
        key = claim.scored.candidate.key
        others = [c for c in kept if c.scored.candidate.key != key]
        engine.active = known + [c.scored.candidate for c in others]
        if scores(engine, [claim.scored.candidate], hyper)[0].score < threshold:
            kept = [_heir(claim, c) for c in others]
    engine.active = known + [c.scored.candidate for c in kept]
    return kept


def _heir(dropped: Claim, claim: Claim) -> Claim:
    """A claim whose finer law has made its plainer form at the same joint needless explains what that did, too."""
    old, new = dropped.scored.candidate, claim.scored.candidate
    if old.effect.name not in new.effect.refines or old.joints != new.joints:
        return claim
    score = dropped.score + claim.score
    return replace(claim, scored=replace(claim.scored, score=score), score=score, excess_before=dropped.excess_before)


def _excess(engine: Engine, theta: Array, hyper: Hyper) -> tuple[float, ...]:
    view = engine.view()
    return tuple(view.excess(j, theta, hyper.sigma[j], hyper.kappa[j]) for j in range(engine.data.n))
