"""The numbers of a claim: its parameters and their errors, as a model takes them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from stopset.offline.diagnose.answer import Parameter
from stopset.offline.diagnose.columns.laws import MOVING, TRANSMITTED
from stopset.offline.diagnose.evidence.candidate import Scored
from stopset.offline.diagnose.evidence.uncertainty import deviations
from stopset.offline.diagnose.evidence.weighing import weighed
from stopset.offline.diagnose.load import joints_disagree
from stopset.offline.diagnose.remainder import Left
from stopset.offline.diagnose.search.search import Claim, Found
from stopset.offline.diagnose.search.settled import added


def parameters(scored: Scored, deviation: Mapping[str, float], scale: float = 1.0) -> dict[str, Parameter]:
    """Terms, then shapes, each with its standard ``deviation``; a load is weighed in true torque, the recorded one over ``scale``."""
    c = scored.candidate
    per = scale if c.effect.carried else 1.0
    values = {t.symbol: (float(v) / per, t.unit) for t, v in zip(c.effect.terms, scored.theta, strict=True)}
    values |= {p.symbol: (float(c.shapes[p.symbol]), p.unit) for p in c.effect.shapes}
    if c.effect.enters == "input_delay" and "d0" in c.shapes:
        symbol = c.effect.terms[0].symbol
        values[symbol] = (float(c.shapes["d0"]), values[symbol][1])
    return {symbol: Parameter(v, unit, deviation.get(symbol)) for symbol, (v, unit) in values.items()}


def by_gravity(found: Found, left: Left) -> dict[int, dict[str, Parameter]]:
    """By place among the claims, the numbers of a law of all torque that a gear transmits in the form that a model has it, of gravity's."""
    now, places = found.now, [k for k, c in enumerate(found.claims) if TRANSMITTED in c.scored.candidate.shapes]
    forms = [added(now, replace(found.claims[k].scored.candidate, shapes={})) for k in places]
    for c in forms:
        now = now.instead(c).plus(added(now, replace(c, shapes={MOVING: 1.0})))
    if not forms:
        return {}
    hyper, p = now.fit(left.hyper)
    place = {column: k for k, column in enumerate(now.nuisance.tolist())}
    thetas = [p.theta[[place[k] for k in c.cols.tolist()]] for c in forms]
    std = deviations(now, hyper, p.theta, forms)
    scored = [replace(found.claims[k].scored, candidate=c, theta=x) for k, c, x in zip(places, forms, thetas, strict=True)]
    return {k: parameters(s, d) for k, s, d in zip(places, scored, std, strict=True)}


def by_all_joints(
    found: Found, left: Left, claim: Claim, numbers: Mapping[str, Parameter]
) -> tuple[Mapping[str, Parameter], str]:
    """``numbers`` of a claim; of a load against a model those that all joints say together, each of which may be off (`weighed`), and
    which of them do not agree, in words.

    Against a description alone a fit takes such shares for masses of the links, and its interval holds how far these may be off.
    """
    now, c = found.now, claim.scored.candidate
    if not (c.effect.carried and now.engine.modelled):
        return numbers, ""
    w = weighed(now, left.hyper, left.theta, c)
    disagree = {now.engine.data.joints[j]: share for j, share in w.disagreeing().items()}
    return parameters(replace(claim.scored, theta=w.theta), w.deviation), joints_disagree(disagree)
