"""Objections to claims: why what explains something is no finding yet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.evidence.engine import Engine
from stopset.offline.diagnose.evidence.uncertainty import BY_ROWS, drives_scale
from stopset.offline.diagnose.evidence.weighing import Misfit, joint_shares
from stopset.offline.diagnose.explain.objection import objection
from stopset.offline.diagnose.numbers import parameters
from stopset.offline.diagnose.remainder import Left, shakes
from stopset.offline.diagnose.rows.prepare import ROW_STEP
from stopset.offline.diagnose.search.refine import shortest_lag
from stopset.offline.diagnose.search.search import Claim, Found, label
from stopset.offline.diagnose.search.settle import within_reach
from stopset.offline.diagnose.search.structures import Structure


def objections(
    found: Found, left: Left, sure: Sequence[Mapping[str, float]], structures: Mapping[int, Structure], refused: Mapping[str, str]
) -> list[str]:
    """Why each claim is no finding, in words; empty for one that may be.

    ``sure``: of each claim, the standard deviations of its numbers; ``structures``, by place among the claims, and ``refused``, by label, as
    in `Examination` and `refusing`.
    """
    engine, misfit, scale = found.now.engine, Misfit.of(found.now, left.hyper, left.theta), drives_scale(found.now, left.theta)
    seconds = float(len(engine.data.t_fine) * engine.data.kernel.dt)
    out = []
    for k, (claim, deviation) in enumerate(zip(found.claims, sure, strict=True)):
        c = claim.scored.candidate
        values = {symbol: p.value for symbol, p in parameters(claim.scored, deviation, scale).items()}
        rotor = float(engine.source.robot.rotor[c.joints[0]]) if c.joints else 0.0
        shortest = shortest_lag(engine, c.joints[0]) if BY_ROWS in deviation else 0.0
        out.append(
            _of_the_structure(structures.get(k))
            or objection(c.effect, values, deviation, seconds, rotor, shortest)
            or _of_another_joint(engine, claim)
            or _of_a_gears_form(found, claim)
            or _of_any_position(engine, claim)
            or _between_rows(claim)
            or _as_before(found, claim)
            or _of_single_joints(found, left, claim)
            or _of_the_load(found, left, misfit, claim)
            or refused.get(label(engine, claim.scored), "")
        )
    return out


def _of_the_structure(structure: Structure | None) -> str:
    """Why a gear is no finding where a ``structure`` explains more."""
    return "" if structure is None else f"a flexible structure explains more: {structure.where}"


def _of_a_gears_form(found: Found, claim: Claim) -> str:
    """Why a law claimed after a gear, of a joint that this shakes, is no finding: next to what the gear took away it takes nothing.

    What is left of a soft gear's swing is of its form, and a law of friction or of the position takes up a part of anything.
    """
    c = claim.scored.candidate
    earlier = found.claims[: found.claims.index(claim)]
    if len(c.joints) != 1 or c.effect.role == "swing":
        return ""
    (j,) = c.joints
    gears = [k.excess_before[j] - k.excess_after[j] for k in earlier if shakes(k, j)]
    share = (claim.excess_before[j] - claim.excess_after[j]) / sum(gears) if gears else np.inf
    if share > limit.PATTERN_SIZE:
        return ""
    return f"it takes away {share:.1%} of what an elastic gear took away there: what that gear's form leaves"


def _of_any_position(engine: Engine, claim: Claim) -> str:
    """Why a constant torque is no finding where its joint moved so little that any law of the position is all but constant.

    One that rests a radian away varies over `TRAVEL` by no more than a law's form may be off and still be as likely.
    """
    c = claim.scored.candidate
    if len(c.joints) != 1 or c.effect.enters != "compensation" or "stiff" in c.effect.needs:
        return ""
    j = c.joints[0]
    rows = engine.rows[j]
    torque = rows.plain(engine.columns(c.effect, c.joints, c.shapes)[j][0] @ claim.scored.theta)
    travel = float(np.ptp(rows.plain(engine.data.q[:, j])))
    if travel >= limit.TRAVEL or float(np.ptp(torque)) > limit.EDGE * float(np.abs(torque).max(initial=0.0)):
        return ""
    return (
        f"its joint moved by {travel:.2g} rad only: a spring, a cable pack, a gas spring and friction that differs between the directions look "
        "alike there"
    )


def _of_another_joint(engine: Engine, claim: Claim) -> str:
    """Why a gear whose link would swing faster than was looked for is no finding: another joint's explains nearly as much."""
    c = claim.scored.candidate
    if c.effect.role != "swing" or within_reach(engine, c):
        return ""
    others = [engine.data.joints[s.candidate.joints[0]] for s in claim.rivals if s.candidate.effect is c.effect]
    which = ", ".join(dict.fromkeys(others))
    return f"a soft gear at {which} explains nearly as much, and both swing faster than was looked for" if others else ""


