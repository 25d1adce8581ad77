"""From deviations to the sets of one regime: envelopes by motion, linear program, margin, guarantee, influence.

Sets are fitted on the motions in use, grown by the calibrated margin, and then, if need be, a little more so that
everything recorded is enclosed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from stopset.artifact import Abstraction, Guarantee, UncertaintySets
from stopset.offline.conform import guarantee as g
from stopset.offline.conform.envelope import Deviations, Envelope
from stopset.offline.conform.linear import Fit, fit_sets
from stopset.reach.flowpipe import Responses, responses
from stopset.recording import Recording
from stopset.sets import Box

Array = NDArray[np.float64]
Pairs = Callable[[], Iterable[tuple[int, Recording, Array]]]  # (motion, trial on the grid, its input u), anew per call


@dataclass(frozen=True, slots=True)
class Options:
    """How the sets are asked for. ``margin`` None: calibrated; else the factor itself."""

    conform: str = "all"
    windows: str = "sliding"
    margin: float | None = None


@dataclass(frozen=True, slots=True)
class Conformance:
    """Sets and guarantee of one regime, and what was found on the way.

    ``table``: the two cases of Table II and the variants beside them, name -> fit; ``influence``: motion -> relative
    change of each joint's U width when that motion is left out.
    """

    sets: UncertaintySets
    other: UncertaintySets  # the other case of Table II: position only, or all states
    guarantee: Guarantee
    margin_found: float
    table: Mapping[str, Fit]
    influence: Mapping[int, tuple[float, ...]]
    cost: float
    notes: tuple[str, ...] = field(default=())


def collect(pairs: Pairs, deviations: Deviations, motions: Iterable[int]) -> dict[int, Envelope]:
    """Envelope of every motion, in one pass."""
    parts = {m: deviations.empty() for m in motions}
    for motion, r, u in pairs():
        deviations.add(parts[motion], r, u)
    return parts


def conform(
    pairs: Pairs, motions: Sequence[int], abstraction: Abstraction, joints: tuple[str, ...], noise: Box, dt: float,
    horizon: float, options: Options, trials: int,
) -> Conformance:  # fmt: skip
    """Identify ``X0``, ``U``, ``V`` of a linear abstraction over all ``motions`` up to ``horizon`` [s]."""
    steps = round(horizon / dt)
    R = responses(abstraction, dt, steps)
    parts = collect(pairs, Deviations(abstraction, dt, steps, options.windows), motions)
    division = g.split(list(parts))
    used = {m: parts[m] for m in division.used}
    everything = g.union(list(parts.values()))
    V = fit_sets(g.union(list(used.values())), R, noise, abstraction, joints, "all").V

    def fitted(envelopes: Sequence[Envelope], case: str = options.conform) -> Fit:
        base = V if case == "position" else noise
        return fit_sets(g.union(list(envelopes)), R, base, abstraction, joints, case)

    fit = fitted(list(used.values()))
    factor, notes = _margin(pairs, abstraction, dt, steps, options, used, fitted, R)
    chosen = options.margin if options.margin is not None else factor
    grown = g.inflated(fit, chosen)
    needed = {m: g.needed_factor(grown, R, parts[m]) for m in division.held}
    violated = sum(f > 1.0 for f in needed.values())
    extra = max([1.0, *needed.values(), g.needed_factor(grown, R, everything)])
    final = _enclosing(grown, extra, R, everything)
    if extra > 1.0 + 1e-9:
        notes.append(f"grown by another {extra - 1:.1%} after the check so that held-out motions are enclosed too")
    promise = Guarantee(
        motions=len(division.held), violated=violated, upper_bound=g.clopper_pearson(violated, len(division.held)),
        confidence=g.CONFIDENCE, text="", calibration_motions=len(division.used),
        scenario_bound=g.scenario_bound(len(fit.active), len(division.used)),
    )  # fmt: skip
    promise = replace(promise, text=g.words(promise, trials, len(parts), chosen, 0))

    def packed(f: Fit) -> UncertaintySets:
        return UncertaintySets(
            X0=f.X0, U=f.U, V=f.V, dt=dt, horizon=everything.steps * dt, conform=f.conform, windows=options.windows,
            margin=chosen, active=f.active,
        )  # fmt: skip

    other = "position" if options.conform == "all" else "all"
    second = fitted(list(used.values()), other)
    table = {options.conform: fit, other: second}
    table |= _variants(pairs, abstraction, joints, dt, steps, motions, noise, R)
    grown = g.inflated(second, chosen)
    companion = packed(_enclosing(grown, g.needed_factor(grown, R, everything), R, everything))
    return Conformance(packed(final), companion, promise, factor, table, _influence(used, fitted, fit), fit.cost, tuple(notes))


def _enclosing(fit: Fit, factor: float, R: Responses, env: Envelope) -> Fit:
    """``fit`` grown until it encloses ``env`` in floating point (the closed-form factor is exact but for rounding)."""
    out = g.inflated(fit, factor)
    for _ in range(20):
        left = g.needed_factor(out, R, env)
        if left <= 1.0:
            return out
        out = g.inflated(out, left * (1.0 + 1e-12) if left > 1.0 + 1e-9 else 1.0 + 1e-9)
    return out


def _margin(
    pairs: Pairs, abstraction: Abstraction, dt: float, steps: int, options: Options, used: dict[int, Envelope],
    fitted: Callable[[Sequence[Envelope]], Fit], R: Responses,
) -> tuple[float, list[str]]:  # fmt: skip
    """The factor that sets fitted without a part of the data need to enclose that part, worst over all parts."""
    if options.margin is not None:
        return options.margin, []
    if len(used) >= g.FEWEST_MOTIONS - g.FEWEST_MOTIONS // g.HELD_OUT_EVERY:
        keys = sorted(used)
        folds = [keys[k :: g.FOLDS] for k in range(g.FOLDS)]
        factors = []
        for fold in folds:
            rest = [used[m] for m in keys if m not in fold]
            factors.append(g.needed_factor(fitted(rest), R, g.union([used[m] for m in fold])))
        return max(factors), [f"margin from {len(folds)} folds over {len(keys)} motions: {max(factors):.2f}"]
    deviations = Deviations(abstraction, dt, steps, options.windows)
    halves = [deviations.empty(), deviations.empty()]
    count: dict[tuple[str, int], int] = {}
    for _, r, u in pairs():
        k = count.get(r.motion, 0)
        count[r.motion] = k + 1
        deviations.add(halves[k % 2], r, u)
    if min(len(h.labels) for h in halves) < 2:
        return 1.0, ["one trial only: no margin could be calibrated"]
    factors = [g.needed_factor(fitted([halves[a]]), R, halves[1 - a]) for a in (0, 1)]
    note = f"too few motions to calibrate across them: margin {max(factors):.2f} is that between repetitions (even, odd)"
    return max(factors), [note]


def _variants(
    pairs: Pairs, abstraction: Abstraction, joints: tuple[str, ...], dt: float, steps: int, motions: Sequence[int],
    noise: Box, R: Responses,
) -> dict[str, Fit]:  # fmt: skip
    """What the paper's own definition gives on the same data: from the trial's start, with and without the noise set."""
    start = g.union(list(collect(pairs, Deviations(abstraction, dt, steps, "start"), motions).values()))
    none = Box.symmetric(np.zeros_like(noise.hi))
    return {
        "start, all": fit_sets(start, R, noise, abstraction, joints, "all"),
        "start, all, no noise set": fit_sets(start, R, none, abstraction, joints, "all", capped=False),
        "start, position, no noise set": fit_sets(start, R, none, abstraction, joints, "position", capped=False),
    }


def _influence(used: dict[int, Envelope], fitted: Callable[[Sequence[Envelope]], Fit], fit: Fit) -> dict[int, tuple[float, ...]]:
    """Leave one motion out: relative change of each joint's U width."""
    if not 2 <= len(used) <= 64:
        return {}
    out = {}
    for m in used:
        rest = fitted([env for k, env in used.items() if k != m])
        out[m] = tuple((rest.U.width / np.maximum(fit.U.width, 1e-12) - 1.0).tolist())
    return out
