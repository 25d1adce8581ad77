"""From deviations to the sets of one regime: envelopes by motion, linear program, margin, guarantee, influence.

Sets are fitted on the motions in use, grown by the calibrated margin, and then, if need be, a little more so that
everything recorded is enclosed.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from stopset.artifact import Guarantee, UncertaintySets
from stopset.errors import NotConformant
from stopset.offline.campaign.calibration import FEWEST_MOTIONS, HELD_OUT_EVERY, Split, split
from stopset.offline.campaign.trials import Pairs
from stopset.offline.conform import guarantee as g
from stopset.offline.conform.envelope import Deviations, Envelope
from stopset.offline.conform.linear_program import FittedSets, fit_sets
from stopset.offline.conform.problem import SetProblem
from stopset.offline.conform.zonotopes import Template
from stopset.reach.flowpipe import Responses
from stopset.recording import Recording
from stopset.sets import Box
from stopset.types import Array

T = TypeVar("T")


BOX = "box, same directions"  # beside a zonotope: the narrowest box where the zonotope is the narrowest


@dataclass(frozen=True, slots=True)
class ConformedSets:
    """Sets and guarantee of one regime, and what was found on the way.

    ``table``: the two cases of Table II and the variants beside them, name -> fit; ``influence``: motion -> relative
    change of each joint's U width when that motion is left out.
    """

    sets: UncertaintySets
    other: UncertaintySets  # the other case of Table II: position only, or all states
    guarantee: Guarantee
    margins: Array  # (n,) calibrated factor of each joint
    table: Mapping[str, FittedSets]
    influence: Mapping[int, tuple[float, ...]]
    cost: float
    notes: tuple[str, ...] = field(default=())


@dataclass(frozen=True, slots=True)
class Gathered:
    """What one pass over the trials leaves: envelopes by motion, from the trials' starts, and of even and odd repetitions.

    ``bands``: temperature band -> motion -> envelope, where bands were asked for.
    """

    parts: dict[int, Envelope]
    start: Envelope
    halves: tuple[Envelope, Envelope]
    bands: dict[int, dict[int, Envelope]] = field(default_factory=dict)

    def merge(self, later: Gathered) -> Gathered:
        """Both together; ``later`` holds trials that come after this one's, so that ties keep the first."""
        halves = (self.halves[0].merge(later.halves[0]), self.halves[1].merge(later.halves[1]))
        bands = {
            k: _merged(self.bands.get(k, {}), later.bands.get(k, {})) for k in sorted(self.bands.keys() | later.bands.keys())
        }
        return Gathered(_merged(self.parts, later.parts), self.start.merge(later.start), halves, bands)

    def mapped(self, envelope: Callable[[Envelope], Envelope], motion: Mapping[int, int] | None = None) -> Gathered:
        """Every envelope changed, and those of motions with the same new number merged."""

        def by_motion(parts: dict[int, Envelope]) -> dict[int, Envelope]:
            out: dict[int, Envelope] = {}
            for m, env in parts.items():
                out = _merged(out, {m if motion is None else motion[m]: envelope(env)})
            return out

        halves = (envelope(self.halves[0]), envelope(self.halves[1]))
        bands = {k: by_motion(parts) for k, parts in self.bands.items()}
        return Gathered(by_motion(self.parts), envelope(self.start), halves, bands)


def _merged(a: dict[int, Envelope], b: dict[int, Envelope]) -> dict[int, Envelope]:
    out = dict(a)
    for m, env in b.items():
        out[m] = out[m].merge(env) if m in out else env
    return dict(sorted(out.items()))


def divided(motions: Iterable[int], learnt: Collection[int]) -> Split:
    """Every fourth motion held out, but none of those that the nominal model was fitted to (``learnt``)."""
    ordered = sorted(motions)
    held = tuple(m for m in split(ordered).held if m not in learnt)
    return Split(tuple(m for m in ordered if m not in held), held)


def gather(
    pairs: Pairs, problem: SetProblem, *, halves: bool, bands: Callable[[Recording], Iterable[int]] | None = None
) -> Gathered:
    """One pass over ``pairs``: running envelopes in constant memory.

    ``halves``: even and odd repetitions too; ``bands``: temperature bands a trial belongs to.
    """
    template = problem.template
    main = Deviations(
        problem.abstraction, problem.dt, problem.steps, problem.options.windows, None if template is None else template.directions
    )
    from_start = Deviations(problem.abstraction, problem.dt, problem.steps, "start")
    out = Gathered({}, from_start.empty(), (main.empty(), main.empty()))
    for motion, r, u in pairs():
        from_start.add(out.start, r, u)
        into = [out.halves[r.repetition % 2]] if halves else []
        for parts in (out.parts, *(out.bands.setdefault(k, {}) for k in (() if bands is None else bands(r)))):
            into.append(parts.setdefault(motion, main.empty()))
        main.add_to(into, r, u)
    return out.mapped(lambda env: env)