def _between_rows(claim: Claim) -> str:
    """Why friction that builds up over a way is no finding where every joint that moves at all has passed that way from one row to the next.

    Rows then show none of its curve, and what a filter of the torque makes of a reversal looks like it.
    """
    c, least = claim.scored.candidate, limit.CREEP * ROW_STEP
    travels = [c.shapes[p.symbol] for p in c.effect.shapes if p.unit == "rad" and c.effect.states]
    if not travels or min(travels) >= least:
        return ""
    return f"its way of {min(travels):.2g} rad is passed from one row to the next at any speed that is asked ({least:.2g} rad)"


def _as_before(found: Found, claim: Claim) -> str:
    """Why a claim is none: the model leaves no more of the joints that it explains than it left of its own recordings.

    What a model could not explain when it was identified is still there, and no change; but what is more than its own recordings held beside
    their sensors' noise is new, however little of all that is left it is.  A gear explains what it shakes, too.
    """
    engine, c = found.now.engine, claim.scored.candidate
    at = c.joints or tuple(np.flatnonzero(np.array(claim.excess_before) > np.array(claim.excess_after)).tolist())
    at = (*at, *(j for j in range(engine.data.n) if shakes(claim, j)))
    explained = np.array(claim.excess_before) - np.array(claim.excess_after)
    if at and all(engine.as_before[j] and explained[j] <= engine.hidden_before[j] for j in at):
        return "the model leaves no more there than it left of its own recordings, so it is no change since"
    return ""


def _of_single_joints(found: Found, left: Left, claim: Claim) -> str:
    """Why a law of the whole arm is no finding: that each joint has a share of its own is as sure as an effect must be that is named, and one is
    off by twice what a law's form is ever taken to be off.

    Its number is one for all joints, however it came about; of a load they may disagree by their drives (`weighed`).
    """
    c = claim.scored.candidate
    if c.joints or c.effect.carried:
        return ""
    gain, shares = joint_shares(found.now, left.hyper, left.theta, c)
    if gain < limit.THRESHOLD or max(map(abs, shares.values())) < limit.SURE * limit.FORMS[-1]:
        return ""
    each = ", ".join(
        f"{found.now.engine.data.joints[j]} {1.0 + s:.2g}" for j, s in sorted(shares.items(), key=lambda x: -abs(x[1]))[:2]
    )
    return f"the joints do not agree on it (times what they say together: {each}; score {gain:.0f}): what it explains is of each by itself"


def _of_the_load(found: Found, left: Left, misfit: Misfit | None, claim: Claim) -> str:
    """Why a claim beside a load is no finding: what the load's own torque may be off by explains most of what it is claimed for."""
    c = claim.scored.candidate
    if misfit is None or c.effect.carried:
        return ""
    alone, beside = misfit.leaves(found.now, left.hyper, c)
    if beside >= limit.TELLING * alone:
        return ""
    return (
        f"what the load's torque may be off by at single joints explains most of it (score {max(beside, 0.0):.0f} beside that, {alone:.0f} "
        "where the load is taken to be told exactly)"
    )
