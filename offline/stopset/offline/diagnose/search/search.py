"""The search: effects are claimed one after another while the evidence for the best one is a claim's."""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass, replace

import numpy as np

from stopset.effects import catalogue
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.evidence.candidate import Candidate, EffectKey, Scored
from stopset.offline.diagnose.evidence.engine import Engine
from stopset.offline.diagnose.evidence.evidence import Projection
from stopset.offline.diagnose.evidence.forms import with_forms
from stopset.offline.diagnose.evidence.hypothesis import Hyper, Hypothesis
from stopset.offline.diagnose.evidence.scores import score_new, scores
from stopset.offline.diagnose.search.held_out import HeldOut, held_out
from stopset.offline.diagnose.search.lag_form import formed
from stopset.offline.diagnose.search.predicts import judged, outdone, outdone_elsewhere
from stopset.offline.diagnose.search.refine import begun, refined
from stopset.offline.diagnose.search.ripple import RIPPLES, Ripples
from stopset.offline.diagnose.search.settle import instead, likeliest_gear, said_already, settle, shows_in_its_place
from stopset.offline.diagnose.search.settled import added, refines, refitted
from stopset.offline.diagnose.search.wanted import exact, wanted
from stopset.offline.nominal.friction_choice import LOADS
from stopset.progress import Progress, silent
from stopset.types import Array


@dataclass(frozen=True, slots=True)
class Claim:
    """An effect found: its score when claimed, parameters, and the contenders it beat narrowly."""

    scored: Scored
    score: float
    rivals: tuple[Scored, ...]
    excess_before: tuple[float, ...]  # residual variance over sensor noise per joint, before the claim
    excess_after: tuple[float, ...]
    alike: tuple[str, ...] = ()  # effects that the rows do not tell from it at its joint

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
    before: HeldOut  # of the model without the claims


def search(start: Hypothesis, names: Sequence[str] | None = None, progress: Progress = silent) -> Found:
    """Claim effects beside ``start`` one after another, refit all after each, and drop a claim that later ones made needless.

    ``progress`` is given each claim as it is made.
    """
    engine = start.engine
    candidates = engine.add_all(wanted(engine, names, start.active))
    ripple = next((e for e in catalogue().values() if e.periodic and (names is None or e.name in names)), None)
    ripples = Ripples(engine, ripple) if ripple else None
    now = start
    hyper, p = now.fit()
    candidates += engine.add_all(exact(engine, hyper, names))
    excess = now.excesses(p.theta, hyper)
    claims: list[Claim] = []
    left: list[Scored] = []
    first = before = held_out(now, hyper)
    refused = set[EffectKey]()
    for _ in range(limit.MAX_CLAIMS):
        left = scores(now, _asked_now(candidates, ripples, now, p.theta, hyper), hyper)
        # a law whose numbers came out beyond what they can be is no finding, and says nothing that another form would
        beyond = {k.scored.candidate.key for k in _as_fitted(now, claims, p.theta) if not k.scored.admissible}
        sound = tuple(c for c in now.active if c.key not in beyond)
        taken = refused | {c.key for c in now.active}
        open_ones = [s for s in left if s.candidate.key not in taken and not said_already(sound, s.candidate)]
        best = refined(now, open_ones, hyper)
        best = [s for s in best if s.score >= limit.THRESHOLD]
        claimed = [c for c in now.active if c.key in {x.scored.candidate.key for x in claims}]
        if best and claims:
            loose = with_forms(now, claimed, p.theta)
            loose_hyper, _ = loose.fit(hyper)
            best = [s for s in best if _stands(loose, s, loose_hyper)]
        if not best:
            break
        earlier, (top, rivals) = now, settle(now, best, hyper, refused, names)
        plainer = next((c for c in claimed if c.key not in beyond and refines(top.candidate, c)), None)
        top, rivals = (top, rivals) if plainer is None else (instead(now, plainer, top, hyper), ())
        top, rivals = likeliest_gear(earlier, top, rivals, hyper)
        now, hyper, p, candidate = top.now, top.hyper, top.fit, top.candidate
        if candidate.effect.role == "swing":
            now, hyper, p = _with_swings(now, hyper, p)
        error = held_out(now, hyper)
        worse = plainer is not None and not shows_in_its_place(earlier, top)
        worse = worse or _said_better(earlier, top.scored, left, refused, hyper) or _lag_of_noise(earlier, candidate, hyper)
        if worse or judged(earlier, candidate, before, error, hyper, claimed).why:
            now = earlier
            hyper, p = now.fit(hyper)
            refused.add(top.scored.candidate.key)
            continue
        lag = formed(earlier, top, names)
        if lag.settled is not top:
            top = lag.settled
            now, hyper, p, candidate, error = top.now, top.hyper, top.fit, top.candidate, held_out(top.now, top.hyper)
        if candidate.effect.role != "swing" and any(c.effect.role == "swing" for c in earlier.active):
            now, hyper, p = _with_swings(now, hyper, p)
            error = held_out(now, hyper)
        before, after = error, now.excesses(p.theta, hyper)
        replaced = next((k for k in claims if plainer is not None and k.scored.candidate.key == plainer.key), None)
        since = excess if replaced is None else replaced.excess_before
        claims = [*(k for k in claims if k is not replaced), Claim(top.scored, top.scored.score, rivals, since, after, lag.alike)]
        where = "+".join(engine.data.joints[j] for j in candidate.joints) or "the whole arm"
        progress(f"so far: {candidate.effect.name} at {where}, score {top.scored.score:.0f}; asking every other again")
        excess = after
    claims = _as_fitted(now, claims, p.theta)
    now, retained = _needed(now, claims, hyper)
    for k, claim in enumerate(retained):
        now, retained[k] = _settled_again(now, claim, hyper, refused, names)
    now, hyper, p = _as_loaded(now, retained, hyper)
    return Found(tuple(_as_fitted(now, retained, p.theta)), tuple(left), now, hyper, now.excesses(p.theta, hyper), first)