def conform(
    found: Gathered, problem: SetProblem, trials: int, learnt: Collection[int] = (), unseen: float | None = None
) -> ConformedSets:
    """Identify ``X0``, ``U``, ``V`` of a linear abstraction from what was gathered up to the horizon.

    ``trials``: how many were; ``learnt``: motions that cannot be held out, because a nominal model that was given was fitted
    to them; ``unseen``: the factor that parts of a motion asked for when they were left out, where nothing else tells it.
    """
    options, alone = problem.options, problem.abstraction.decoupled
    R = problem.responses()
    parts = found.parts
    division = divided(parts, learnt)
    used = {m: parts[m] for m in division.used}
    everything = g.union(list(parts.values()))
    together = g.union(list(used.values()))
    whole = problem.asking("all")
    V = fit_sets(together, R, whole).V
    cases = {"all": whole, "position": problem.asking("position").reading(V)}  # positions alone say nothing of velocity readings

    def fitted(envelopes: Sequence[Envelope], case: str = options.conform) -> FittedSets:
        env = g.union(list(envelopes))
        fit = fit_sets(env, R, cases[case])
        return fit if problem.template is None else enclosing(fit, R, env, decoupled=alone)  # its program sees some of the ages

    fit = fitted(list(used.values()))
    factors, how, notes = _margin(found.halves, problem, used, fitted, R, unseen)
    chosen = np.full(len(problem.joints), options.margin) if options.margin is not None else factors
    grown = fit.inflated(chosen)
    violated = sum(bool(np.any(g.needed_factors(grown, R, parts[m], decoupled=alone) > 1.0)) for m in division.held)
    final = enclosing(grown, R, everything, decoupled=alone)
    extra = float((final.inputs.width / np.maximum(grown.inputs.width, 1e-12)).max())
    if extra > 1.0 + 1e-6:
        notes.append(f"grown by up to another {extra - 1:.1%} after the check so that held-out motions are enclosed too")
    fixing = [m for m, env in used.items() if g.touching(fit, R, env)]
    promise = Guarantee(
        motions=len(division.held), violated=violated, upper_bound=g.clopper_pearson(violated, len(division.held)),
        confidence=g.CONFIDENCE, text="", calibration_motions=len(division.used),
        scenario_bound=g.scenario_bound(len(fixing), len(used)),
    )  # fmt: skip
    what = "in position and velocity" if options.conform == "all" else "in position"
    where = "every sample" if options.windows == "sliding" else "each trial's start only"
    scope = f"{what} up to {everything.steps * problem.dt:.2f} s ahead of {where}"
    promise = replace(promise, text=g.words(promise, trials, len(parts), float(chosen.max()), how, scope))

    def packed(f: FittedSets) -> UncertaintySets:
        return UncertaintySets(
            X0=f.X0, U=f.U, V=f.V, dt=problem.dt, horizon=everything.steps * problem.dt, conform=f.conform,
            windows=options.windows, margin=float(chosen.max()), active=f.active, zonotope=f.zonotope,
        )  # fmt: skip

    other = "position" if options.conform == "all" else "all"
    second = fitted(list(used.values()), other)
    table = {options.conform: fit, other: second} | _variants(found.start, problem, R)
    if problem.template is not None:
        table[BOX] = _in_a_box(together, cases[options.conform])
        notes.append(
            "the torque set is a zonotope: comparison and monitor use its own tube; stops and FMU take the box around it, "
            "which is never narrower"
        )
    companion = packed(enclosing(second.inflated(chosen), R, everything, decoupled=alone))
    return ConformedSets(
        packed(final), companion, promise, factors, table, influence(used, fitted, fit, fixing), fit.cost, tuple(notes)
    )


def few_motions(used: int) -> bool:
    """Whether there are too few motions (after holding out) to calibrate a margin across them."""
    return used < FEWEST_MOTIONS - FEWEST_MOTIONS // HELD_OUT_EVERY


