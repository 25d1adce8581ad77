"""Why a claim is none after all: numbers smaller than their own error, beyond what they can be, or at the edge of the search."""

from __future__ import annotations

from collections.abc import Mapping

from stopset.effects import Effect
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.evidence.uncertainty import BY_ROWS


def objection(
    effect: Effect,
    values: Mapping[str, float],
    std: Mapping[str, float | None],
    seconds: float,
    rotor: float = 0.0,
    shortest: float = 0.0,
) -> str:
    """Why these numbers of an effect are no finding, empty where they are; ``std``: see `deviations`.

    ``seconds``: all that was recorded; ``rotor`` [kg m^2]: what the joint's motor has without it; ``shortest`` [s]: what a lag must be longer
    than, as stamps may mean that much.
    """
    sizes = {t.symbol: (values[t.symbol], std.get(t.symbol) or 0.0) for t in effect.terms}
    # of a body its mass decides: moments and inertias without one are the description's errors in other words; of a spring its stiffness
    first = effect.terms[0]
    telling = [sizes[first.symbol]] if effect.essential else list(sizes.values())
    if all(abs(v) <= limit.SURE * s for v, s in telling if s > 0) and any(s > 0 for _, s in telling):
        said = ", ".join(f"{k} = {v:.3g} +- {s:.2g}" for k, (v, s) in sizes.items())
        which = f"its {first.means.split(',')[0]} is not" if effect.essential else "no number of it is"
        return f"{which} larger than twice its error ({said})"
    for t in effect.terms:
        v, s = sizes[t.symbol]
        if v < t.lo - limit.SURE * s or v > t.hi + limit.SURE * s:
            return f"{t.symbol} = {v:.3g} +- {s:.2g} {t.unit} is beyond what it can be ({t.lo:g} to {t.hi:g})"
    lag, by_rows = sizes[first.symbol][0], std.get(BY_ROWS) or 0.0
    if abs(lag) - limit.SURE * by_rows < shortest:  # what stamps mean is the shortest lag's own matter
        least = f"expected more than {1e3 * shortest:.2g} ms, which stamps may mean, by twice the error of its rows"
        return f"it is a lag of {1e3 * abs(lag):.2g} +- {1e3 * by_rows:.2g} ms; {least}"
    left = rotor + sizes[first.symbol][0]
    if effect.enters == "inertia" and first.unit == "kg m^2" and left <= 0.0:  # of a motor, not of a load
        return f"it would leave the joint's motor an inertia of {left:.3g} {first.unit}: what it stands for is something else"
    # a gear's swing follows from its stiffness: one that is not shown to be as large is something else that looks alike
    if effect.role == "swing" and abs(values["share"] - 1.0) + limit.SURE * sizes["share"][1] > limit.WHOLE:
        v, s = sizes["share"]
        return f"its swing is {v:.3g} +- {s:.2g} times what such a gear makes; a true one is within {limit.WHOLE:.0%} of it by twice its error"
    for p in effect.shapes:
        v = values[p.symbol]
        # a time as short as any that was asked, but for its error, is what a slow law makes of something faster; other shapes' ends are
        # limits that a true law may come near: no damping, no levelling off
        error = limit.SURE * (std.get(p.symbol) or 0.0) if p.unit == "s" else 0.0
        if v <= p.lo * (1 + limit.EDGE) + error or v >= p.hi * (1 - limit.EDGE):
            return f"{p.symbol} = {v:.3g} {p.unit} is at the end of what was searched ({p.lo:g} to {p.hi:g})"
        if p.unit == "s" and v > seconds:
            return f"{p.symbol} = {v:.3g} s is longer than the {seconds:.3g} s recorded"
    return ""


def within(effect: Effect, symbol: str, value: float) -> float:
    """A term's value moved to the nearest that it can have: beyond by its error only, the end of its range is as likely."""
    term = next((t for t in effect.terms if t.symbol == symbol), None)
    return value if term is None else min(max(value, term.lo), term.hi)