def with_own_law(found: Found, k: int) -> Found:
    """The outcome with the law that identification chose in these recordings in the place of the claim ``k`` at its joint, where that is a
    possible rival of it; else as it is."""
    claim = found.claims[k]
    c, chosen = claim.scored.candidate, found.now.engine.chosen - {c.key for c in found.now.active}
    own = next((s for s in claim.rivals if s.candidate.key in chosen and s.candidate.joints == c.joints), None)
    if own is None:
        return found
    top = refitted(found.now.without(c.key), own, found.hyper)
    if not top.possible:
        return found
    others = tuple(s for s in claim.rivals if s is not own)
    claims = list(found.claims)
    claims[k] = replace(claim, scored=top.scored, score=top.scored.score, rivals=others)
    now, hyper, p = _as_loaded(found.now.instead(top.candidate, c.key), claims, top.hyper)
    excess = now.excesses(p.theta, hyper)
    return replace(found, claims=tuple(_as_fitted(now, claims, p.theta)), now=now, hyper=hyper, excess=excess)


def _asked_now(
    candidates: Sequence[Candidate], ripples: Ripples | None, now: Hypothesis, theta: Array, hyper: Hyper
) -> list[Candidate]:
    """The ``candidates`` and the strongest ripples; exact swings only where far more than noise is left, ``theta``: of ``now``."""
    found = now.engine.add_all(ripples.strongest(now, theta, hyper)) if ripples else []
    charge = 2 * np.log(len(RIPPLES))
    pool = [*candidates, *(replace(c, charge=charge) for c in found)]
    return [c for c in pool if "exact" not in c.shapes or hyper.kappa[c.joints[0]] > limit.FAR_OVER_NOISE]


def _with_swings(now: Hypothesis, hyper: Hyper, p: Projection) -> tuple[Hypothesis, Hyper, Projection]:
    """Claimed elasticities estimated again, with all that is known by now, and the whole model with them."""
    for c in now.active:
        if c.effect.role == "swing":
            now.engine.update_source(p.theta)
            now = now.instead(added(now, begun(now.without(c.key), c, hyper)))
            hyper, p = now.fit(hyper)
    return now, hyper, p