def enclosing(fit: FittedSets, R: Responses, env: Envelope, *, decoupled: bool) -> FittedSets:
    """``fit`` grown until it encloses ``env`` in floating point (the closed-form factors are exact but for rounding).

    Raises `NotConformant` if growing does not help: nothing may be called enclosed that is not.
    """
    out = fit
    for _ in range(50):
        left = g.needed_factors(out, R, env, decoupled=decoupled)
        if np.all(left <= 1.0):
            return out
        if not np.all(np.isfinite(left)):
            break
        out = out.inflated(np.where(left > 1.0, np.maximum(left, 1.0 + 1e-10), 1.0))
    raise NotConformant(
        f"no growth of the sets encloses all recordings (a factor of {left.max():.3g} would be needed); expected deviations "
        "of one order of magnitude: look for a broken trial with `stopset inspect`"
    )


def _margin(
    halves: tuple[Envelope, Envelope], problem: SetProblem, used: dict[int, Envelope],
    fitted: Callable[[Sequence[Envelope]], FittedSets], R: Responses, unseen: float | None,
) -> tuple[Array, str, list[str]]:  # fmt: skip
    """The factor of each joint that sets fitted without a part of the data need to enclose that part, worst over all parts.

    And how it came about, in the guarantee's words, and notes.
    """
    options, n, alone = problem.options, problem.abstraction.n, problem.abstraction.decoupled
    if options.margin is not None:
        return np.full(n, options.margin), g.GIVEN, []
    if not few_motions(len(used)):
        keys = sorted(used)
        folds = [keys[k :: g.FOLDS] for k in range(g.FOLDS)]
        factors = np.ones(n)
        for fold in folds:
            rest = [used[m] for m in keys if m not in fold]
            left = g.union([used[m] for m in fold])
            factors = np.maximum(factors, g.needed_factors(fitted(rest), R, left, decoupled=alone))
        return factors, g.OTHER_MOTIONS, [f"margin from {len(folds)} folds over {len(keys)} motions: {_range(factors)}"]
    if not all(h.labels for h in halves):
        if unseen is not None:
            return np.full(n, unseen), g.SAME_MOTION, []
        return (
            np.ones(n),
            g.NO_REPETITION,
            ["no repetition to calibrate a margin on: the sets are those of these trials alone"],
        )
    needed = [g.needed_factors(fitted([halves[a]]), R, halves[1 - a], decoupled=alone) for a in (0, 1)]
    factors = np.maximum(*needed)
    note = f"too few motions to calibrate across them: margin {_range(factors)} is that between repetitions (even, odd)"
    return factors, g.REPETITIONS, [note]


def _range(factors: Array) -> str:
    return f"{factors.min():.2f} to {factors.max():.2f} by joint" if np.ptp(factors) > 0.005 else f"{factors.max():.2f}"


def _variants(start: Envelope, problem: SetProblem, R: Responses) -> dict[str, FittedSets]:
    """What the paper's own definition gives on the same data: from the trial's start, with and without the noise set."""
    if problem.template is not None:
        problem = replace(problem, template=None)
        R = problem.responses()
    whole = problem.asking("all")
    none = whole.reading(Box.symmetric(np.zeros(problem.readings.dim)))
    return {
        "start, all": fit_sets(start, R, whole),
        "start, all, no noise set": fit_sets(start, R, none, capped=False),
        "start, position, no noise set": fit_sets(start, R, none.asking("position"), capped=False),
    }


def _in_a_box(env: Envelope, problem: SetProblem) -> FittedSets:
    """The narrowest box in the directions in which a zonotope is the narrowest."""
    assert problem.template is not None
    box = replace(problem, template=Template(np.eye(problem.abstraction.n), problem.template.directions))
    R = box.responses()
    return enclosing(fit_sets(env, R, box), R, env, decoupled=problem.abstraction.decoupled)


def influence(
    used: Mapping[int, T],
    fitted: Callable[[list[T]], FittedSets],
    fit: FittedSets,
    fixing: Collection[int] | None = None,
    most: int = 64,
) -> dict[int, tuple[float, ...]]:
    """Leave one motion out: relative change of each joint's U width; nothing where there are more than ``most``.

    ``fixing``: the motions that reach the tube (None: any may); without another one the program has the same solution.
    """
    if not 2 <= len(used) <= most:
        return {}
    out = {}
    for m in used:
        alters = fixing is None or m in fixing
        rest = fitted([data for k, data in used.items() if k != m]) if alters else fit
        out[m] = tuple((rest.U.width / np.maximum(fit.U.width, 1e-12) - 1.0).tolist())
    return out
