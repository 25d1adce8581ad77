"""The search: effects are claimed one after another while the evidence for the best one is beyond doubt."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stopset.effects import Effect, catalogue
from stopset.offline.diagnose.engine import Candidate, Engine, Hyper, Scored
from stopset.offline.diagnose.evidence import Projection
from stopset.offline.diagnose.noise import whiten
from stopset.offline.diagnose.prepare import Array

THRESHOLD = 25.0  # twice the log Bayes factor; see docs/diagnosis.md for its calibration on healthy campaigns
LOUD = 2.0  # residual variance over the sensors' noise from which on that noise can't pass for an effect
SHORTEST_LAG = 0.004  # [s] what stamps may differ by without anything being wrong: a sample of a slow bus
FORM_ERROR = 0.03  # share of a claim's evidence that its law's imperfect form may leave for others on the same rows
MAX_CLAIMS = 12
CONTENDERS = 4  # best distinct (effect, joint) whose shapes are refined before one is claimed
RIPPLES = np.arange(12.0, 161.0, 0.5)  # [cycles per turn]
LAGS = (-0.04, -0.015, 0.006, 0.015, 0.04, 0.08)  # [s] start values of a delay


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


Wanted = tuple[Effect, tuple[int, ...], Mapping[str, float]]


def wanted(engine: Engine, names: Sequence[str] | None = None) -> list[Wanted]:
    """All effects of the catalogue at all joints these data can speak of, with the start values of their shapes."""
    n, d = engine.data.n, engine.data
    out: list[Wanted] = []
    for effect in catalogue().values():
        if effect.base or (names is not None and effect.name not in names) or effect.name == "torque_ripple":
            continue
        if effect.name == "residual_gravity" and not engine.source.compensated:
            continue  # the whole rigid body is in the base model
        if ("temp" in effect.needs and d.temp is None) or ("warm" in effect.needs and d.temp is not None):
            continue
        places: list[tuple[int, ...]] = [(j,) for j in range(n) if engine.rows[j].size > 50]
        if effect.scope == "arm":
            places = [()]
        elif effect.scope == "pair":
            places = [(a[0], b[0]) for a, b in itertools.combinations(places, 2)]
        grids = [s.grid for s in effect.shapes]
        for place in places:
            if effect.enters == "input_delay":
                out.extend((effect, place, {"d0": lag}) for lag in LAGS)
                continue
            for values in itertools.product(*grids):
                shapes = dict(zip([s.symbol for s in effect.shapes], values, strict=True))
                if effect.name != "elasticity" or _swings(engine, place[0], shapes["K"]):
                    out.append((effect, place, shapes))
    return out


def _exact(engine: Engine, hyper: Hyper, names: Sequence[str] | None) -> list[Wanted]:
    """Uncalmed columns of elasticity and delay, for the joints whose rows hold far more than the position's noise.

    There noise common to torque and column can't decide, and calming would hide a swing of more than 5 Hz.
    """
    loudest = sorted((j for j in range(engine.data.n) if hyper.kappa[j] > LOUD), key=lambda j: -hyper.kappa[j])[:3]
    out: list[Wanted] = []
    for effect in catalogue().values():
        if names is not None and effect.name not in names:
            continue
        for j in loudest:
            if effect.enters == "input_delay":
                out.extend((effect, (j,), {"d0": lag, "exact": 1.0}) for lag in LAGS)
            elif effect.name == "elasticity":
                M = float(np.median(engine.source.mass[:, j, j]))
                grid = [K for K in effect.shapes[0].grid if _swings(engine, j, K)]
                out.extend((effect, (j,), {"K": K, "D": 0.1 * float(np.sqrt(K * M)), "exact": 1.0}) for K in grid)
    return out


def _swings(engine: Engine, joint: int, K: float) -> bool:
    """Whether a stiffness gives a period that rows can show: 0.1 to 1.5 s."""
    M = float(np.median(engine.source.mass[:, joint, joint]))
    return bool(4.0 < np.sqrt(K / M) < 70.0)


def search(engine: Engine, names: Sequence[str] | None = None, threshold: float = THRESHOLD) -> Found:
    """Claim effects one after another, refit all after each, and drop a claim that the later ones made needless."""
    candidates = engine.add_all(wanted(engine, names))
    ripple = catalogue().get("torque_ripple") if names is None or "torque_ripple" in names else None
    hyper, p = engine.fit()
    candidates += engine.add_all(_exact(engine, hyper, names))
    excess = _excess(engine, p.theta, hyper)
    claims: list[Claim] = []
    left: list[Scored] = []
    for _ in range(MAX_CLAIMS):
        ripples = engine.add_all(_ripples(engine, p.theta, hyper, ripple)) if ripple else []
        charge = 2 * np.log(len(RIPPLES))
        pool = [*candidates, *(replace(c, charge=charge) for c in ripples)]
        fit = [c for c in pool if "exact" not in c.shapes or hyper.kappa[c.joints[0]] > LOUD]
        left = engine.scores(fit, hyper)
        taken = {c.key for c in engine.active}
        best = _refined(engine, [s for s in left if s.candidate.key not in taken], hyper)
        best = [s for s in best if s.score >= max(threshold, _form_error(s, claims))]
        if not best:
            break
        near = [s for s in best if s.score > best[0].score - max(12.0, 0.05 * best[0].score)]
        top, candidate, hyper, p = _settle(engine, near, hyper)
        engine.active.append(candidate)
        after = _excess(engine, p.theta, hyper)
        rivals = tuple(r for r in near if r is not top)
        claims.append(Claim(replace(top, candidate=candidate), top.score, rivals, excess, after))
        excess = after
    kept = _needed(engine, claims, hyper, threshold)
    if len(kept) < len(claims):
        hyper, p = engine.fit(hyper)
        excess = _excess(engine, p.theta, hyper)
    return Found(tuple(kept), tuple(left), hyper, excess)


def _form_error(scored: Scored, claims: Sequence[Claim]) -> float:
    """Evidence on the same rows that an earlier claim's imperfect law may have left over."""
    mine = set(scored.candidate.joints)
    touching = [c.score for c in claims if not mine or not c.joints or mine & set(c.joints)]
    return FORM_ERROR * max(touching, default=0.0)


