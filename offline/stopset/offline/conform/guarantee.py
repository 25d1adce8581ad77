"""How much larger than the data the sets must be, and what may honestly be promised of motions not yet seen (P8).

The independent unit is the motion.  Where there are enough, every fourth is held out; the margin is chosen by
leave-one-fold-out on the rest; violations are counted on the held-out ones.  Sets may then still grow to enclose
everything recorded: growing can only lower the chance of a violation, so the bound stays true.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.stats import beta, binom

from stopset.artifact import Guarantee
from stopset.offline.conform.envelope import Envelope
from stopset.offline.conform.linear import Fit
from stopset.reach.flowpipe import Responses
from stopset.sets import Box

Array = NDArray[np.float64]

CONFIDENCE = 0.95
HELD_OUT_EVERY = 4
FEWEST_MOTIONS = 8  # below, nothing can be held out and calibrated at once
FOLDS = 5


def clopper_pearson(violated: int, tried: int, confidence: float = CONFIDENCE) -> float:
    """Upper confidence bound of a probability from ``violated`` of ``tried`` independent trials; 1 when none was tried.

    Source: Clopper & Pearson (1934).
    """
    if violated >= tried:
        return 1.0
    return float(beta.ppf(confidence, violated + 1, tried - violated))


def scenario_bound(support: int, scenarios: int, confidence: float = CONFIDENCE) -> float | None:
    """Violation probability that ``support`` bounds fixed by ``scenarios`` independent motions stay below; None: no bound.

    Source: Campi & Garatti (2008), Theorem 1.
    """
    if scenarios <= support:
        return None
    left = 1.0 - confidence

    def excess(eps: float) -> float:
        return float(binom.cdf(support - 1, scenarios, eps)) - left

    return float(brentq(excess, 1e-12, 1.0 - 1e-12))


def needed_factor(fit: Fit, R: Responses, env: Envelope) -> float:
    """Smallest factor (>= 1) by which ``fit``'s sets, grown about their centres, enclose the envelope ``env``."""
    last = min(env.steps, len(R.E1) - 1)
    rows = slice(1, last + 1)

    def tube(X0: Box, U: Box, V: Box) -> tuple[Array, Array]:
        lo, hi = R.hull(X0.lo, X0.hi, U.lo, U.hi)
        return (lo + V.lo)[rows], (hi + V.hi)[rows]

    c_lo, c_hi = tube(Box.point(fit.X0.centre), Box.point(fit.U.centre), Box.point(fit.V.centre))
    lo, hi = tube(fit.X0, fit.U, fit.V)
    seen_hi, seen_lo = env.hi[rows], env.lo[rows]
    with np.errstate(divide="ignore", invalid="ignore"):
        above = np.where(seen_hi > c_hi, (seen_hi - c_hi) / (hi - c_hi), 0.0)
        below = np.where(seen_lo < c_lo, (c_lo - seen_lo) / (c_lo - lo), 0.0)
    promised = slice(None) if fit.conform == "all" else slice(0, fit.U.dim)
    return float(max(1.0, above[:, promised].max(), below[:, promised].max()))


def inflated(fit: Fit, factor: float) -> Fit:
    """The fit with every set grown about its centre."""
    if factor <= 1.0:
        return fit
    return replace(fit, X0=fit.X0.inflated(factor), U=fit.U.inflated(factor), V=fit.V.inflated(factor))


def union(parts: Sequence[Envelope]) -> Envelope:
    """Envelope of all parts together."""
    out = parts[0]
    for p in parts[1:]:
        out = out.merge(p)
    return out


@dataclass(frozen=True, slots=True)
class Split:
    """Motions for fitting and calibrating, and held out."""

    used: tuple[int, ...]
    held: tuple[int, ...]


def split(motions: Sequence[int]) -> Split:
    """Every fourth motion held out where there are at least `FEWEST_MOTIONS`."""
    ordered = sorted(motions)
    if len(ordered) < FEWEST_MOTIONS:
        return Split(tuple(ordered), ())
    held = tuple(ordered[HELD_OUT_EVERY - 1 :: HELD_OUT_EVERY])
    return Split(tuple(m for m in ordered if m not in held), held)


def words(g: Guarantee, trials: int, motions: int, margin: float, recordings_violated: int) -> str:
    """The guarantee in words that are true for two motions and for three hundred."""
    seen = f"All {trials} recorded trials of {motions} independent motion{'s' if motions != 1 else ''} are enclosed"
    if recordings_violated:
        seen = f"{recordings_violated} of {trials} recorded trials of {motions} independent motions leave the sets"
    if g.motions == 0:
        return (
            f"{seen} (margin {margin:.2f}). With only {motions} independent motion{'s' if motions != 1 else ''} none could be "
            "held out: nothing statistical is promised for other motions; record at least eight."
        )
    text = (
        f"{seen} (margin {margin:.2f}). Of {g.motions} held-out motions {g.violated} left the calibrated sets: with "
        f"{g.confidence:.0%} confidence a new motion of the same kind leaves them with probability below {g.upper_bound:.1%}"
    )
    if g.scenario_bound is not None:
        text += f" (scenario bound {g.scenario_bound:.1%})"
    return text + "."


def calibrated_margin(folds: Mapping[int, Envelope], fits: Mapping[int, Fit], R: Responses) -> float:
    """Largest factor any fold needs on the sets that were fitted without it."""
    return max(needed_factor(fits[k], R, env) for k, env in folds.items())
