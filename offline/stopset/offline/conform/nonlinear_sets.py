"""From trials to the sets of one regime for a nonlinear abstraction: fit, margin, guarantee, in the manner of
`sets.conform`.

The windows of a nonlinear model cannot be folded into one envelope.  So sets and margin are found on trials kept in
memory, at most `KEEP`, evenly over the campaign and every motion among them; then all trials pass by once more, a few at a
time, held-out motions are judged, and the sets grow until every window that was looked at is enclosed.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from stopset.artifact import Abstraction, Guarantee, UncertaintySets
from stopset.offline.abstraction.grid import GRID, Trial, coarser
from stopset.offline.campaign.calibration import split
from stopset.offline.campaign.trials import Pairs
from stopset.offline.conform import guarantee as g
from stopset.offline.conform import nonlinear as along
from stopset.offline.conform.linear_program import FittedSets
from stopset.offline.conform.linear_sets import ConformedSets, few_motions, influence
from stopset.offline.conform.monotone_sets import fit_cooperative, needed_factor
from stopset.offline.conform.problem import Options, SetProblem
from stopset.progress import Progress, silent
from stopset.reach.nonlinear import predicted_tube
from stopset.recording import Recording
from stopset.types import Array

KEEP = 400
TOGETHER = 64  # trials in memory at a time in the check of all
MOST_LEFT_OUT = 8  # motions: each that is left out costs a fit of its own
# factors are found to this; what lies within it of being enclosed is rounding
TOLERANCE = 1e-3


@dataclass(frozen=True, slots=True)
class Algorithm:
    """How one abstraction's sets are found and checked, on trials already on the sets' grid of ``dt`` [s]."""

    problem: SetProblem
    labels: dict[int, str]  # of the trials by the identity of their states
    remembered: dict[tuple[int, ...], list[along.DeviationWindow]] = field(default_factory=dict)

    def fit(self, trials: Sequence[Trial], conform: str) -> FittedSets:
        """Cheapest sets that enclose these trials, with what fixes them."""
        titles = [self.labels[id(x)] for x, _ in trials]
        asked = self.problem.asking(conform)
        if asked.abstraction.decoupled:
            return fit_cooperative(trials, asked, titles)[0]
        return along.fit_windows(self._windows(trials), asked, titles)[0]

    def needed(self, fit: FittedSets, trials: Sequence[Trial]) -> float:
        """Smallest factor (>= 1) about the sets' centres that encloses these trials."""
        if self.problem.abstraction.decoupled:
            return needed_factor(fit, trials, self.problem)
        return max(1.0, *(along.needed(w, fit) for w in self._windows(trials)))

    def checked(self, fits: Sequence[FittedSets], trials: Sequence[Trial], where: Sequence[tuple[int, int]]) -> Array:
        """The same of several sets at once, in constant memory, from the starts ``where`` (all of them for decoupled joints)."""
        if self.problem.abstraction.decoupled:
            return np.array([self.needed(fit, trials) for fit in fits])
        worst = np.ones(len(fits))
        for w in along.windows_of(trials, self.problem, where):
            worst = np.maximum(worst, [along.needed(w, fit) for fit in fits])
        return worst

    def _windows(self, trials: Sequence[Trial]) -> list[along.DeviationWindow]:
        """Windows of these trials: those of all trials of which these are most, or windows of their own.

        The first set of trials and the latest are remembered, for they are asked for again and again.
        """
        key = tuple(id(x) for x, _ in trials)
        for ids, windows in self.remembered.items():
            if 2 * len(key) >= len(ids) and set(key) <= set(ids):
                place = {ids.index(x): k for k, x in enumerate(key)}
                return [replace(w, trial=place[w.trial]) for w in windows if w.trial in place]
        where = along.starts(trials, self.problem.options.windows, along.WINDOWS)
        if len(self.remembered) >= 2:
            self.remembered.popitem()
        self.remembered[key] = list(along.windows_of(trials, self.problem, where))
        return self.remembered[key]


