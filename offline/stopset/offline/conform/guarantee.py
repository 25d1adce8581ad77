"""How much larger than the data the sets must be, and what may honestly be promised of motions not yet seen (P8).

The independent unit is the motion.  Where there are enough, every fourth is held out, from the nominal model and the noise
too; the margin is chosen by leave-one-fold-out on the rest; violations are counted on the held-out ones.  Sets may then
still grow to enclose everything recorded: growing can only lower the chance of a violation, so the bound stays true.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import betaincinv, gammaln

from stopset.artifact import Guarantee
from stopset.offline.campaign.calibration import FEWEST_MOTIONS
from stopset.offline.conform.envelope import Envelope
from stopset.offline.conform.linear_program import FittedSets
from stopset.offline.conform.program import SOLVER_SLACK
from stopset.reach.flowpipe import Responses
from stopset.sets import Box
from stopset.types import Array
from stopset.words import many

CONFIDENCE = 0.95
FOLDS = 5
TOUCHING = 1e-3  # of the tube's width: closer than this counts as reaching it, which can only raise the bound


def clopper_pearson(violated: int, tried: int, confidence: float = CONFIDENCE) -> float:
    """Upper confidence bound of a probability from ``violated`` of ``tried`` independent trials; 1 when none was tried.

    Source: Clopper & Pearson (1934).
    """
    if violated >= tried:
        return 1.0
    return float(betaincinv(violated + 1, tried - violated, confidence))


def scenario_bound(support: int, scenarios: int, confidence: float = CONFIDENCE) -> float | None:
    """Violation probability of sets that ``support`` of ``scenarios`` independent motions fix alone; None: no bound.

    The number of motions that fix the sets is seen only afterwards, so the bound for a number known beforehand would be
    too low: this one holds for every outcome, convex or not.  Source: Campi, Garatti & Ramponi (2018), Theorem 1.
    """
    if scenarios <= support:
        return None
    choices = gammaln(scenarios + 1) - gammaln(support + 1) - gammaln(scenarios - support + 1)
    return float(-np.expm1((np.log(1.0 - confidence) - np.log(scenarios) - choices) / (scenarios - support)))


def touching(fit: FittedSets, R: Responses, env: Envelope) -> bool:
    """Whether an envelope reaches the tube of ``fit``: without those that do not, the program has the same solution."""
    lo, hi = R.tube(fit.X0, fit.inputs, fit.V)
    rows = slice(1, min(env.steps, len(R.E1) - 1) + 1)
    states = slice(0, lo.shape[1] if fit.conform == "all" else lo.shape[1] // 2)
    lo, hi = lo[rows, states], hi[rows, states]
    near = TOUCHING * (hi - lo) + 10 * SOLVER_SLACK
    return bool(np.any(env.hi[rows, states] >= hi - near) or np.any(env.lo[rows, states] <= lo + near))


def needed_factors(fit: FittedSets, R: Responses, env: Envelope, *, decoupled: bool) -> Array:
    """Smallest factors (n,), each >= 1, by which every joint's sets, grown about their centres, enclose ``env``.

    Joints of a coupled model, or of a zonotope, reach into each other's tubes: they share one factor.
    """
    along = np.maximum(1.0, reached(fit, R, env))
    return np.asarray(along if decoupled and fit.template is None else np.full(fit.X0.dim // 2, along.max()))


def reached(fit: FittedSets, R: Responses, env: Envelope) -> Array:
    """(n,) the largest share of its tube's half width, about the centre, that ``env`` reaches at each joint (or direction)."""
    last = min(env.steps, len(R.E1) - 1)
    rows = slice(1, last + 1)
    c_lo, c_hi = (x[rows] for x in R.tube(*(Box.point(b.centre) for b in (fit.X0, fit.inputs, fit.V))))
    lo, hi = (x[rows] for x in R.tube(fit.X0, fit.inputs, fit.V))
    seen_hi, seen_lo = env.hi[rows], env.lo[rows]
    with np.errstate(divide="ignore", invalid="ignore"):
        above = np.where(seen_hi > c_hi, (seen_hi - c_hi) / (hi - c_hi), 0.0)
        below = np.where(seen_lo < c_lo, (c_lo - seen_lo) / (c_lo - lo), 0.0)
    worst = np.maximum(above.max(axis=0), below.max(axis=0))
    k = len(worst) // 2
    return np.asarray(worst[:k] if fit.conform == "position" else np.maximum(worst[:k], worst[k:]))


def union(parts: Sequence[Envelope]) -> Envelope:
    """Envelope of all parts together."""
    out = parts[0]
    for p in parts[1:]:
        out = out.merge(p)
    return out


GIVEN, OTHER_MOTIONS, REPETITIONS, SAME_MOTION, NO_REPETITION = (
    "as given",
    "calibrated on motions left out in turn",
    "calibrated on repetitions of the same motions only",
    "calibrated on parts of the same motions left out in turn",
    "not calibrated, for nothing is repeated",
)


def words(g: Guarantee, trials: int, motions: int, margin: float, how: str, scope: str) -> str:
    """The guarantee in words that are true for two motions and for three hundred.

    ``how`` the margin came about: `GIVEN`, `OTHER_MOTIONS`, `REPETITIONS`, `SAME_MOTION` or `NO_REPETITION`; ``scope``: what is predicted
    from where.
    """
    moved = many(motions, "independent motion")
    all_of = f"All {trials} recorded trials of {moved} are" if trials != 1 else "The one recorded trial is"
    seen = f"{all_of} enclosed {scope} (margin up to {margin:.2f}, {how})."
    if g.motions == 0 and motions >= FEWEST_MOTIONS:
        return (
            f"{seen} The nominal model was fitted to every motion that could have been held out: nothing statistical is promised "
            "for other motions; identify again from all recordings."
        )
    if g.motions == 0:
        return (
            f"{seen} With only {moved} none could be held out: nothing statistical is promised for "
            "other motions; record at least eight."
        )
    held = f"{seen} Of {many(g.motions, 'held-out motion')} {g.violated} left the sets with this margin"
    if g.upper_bound >= 1.0:
        return f"{held}: nothing statistical can be promised for other motions; look for what differs in them, or record more."
    text = (
        f"{held}: with {g.confidence:.0%} confidence a new motion, drawn as these were, leaves them with probability of at most "
        f"{_upward(g.upper_bound)}"
    )
    if g.scenario_bound is not None:
        text += f" (scenario bound {_upward(g.scenario_bound)}, the nominal model taken as given)"
    return text + "."


def _upward(probability: float) -> str:
    """In percent with one decimal, never less than it is."""
    return f"{np.ceil(probability * 1e3 - 1e-9) / 10:.1f}%"