def _as_loaded(now: Hypothesis, claims: Sequence[Claim], hyper: Hyper) -> tuple[Hypothesis, Hyper, Projection]:
    """The model fitted with claims of the load taken at the load of the arm as it was fitted beside them all.

    They are found with that of the description, which may be any share off: a quarter at a UR10e's elbow.  Their numbers are of what the
    links weigh: a model says them with the links that it was identified with.
    """
    claimed = {k.scored.candidate.key for k in claims}
    ours = [c for c in now.active if c.key in claimed and "load" in c.effect.needs]
    hyper, p = now.fit(hyper)
    place = {column: k for k, column in enumerate(now.nuisance.tolist())}
    loads = [[place[k] for k in c.cols.tolist()] for c in now.active if c.effect.carried]
    for _ in range(LOADS if ours and not now.engine.source.compensated else 0):
        now.engine.weigh(p.theta, sum((p.theta[at] for at in loads), np.zeros(10)))
        for c in ours:
            now = now.instead(replace(added(now, c), sd=c.sd, charge=c.charge))
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


def _said_better(now: Hypothesis, s: Scored, asked: Sequence[Scored], refused: Set[EffectKey], hyper: Hyper) -> bool:
    """Whether a law that was refused says far more of what a claim would explain, at its joint or at one of the arm's."""
    return outdone(s, asked, refused) or outdone_elsewhere(now, s, asked, refused, hyper)


def _lag_of_noise(now: Hypothesis, c: Candidate, hyper: Hyper) -> bool:
    """Whether a lag is claimed where the rows hold less than their sensors' noise without it: that noise is all there is to be shifted.

    Without its joint's stamps, too, as in `judged`: 21 ms had moved them by five times what stamps may be off, and left less than noise.
    """
    if c.effect.enters != "input_delay":
        return False
    held = replace(now, held=(*now.held, *(int(now.engine.stamps[j]) for j in c.joints)))
    same, p = held.fit(hyper)
    excess = held.excesses(p.theta, same)
    return all(excess[j] < 1.0 for j in c.joints)


def _stands(now: Hypothesis, s: Scored, hyper: Hyper) -> bool:
    """Whether a contender is as likely against ``now``, in which earlier claims' forms may be off."""
    c = s.candidate
    if not now.forms:
        return s.score >= limit.THRESHOLD
    again = score_new(now, c.effect, c.joints, c.shapes, hyper)
    return again is not None and again.score - c.charge >= limit.THRESHOLD


def _settled_again(
    now: Hypothesis, claim: Claim, hyper: Hyper, refused: Set[EffectKey], names: Sequence[str] | None
) -> tuple[Hypothesis, Claim]:
    """A narrow decision between contenders taken again, now that all the other causes are known: those that no later claim says."""
    if claim.scored.candidate.effect.role == "swing":
        return now, claim
    key = claim.scored.candidate.key
    others = now.without(key)
    open_ones = [s for s in claim.rivals if not said_already(others.active, s.candidate)]
    top, rivals = settle(others, [claim.scored, *open_ones], hyper, refused, names)
    if top.candidate.key == key:
        return now, claim
    return now.instead(top.candidate, key), replace(claim, scored=top.scored, score=top.scored.score, rivals=rivals)


def _needed(now: Hypothesis, claims: Sequence[Claim], hyper: Hyper) -> tuple[Hypothesis, list[Claim]]:
    """The claims that still stand when tried against all the others, `_foremost_first`; what a later one made needless is dropped."""
    retained = list(claims)
    for claim in claims[:-1]:
        c = claim.scored.candidate
        if scores(now.without(c.key), [c], hyper)[0].score < limit.THRESHOLD:
            now = now.without(c.key)
            retained = [k for k in retained if k.scored.candidate.key != c.key]
    return now, _foremost_first(now, retained, hyper)


def _foremost_first(now: Hypothesis, claims: list[Claim], hyper: Hyper) -> list[Claim]:
    """The claims that a free rigid body takes up in the order of what they say beside all others, in the places that they have.

    A later one of them must show beside the first (`judged`): which one was found first says nothing of which is the cause.
    """

    def says(claim: Claim) -> float:
        c = claim.scored.candidate
        return scores(now.without(c.key), [c], hyper)[0].score

    alike = [k for k in claims if k.scored.candidate.effect.absorbed]
    if len(alike) < 2:
        return claims
    ordered = iter(sorted(alike, key=says, reverse=True))
    return [next(ordered) if k in alike else k for k in claims]


def label(engine: Engine, scored: Scored) -> str:
    """``effect:joint``."""
    c = scored.candidate
    where = "+".join(engine.data.joints[j] for j in c.joints)
    return f"{c.effect.name}:{where}" if where else c.effect.name