def conform_nonlinear(
    pairs: Pairs, problem: SetProblem, trials: int, progress: Progress = silent, unseen: float | None = None
) -> ConformedSets:
    """Identify ``X0``, ``U``, ``V`` of any abstraction from the so many trials of ``pairs``; ``progress`` is given how long it takes.

    The sets' grid may be coarser than the problem's; ``unseen`` as in `stopset.offline.conform.linear_sets.conform`.  Raises `NotConformant`.
    """
    begun = time.monotonic()
    abstraction, options, dt = problem.abstraction, problem.options, problem.dt
    retained, lengths = _retained(pairs, trials)
    every = 1 if abstraction.decoupled else max(1, round(GRID / dt))
    data = {m: coarser([t for t, _ in rows], every) for m, rows in retained.items()}
    labels = {id(x): name for m, rows in retained.items() for (x, _), (_, name) in zip(data[m], rows, strict=True)}
    longest = max(len(x) for rows in data.values() for x, _ in rows) - 1
    grid = dt * every
    steps = min(round(problem.horizon / grid), longest)
    algorithm = Algorithm(replace(problem, dt=grid, horizon=steps * grid), labels)
    division = split(list(data))
    used = [t for m in division.used for t in data[m]]
    other = "position" if options.conform == "all" else "all"
    fit, second = algorithm.fit(used, options.conform), algorithm.fit(used, other)
    rest = (time.monotonic() - begun) * (g.FOLDS + len(division.held) + 1)  # as many windows each
    progress(f"sets of {len(division.used)} motions found; margin and check, about {rest:.0f} s to go")
    margin, how, notes = _margin(algorithm, data, division.used, options, unseen)
    chosen = options.margin if options.margin is not None else margin
    grown, companion = fit.inflated(chosen), second.inflated(chosen)
    seen, stride = len(lengths), along.stride_of(sum((N - 1) // every for N in lengths), along.WINDOWS)
    left, starts = _left(pairs, algorithm, (grown, companion), every, stride, division.held)
    violated = sum(bool(left[m][0] > 1.0 + TOLERANCE) for m in division.held)
    extra, more = np.max(list(left.values()), axis=0)
    # a held-out motion may lie outside by the tolerance and not be counted: the sets that are promised include it
    final = grown.inflated(max(float(extra) * (1.0 + 1e-9), 1.0 + TOLERANCE if division.held else 1.0))
    if extra > 1.0 + TOLERANCE:
        notes.append(f"grown by another {extra - 1:.1%} after the check so that all trials, held-out ones too, are enclosed")
    if (few := sum(map(len, data.values()))) < seen:
        notes.append(
            f"sets of model {abstraction.kind} and their margin were found on {few} of {seen} trials, evenly over the campaign; all "
            "trials were checked against them"
        )
    promise = Guarantee(
        motions=len(division.held), violated=violated, upper_bound=g.clopper_pearson(violated, len(division.held)),
        confidence=g.CONFIDENCE, text="", calibration_motions=len(division.used), scenario_bound=None,
    )  # fmt: skip
    what = "in position and velocity" if options.conform == "all" else "in position"
    scope = f"{what} up to {steps * grid:.2f} s ahead of {_scope(abstraction, options, starts)}"
    promise = replace(promise, text=g.words(promise, seen, len(data), float(chosen), how, scope))

    def packed(f: FittedSets) -> UncertaintySets:
        return UncertaintySets(f.X0, f.U, f.V, grid, steps * grid, f.conform, options.windows, float(chosen), f.active)

    def refitted(rest: list[list[Trial]]) -> FittedSets:
        return algorithm.fit([t for rows in rest for t in rows], options.conform)

    alone = influence({m: data[m] for m in division.used}, refitted, fit, most=MOST_LEFT_OUT)
    return ConformedSets(
        packed(final), packed(companion.inflated(float(more) * (1.0 + 1e-9))), promise, np.full(abstraction.n, margin),
        {options.conform: fit, other: second}, alone, fit.cost, tuple(notes),
    )  # fmt: skip


def _left(
    pairs: Pairs, algorithm: Algorithm, fits: Sequence[FittedSets], every: int, stride: int, held: Collection[int]
) -> tuple[dict[int, Array], int]:
    """What encloses each motion still asks of the sets, one factor each; and of how many window starts.

    All trials pass by, at most `TOGETHER` in memory.  The starts are those that `compare` looks at, and many more in
    the motions held out.
    """
    out: dict[int, Array] = {}
    waiting: dict[int, list[tuple[int, Trial]]] = {}

    def settle() -> int:
        count = 0
        for m, rows in waiting.items():
            data = coarser([t for _, t in rows], every)
            where = [
                (k, s)
                for k, ((place, _), (x, _)) in enumerate(zip(rows, data, strict=True))
                for s in along.starts_in(place, len(x), algorithm.problem.options.windows, stride)
            ]
            if m in held:
                where = sorted({*where, *along.starts(data, algorithm.problem.options.windows, along.WINDOWS)})
            out[m] = np.maximum(out.get(m, 1.0), algorithm.checked(fits, data, where))
            count += len(where)
        waiting.clear()
        return count

    starts = 0
    for place, (motion, r, u) in enumerate(pairs()):
        waiting.setdefault(motion, []).append((place, (np.hstack([r.q, r.dq]), np.asarray(u))))
        if place % TOGETHER == TOGETHER - 1:
            starts += settle()
    return out, starts + settle()


def _scope(abstraction: Abstraction, options: Options, starts: int) -> str:
    if options.windows == "start":
        return "each trial's start only"
    return "every sample" if abstraction.decoupled else f"{starts} starts spread over the recordings"


def _retained(pairs: Pairs, trials: int) -> tuple[dict[int, list[tuple[Trial, str]]], list[int]]:
    """Trials with their labels by motion, thinned evenly to about `KEEP`; the first of every motion stays.

    And the number of samples of every trial.
    """
    stride = max(1, -(-trials // KEEP))
    out: dict[int, list[tuple[Trial, str]]] = {}
    lengths = []
    for k, (motion, r, u) in enumerate(pairs()):
        lengths.append(len(r.t))
        if motion not in out or k % stride == 0:
            out.setdefault(motion, []).append(((np.hstack([r.q, r.dq]), np.asarray(u)), r.label))
    return dict(sorted(out.items())), lengths


def _margin(
    algorithm: Algorithm, data: dict[int, list[Trial]], used: Sequence[int], options: Options, unseen: float | None
) -> tuple[float, str, list[str]]:
    """The factor that sets fitted without a part of the data need to enclose that part, worst over all parts."""
    if options.margin is not None:
        return options.margin, g.GIVEN, []

    def worst(parts: Sequence[list[Trial]], rest: Callable[[int], list[Trial]]) -> float:
        return max(algorithm.needed(algorithm.fit(rest(k), options.conform), part) for k, part in enumerate(parts))

    if not few_motions(len(used)):
        folds = [list(used)[k :: g.FOLDS] for k in range(g.FOLDS)]
        parts = [[t for m in fold for t in data[m]] for fold in folds]
        factor = worst(parts, lambda k: [t for i, part in enumerate(parts) if i != k for t in part])
        return factor, g.OTHER_MOTIONS, [f"margin from {len(folds)} folds over {len(used)} motions: {factor:.2f}"]
    halves = [[t for m in used for t in data[m][k::2]] for k in (0, 1)]
    if not all(halves):
        if unseen is not None:
            return unseen, g.SAME_MOTION, []
        return 1.0, g.NO_REPETITION, ["no repetition to calibrate a margin on: the sets are those of these trials alone"]
    factor = worst(halves, lambda k: halves[1 - k])
    return (
        factor,
        g.REPETITIONS,
        [f"too few motions to calibrate across them: margin {factor:.2f} is that between repetitions (even, odd)"],
    )


class Excess(NamedTuple):
    """The worst reading of one trial outside its predicted tube; ``half``: the tube's half-width there."""

    start: int
    age: int
    state: int
    above: bool
    size: float
    half: float


def worst_excess(abstraction: Abstraction, sets: UncertaintySets, trial: Trial, starts: Iterable[int]) -> Excess | None:
    """The reading of a trial furthest outside its predicted tube (in half-widths) over these window starts, None if none is.

    ``trial`` on the sets' grid.  A decoupled model, whose every start was identified on, may be checked at evenly spread
    ones.
    """
    n, steps = abstraction.n, round(sets.horizon / sets.dt)
    worst: Excess | None = None
    x, u = trial
    for s in starts:
        last = min(steps, len(x) - 1 - s)
        lo, hi = predicted_tube(abstraction, sets, x[s], u[s : s + last])
        seen = x[s : s + last + 1]
        states = slice(0, 2 * n if sets.conform == "all" else n)
        half = np.maximum(0.5 * (hi - lo)[1:, states], 1e-12)
        above, below = (seen - hi)[1:, states], (lo - seen)[1:, states]
        relative = np.maximum(above, below) / half
        age, state = np.unravel_index(int(np.argmax(relative)), relative.shape)
        size = float(max(above[age, state], below[age, state]))
        if size > 0.0 and (worst is None or size / half[age, state] > worst.size / worst.half):
            up = bool(above[age, state] >= below[age, state])
            worst = Excess(s, int(age) + 1, int(state), up, size, float(half[age, state]))
    return worst


def thinned(r: Recording, u: Array, every: int) -> tuple[Recording, Array]:
    """A trial and its input on the sets' grid, every so many samples of its own, as `coarser` does it."""
    (x, mean) = coarser([(np.hstack([r.q, r.dq]), u)], every)[0]
    at, n = slice(0, (len(x) - 1) * every + 1, every), r.q.shape[1]
    temp = None if r.temp is None else r.temp[at]
    coarse = replace(
        r, t=r.t[at], q=x[:, :n], dq=x[:, n:], tau=r.tau[at], temp=temp, current=None, q_link=None, stop_trigger=None
    )
    return coarse, mean