def _settle(engine: Engine, near: Sequence[Scored], hyper: Hyper) -> tuple[Scored, Candidate, Hyper, Projection]:
    """Among contenders of nearly equal score, the one with which the whole model, refitted, is most likely."""
    best: tuple[float, Scored, Candidate, Hyper, Projection] | None = None
    for s in near:
        sharp = _sharpened(engine, s, hyper)
        candidate = engine.add(sharp.candidate.effect, sharp.candidate.joints, sharp.candidate.shapes)
        assert candidate is not None
        engine.active.append(candidate)
        h, p = engine.fit(hyper)
        value = engine.evidence(h)
        engine.active.pop()
        if best is None or value > best[0]:
            best = (value, s, candidate, h, p)
    assert best is not None
    return best[1:]


def _needed(engine: Engine, claims: Sequence[Claim], hyper: Hyper, threshold: float) -> list[Claim]:
    """The claims that still stand when tried against all the others; what a later one made needless is dropped."""
    kept = list(claims)
    claimed = [c.scored.candidate for c in claims]
    known = [c for c in engine.active if not any(c is x for x in claimed)]
    for claim in claims[:-1]:
        others = [c.scored.candidate for c in kept if c is not claim]
        engine.active = known + others
        again = engine.scores([claim.scored.candidate], hyper)[0]
        if again.score < threshold:
            kept.remove(claim)
        else:
            kept[kept.index(claim)] = replace(claim, scored=replace(again, score=claim.score))
    engine.active = known + [c.scored.candidate for c in kept]
    return kept


def _excess(engine: Engine, theta: Array, hyper: Hyper) -> tuple[float, ...]:
    view = engine._view()
    return tuple(view.excess(j, theta, hyper.sigma[j], hyper.kappa[j]) for j in range(engine.data.n))


def _refined(engine: Engine, scored: Sequence[Scored], hyper: Hyper) -> list[Scored]:
    """The best distinct contenders with their shapes refined, best first."""
    contenders: dict[tuple[str, tuple[int, ...]], Scored] = {}
    for s in scored:
        if len(contenders) < CONTENDERS and s.admissible and s.score > 0:
            contenders.setdefault(s.candidate.key, s)
    refined = [refine(engine, s, hyper) for s in contenders.values()]
    return sorted((s for s in refined if s.admissible), key=lambda s: -s.score)


