"""Shapes searched off their grid: the best contenders refined, and a claimed elasticity made exact."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.evidence.candidate import Candidate, EffectKey, Scored
from stopset.offline.diagnose.evidence.engine import Engine
from stopset.offline.diagnose.evidence.hypothesis import Hyper, Hypothesis
from stopset.offline.diagnose.evidence.scores import score_new
from stopset.offline.diagnose.side_by_side import side_by_side

FINEST_LAG = 4e-4  # [s]


def refined(now: Hypothesis, scored: Sequence[Scored], hyper: Hyper) -> list[Scored]:
    """The best distinct contenders of ``scored`` (best first) with their shapes refined, best first.

    What refining leaves nothing of takes no other's place: a lag of the grid may look likely at every joint and turn out to be none.
    An elastic gear shakes its neighbours: each joint's may lie between two stiffnesses of the grid, and each is refined before one is believed.
    """
    distinct = dict[EffectKey, Scored]()
    for s in scored:
        if s.score > 0 and (s.admissible or _out_of_step(s)):
            distinct.setdefault(s.candidate.key, s)
    waiting, finer = deque(distinct.values()), list[Scored]()
    while waiting and len(finer) < limit.CONTENDERS:
        batch = [waiting.popleft() for _ in range(min(len(waiting), limit.CONTENDERS - len(finer)))]
        finer += [s for s in side_by_side(lambda s: refine(now, s, hyper), batch) if s.score > 0]
    return sorted((s for s in finer if possible(now.engine, s)), key=lambda s: -s.score)


def possible(engine: Engine, s: Scored) -> bool:
    """Within its range; friction that builds up after a reversal is part of its joint's own, dry and viscous together: short motions
    hardly tell the two from each other, and what builds up makes the first fit's dry part small."""
    c = s.candidate
    return s.admissible and (not c.effect.within_friction or s.theta[0] < limit.BUILT_UP * engine.level(c.joints[0]))


def _out_of_step(s: Scored) -> bool:
    """An elasticity between two stiffnesses of the grid: out of step with the true swing its own explains a part only."""
    return s.candidate.effect.role == "swing" and not s.admissible and float(s.theta[0]) > 0


def sharpened(now: Hypothesis, scored: Scored, hyper: Hyper) -> Candidate:
    """An elasticity once it is certain: its exact column, so that steps of the torque leave no trace."""
    c = scored.candidate
    return c if c.effect.role != "swing" or "exact" in c.shapes else _climbed(now, c, "exact", 0.4, hyper)


def begun(now: Hypothesis, elasticity: Candidate, hyper: Hyper) -> Candidate:
    """An elasticity that has been claimed, with the swings that its trials began with."""
    return _climbed(now, elasticity, "begun", 0.06 if "begun" in elasticity.shapes else 0.16, hyper)


def _climbed(now: Hypothesis, c: Candidate, how: str, step: float, hyper: Hyper) -> Candidate:
    """The stiffness and damping of most evidence when the column is made as ``how`` says; ``step``: how far off they may be."""

    def value(shapes: Mapping[str, float]) -> Scored | None:
        return score_new(now, c.effect, c.joints, shapes, hyper, quick=True)

    best = value({**c.shapes, how: 1.0})
    if best is None:
        return c
    steps, enough = {"K": step, "D": 2.5 * step}, {"K": 0.01, "D": 0.06}  # damping matters less
    while any(steps[symbol] > enough[symbol] for symbol in steps):
        for symbol in steps:
            here = best.candidate.shapes
            trials = side_by_side(value, [{**here, symbol: here[symbol] * float(np.exp(k * steps[symbol]))} for k in (1, -1)])
            better = [t for t in trials if t is not None and t.score > best.score]
            if better:
                best = max(better, key=lambda t: t.score)
            else:
                steps[symbol] *= 0.4
    return best.candidate


def _shifted(now: Hypothesis, start: Scored, hyper: Hyper) -> float:
    """The lag of most evidence near the one of ``start``, to half a millisecond; the stamps would take a share of it."""
    c = start.candidate
    held = replace(now, held=(int(now.engine.stamps[c.joints[0]]),))
    seen: dict[float, float] = {}

    def value(lag: float) -> float:
        lag = round(lag, 6)
        if lag not in seen:
            s = score_new(held, c.effect, c.joints, {"d0": lag}, hyper, quick=True) if lag else None
            seen[lag] = s.score if s is not None else -np.inf
        return seen[lag]

    best, step = c.shapes["d0"], 0.008
    while step > FINEST_LAG:
        better = max((best + step, best - step), key=value)
        if value(better) > value(best):
            best = better
        else:
            step *= 0.5
    return best


def shortest_lag(engine: Engine, joint: int) -> float:
    """[s] of a joint's torque, below which a drive holds or averages it within its stamps."""
    return max(limit.SHORTEST_LAG, float(engine.prior_sd[engine.stamps[joint]]))


def refine(now: Hypothesis, scored: Scored, hyper: Hyper) -> Scored:
    """Search the shapes off their grid: compass search with shrinking steps, in the logarithm (linear for the ripple's n)."""
    effect, joints, charge = scored.candidate.effect, scored.candidate.joints, scored.candidate.charge
    shapes = dict(scored.candidate.shapes)

    def value(trial: Mapping[str, float]) -> Scored | None:
        s = score_new(now, effect, joints, trial, hyper, quick=True)
        return s if s is not None and (possible(now.engine, s) or _out_of_step(s)) else None

    if "d0" in shapes:
        shapes = {"d0": _shifted(now, scored, hyper)}
        if abs(shapes["d0"]) < shortest_lag(now.engine, joints[0]):
            return replace(scored, score=0.0)
    elif effect.shapes:
        best_value = value(shapes)
        steps = {p.symbol: (0.35 if effect.periodic else 0.6) for p in effect.shapes}
        finest = 0.06 if "exact" in shapes else 0.02  # an exact swing costs a rigid-body pass per trial value
        while best_value is not None and max(steps.values()) > finest:
            for p in effect.shapes:
                for side in (1.0, -1.0):
                    x, h = shapes[p.symbol], side * steps[p.symbol]
                    moved = x + h if effect.periodic else x * float(np.exp(h))
                    trial = {**shapes, p.symbol: float(np.clip(moved, p.lo, p.hi))}
                    s = value(trial)
                    if s is not None and s.score > best_value.score:
                        shapes, best_value = trial, s
                        break
                else:
                    steps[p.symbol] *= 0.4
    final = score_new(now, effect, joints, shapes, hyper)
    if final is None:
        return scored
    return replace(final, score=final.score - charge, candidate=replace(final.candidate, charge=charge))
