"""How much larger than the data the sets must be, and what may honestly be promised of motions not yet seen (P8).

The independent unit is the motion.  Where there are enough, every fourth is held out, from the nominal model and the noise
too; the margin is chosen by leave-one-fold-out on the rest; violations are counted on the held-out ones.  Sets may then
still grow to enclose everything recorded: growing can only lower the chance of a violation, so the bound stays true.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln
from scipy.stats import beta

from stopset.artifact import Guarantee
from stopset.offline.conform.envelope import Envelope
from stopset.offline.conform.linear import SOLVER_SLACK, Fit
from stopset.reach.flowpipe import Responses
from stopset.sets import Box

Array = NDArray[np.float64]

CONFIDENCE = 0.95
HELD_OUT_EVERY = 4
FEWEST_MOTIONS = 8  # below, nothing can be held out and calibrated at once
FOLDS = 5
TOUCHING = 1e-3  # of the tube's width: closer than this counts as reaching it, which can only raise the bound


def clopper_pearson(violated: int, tried: int, confidence: float = CONFIDENCE) -> float:
    """Upper confidence bound of a probability from ``violated`` of ``tried`` independent trials; 1 when none was tried.

    Source: Clopper & Pearson (1934).
    """
    if violated >= tried:
        return 1.0
    return float(beta.ppf(confidence, violated + 1, tried - violated))


def scenario_bound(support: int, scenarios: int, confidence: float = CONFIDENCE) -> float | None:
    """Violation probability of sets that ``support`` of ``scenarios`` independent motions fix alone; None: no bound.

    The number of motions that fix the sets is seen only afterwards, so the bound for a number known beforehand would be
    too low: this one holds for every outcome, convex or not.  Source: Campi, Garatti & Ramponi (2018), Theorem 1.
    """
    if scenarios <= support:
        return None
    choices = gammaln(scenarios + 1) - gammaln(support + 1) - gammaln(scenarios - support + 1)
    return float(-np.expm1((np.log(1.0 - confidence) - np.log(scenarios) - choices) / (scenarios - support)))


def touching(fit: Fit, R: Responses, env: Envelope) -> bool:
    """Whether an envelope reaches the tube of ``fit``: without those that do not, the program has the same solution."""
    lo, hi = R.hull(fit.X0.lo, fit.X0.hi, fit.U.lo, fit.U.hi)
    rows = slice(1, min(env.steps, len(R.E1) - 1) + 1)
    states = slice(0, 2 * fit.U.dim if fit.conform == "all" else fit.U.dim)
    lo, hi = (lo + fit.V.lo)[rows, states], (hi + fit.V.hi)[rows, states]
    near = TOUCHING * (hi - lo) + 10 * SOLVER_SLACK
    return bool(np.any(env.hi[rows, states] >= hi - near) or np.any(env.lo[rows, states] <= lo + near))


def needed_factors(fit: Fit, R: Responses, env: Envelope, decoupled: bool) -> Array:
    """Smallest factors (n,), each >= 1, by which every joint's sets, grown about their centres, enclose ``env``.

    Joints of a coupled model reach into each other's tubes: they share one factor.
    """
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
    worst = np.maximum(above.max(axis=0), below.max(axis=0))
    n = fit.U.dim
    by_joint = np.maximum(1.0, worst[:n] if fit.conform == "position" else np.maximum(worst[:n], worst[n:]))
    return np.asarray(by_joint if decoupled else np.full(n, by_joint.max()))


def inflated(fit: Fit, factors: Array) -> Fit:
    """The fit with every joint's sets grown about their centres by its factor (n,)."""
    if np.all(factors <= 1.0):
        return fit
    both = np.concatenate([factors, factors])
    return replace(fit, X0=fit.X0.inflated(both), U=fit.U.inflated(factors), V=fit.V.inflated(both))


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


def words(g: Guarantee, trials: int, motions: int, margin: float, scope: str) -> str:
    """The guarantee in words that are true for two motions and for three hundred; ``scope``: what is predicted from where."""
    seen = f"All {trials} recorded trials of {motions} independent motion{'s' if motions != 1 else ''} are enclosed {scope}"
    if g.motions == 0 and motions >= FEWEST_MOTIONS:
        return (
            f"{seen} (margin up to {margin:.2f}). The nominal model was fitted to every motion that could have been held out: "
            "nothing statistical is promised for other motions; identify again from all recordings."
        )
    if g.motions == 0:
        return (
            f"{seen} (margin up to {margin:.2f}). With only {motions} independent motion{'s' if motions != 1 else ''} none "
            "could be held out: nothing statistical is promised for other motions; record at least eight."
        )
    text = (
        f"{seen} (margin up to {margin:.2f}). Of {g.motions} held-out motions {g.violated} left the calibrated sets: with "
        f"{g.confidence:.0%} confidence a new motion of the same kind leaves them with probability below {g.upper_bound:.1%}"
    )
    if g.scenario_bound is not None:
        text += f" (scenario bound {g.scenario_bound:.1%}, the nominal model taken as given)"
    return text + "."