def _sharpened(engine: Engine, scored: Scored, hyper: Hyper) -> Scored:
    """A delay or an elasticity once it is beyond doubt: its exact column, so that steps of the torque leave no trace."""
    effect, joints, start = scored.candidate.effect, scored.candidate.joints, scored.candidate.shapes
    if "exact" in start or (effect.enters != "input_delay" and effect.name != "elasticity"):
        return scored

    def value(shapes: Mapping[str, float]) -> Scored | None:
        return engine.score_new(effect, joints, shapes, hyper, quick=True)

    best = value({**start, "exact": 1.0})
    if best is None:
        return scored
    steps = dict.fromkeys(start, 0.4)
    while max(steps.values()) > 0.02:
        for symbol in start:
            here = best.candidate.shapes
            trials = [value({**here, symbol: here[symbol] * float(np.exp(k * steps[symbol]))}) for k in (1, -1)]
            better = [t for t in trials if t is not None and t.score > best.score]
            if better:
                best = max(better, key=lambda t: t.score)
            else:
                steps[symbol] *= 0.4
    return replace(best, score=scored.score)


def refine(engine: Engine, scored: Scored, hyper: Hyper) -> Scored:
    """Search the shapes off their grid: compass search with shrinking steps, in the logarithm (linear for the ripple's n)."""
    effect, joints, charge = scored.candidate.effect, scored.candidate.joints, scored.candidate.charge
    shapes = dict(scored.candidate.shapes)

    def value(trial: Mapping[str, float]) -> Scored | None:
        s = engine.score_new(effect, joints, trial, hyper, quick=True)
        return s if s is not None and s.admissible else None

    if "d0" in shapes:
        best = scored
        for _ in range(6):
            s = value({**shapes, "d0": 0.5 * (float(best.theta[0]) + best.candidate.shapes["d0"])})
            if s is None or abs(s.candidate.shapes["d0"]) < SHORTEST_LAG:
                break
            best = s
        shapes = dict(best.candidate.shapes)
        if not 0.7 < float(best.theta[0]) / shapes["d0"] < 1.4:
            return replace(scored, score=0.0)  # a lag that does not reproduce itself is none
    elif effect.shapes:
        best_value = value(shapes)
        steps = {p.symbol: (0.35 if effect.name == "torque_ripple" else 0.6) for p in effect.shapes}
        finest = 0.06 if "exact" in shapes else 0.02  # an exact swing costs a rigid-body pass per trial value
        while best_value is not None and max(steps.values()) > finest:
            for p in effect.shapes:
                for side in (1.0, -1.0):
                    x, h = shapes[p.symbol], side * steps[p.symbol]
                    moved = x + h if effect.name == "torque_ripple" else x * float(np.exp(h))
                    trial = {**shapes, p.symbol: float(np.clip(moved, p.lo, p.hi))}
                    s = value(trial)
                    if s is not None and s.score > best_value.score:
                        shapes, best_value = trial, s
                        break
                else:
                    steps[p.symbol] *= 0.4
    final = engine.score_new(effect, joints, shapes, hyper)
    if final is None:
        return scored
    return replace(final, score=final.score - charge, candidate=replace(final.candidate, charge=charge))


def _ripples(engine: Engine, theta: Array, hyper: Hyper, effect: Effect) -> list[Wanted]:
    """The strongest two cycles per turn in each joint's residual, beyond what chance gives."""
    out: list[Wanted] = []
    view, d = engine._view(), engine.data
    full = np.concatenate([[1.0], -theta])
    for j, rows in enumerate(engine.rows):
        k = len(rows.take)
        if k < 100:
            continue
        gram = view.grams[j]
        r = gram.residual(full[gram.index], hyper.sigma[j], hyper.kappa[j])[:k]
        q, speed = d.q[rows.take, j], d.dq[rows.take, j]
        sigma = d.kernel.dt * np.sqrt(np.sum(d.kernel.h * np.arange(-d.kernel.half, d.kernel.half + 1) ** 2))
        fade = np.exp(-0.5 * (np.abs(speed)[:, None] * RIPPLES * sigma) ** 2)
        phase = q[:, None] * RIPPLES
        s = whiten(np.sin(phase) * fade, rows.start, rows.a, rows.sd)
        c = whiten(np.cos(phase) * fade, rows.start, rows.a, rows.sd)
        ss, cc, sc = (s * s).sum(axis=0), (c * c).sum(axis=0), (s * c).sum(axis=0)
        a, b = r @ s, r @ c
        power = (cc * a * a - 2 * sc * a * b + ss * b * b) / np.maximum(ss * cc - sc * sc, 1e-9 * ss * cc + 1e-12)
        power = power / hyper.kappa[j]
        for _ in range(2):
            top = int(np.argmax(power))
            if power[top] < 2 * np.log(len(RIPPLES)):
                break
            out.append((effect, (j,), {"n": float(RIPPLES[top])}))
            power[np.abs(RIPPLES - RIPPLES[top]) < 4.0] = 0.0
    return out
