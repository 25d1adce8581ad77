"""Whether a structure gives, rather than a gear or anything else at a joint: a pedestal that rocks, a link that bends."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from stopset.effects import Effect, catalogue
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.columns.structure import Giving, Place, Spring, gears, places
from stopset.offline.diagnose.evidence.candidate import Candidate
from stopset.offline.diagnose.evidence.evidence import gains, project
from stopset.offline.diagnose.evidence.hypothesis import Hyper, Hypothesis
from stopset.offline.diagnose.search.held_out import HeldOut, held_out
from stopset.offline.diagnose.side_by_side import side_by_side
from stopset.types import Array, Index

RATES = tuple(np.geomspace(8.0, 80.0, 12).tolist())  # [rad/s] at which it may swing, to begin with
LIGHTLY = 0.2  # damping to begin with, of the root of stiffness times inertia: as wide as one rate is from the next
ANGLES = tuple(np.radians(np.arange(0.0, 180.0, 45.0)).tolist())  # [rad] of the axis about which a link bends, to begin with
FEET = (0.0, 0.5)  # [m] below the arm's base at which a pedestal rocks, to begin with
NEAR = 0.7  # of the likeliest place's score, from which on one is looked at more closely
WORTH = 0.1  # of the score that what is wanted would have, from which on any is
STEPS = {"rate": 0.06, "damping": 0.5, "angle": 0.2, "foot": 0.2}  # of the search, first ones; of a logarithm where `LOGARITHMIC`
LOGARITHMIC = ("rate", "damping")
FINEST, ROUNDS = 0.2, 24  # of these steps; steps at most
DAMPED = (0.01, 0.7)  # beyond, nothing swings
ADVICE = (
    "No model takes it (`add` cannot, and no stop bound holds on an arm that swings so): stiffen it, or measure it by an acceleration sensor there "
    "or by encoders behind the gears"
)


@dataclass(frozen=True, slots=True)
class Structure:
    """What a structure that gives would explain: where it ``may_sit_at`` in words, likeliest first; by the likeliest of them the joints whose
    leftover it is mostly, the frequency [Hz] of its swing with what it carries, and the share of what all joints left that it ``explains``."""

    may_sit_at: tuple[str, ...]
    joints: tuple[str, ...]
    hertz: float
    explains: float

    @property
    def where(self) -> str:
        """Where it may sit, in words."""
        return f"a pedestal that rocks or a link that bends (it may sit at {' or at '.join(self.may_sit_at)})"

    @property
    def telling(self) -> bool:
        """Whether it explains what one cause must that is told of an answer where something is left."""
        return self.explains > limit.TELLING

    @property
    def says(self) -> str:
        """What it would explain, and what to do, in words."""
        explained = f"swinging at {self.hertz:.3g} Hz it explains {self.explains:.0%} of what is left"
        return f"a flexible structure may be it: {self.where}; {explained}. {ADVICE}"

    def as_json(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "may_sit_at": list(self.may_sit_at),
            "joints": list(self.joints),
            "hertz": self.hertz,
            "explains": self.explains,
            "says": self.says,
        }


def explaining(now: Hypothesis, says: float, hyper: Hyper, least: float = 0.0) -> Structure | None:
    """The structure that explains what ``now`` leaves more, by a claim's evidence, than a claim that ``says`` so much, and than any joint's gear;
    None: none does, or at first sight none has the score ``least``."""
    start, p = now.fit(hyper)
    evidence, excess = now.evidence(start), np.array(now.excesses(p.theta, start))
    robot, view = now.engine.robot, _in_one_fold(now.view())

    def judged(those: list[Place], least: float, price: float) -> list[Refitted]:
        found = _likeliest(view, those, start, least)
        return sorted((Refitted.of(now, s, start, evidence + price) for s in found), key=lambda x: -x.says)

    better = [x for x in judged(places(robot), least, limit.SWING_PRICE) if x.says > says + limit.THRESHOLD]
    if not better or not better[0].lowers(held_out(now, start)):
        return None
    says = max([says, *(x.says for x in judged(gears(robot), 0.0, 0.0))])
    best = better[0]
    if best.says <= says + limit.THRESHOLD:
        return None
    alike = [x for x in better if x.says > max((1.0 - limit.PATTERN_SHARE) * best.says, says + limit.THRESHOLD)]
    where = tuple(dict.fromkeys(x.sitting.place.where for x in alike))
    joints = tuple(now.engine.data.joints[j] for j in best.mostly(excess))
    return Structure(where, joints, round(best.sitting.spring.rate / (2 * np.pi), 2), round(best.explains(now, excess), 3))


def of_what_is_left(now: Hypothesis, says: float, hyper: Hyper) -> Structure | None:
    """The structure that explains most of what ``now`` leaves, and more than the best claim, which ``says`` so much; None: none does."""
    wanted = limit.TELLING * sum(r.size * (1.0 - 1.0 / k) for r, k in zip(now.engine.rows, hyper.kappa, strict=True))
    found = explaining(now, says, hyper, WORTH * wanted)
    return found if found is not None and found.telling else None


@dataclass(frozen=True, slots=True)
class Sitting:
    """A place where a structure, or a gear, may give, with its likeliest `Spring`, whose columns (N, n) ``moving`` score so."""

    score: float
    place: Place
    spring: Spring
    moving: Array


@dataclass(frozen=True, slots=True)
class Refitted:
    """A structure beside the model, all fitted again: the evidence that it adds, residual variances over noise (n,), the fit."""

    sitting: Sitting
    says: float
    excess: Array
    wider: Hypothesis
    fitted: Hyper

    @staticmethod
    def of(now: Hypothesis, s: Sitting, hyper: Hyper, evidence: float) -> Refitted:
        """``evidence``: without it."""
        wider, cols = _bordered(now.view(), s.moving[..., None], rows=True)
        gear = _gear()
        wider = wider.plus(Candidate(gear, (), {}, cols, np.array([gear.terms[0].typical])))
        fitted, p = wider.fit(hyper)
        return Refitted(s, wider.evidence(fitted) - evidence, np.array(wider.excesses(p.theta, fitted)), wider, fitted)

    def explains(self, now: Hypothesis, before: Array) -> float:
        """Share of what all joints left together, beyond their noise, where a model does not leave as much of its own recordings."""
        size = np.where(now.engine.as_before, 0.0, [float(r.size) for r in now.engine.rows])
        return float(size @ (before - self.excess) / max(float(size @ np.maximum(before - 1.0, 0.0)), 1e-9))

    def mostly(self, before: Array) -> list[int]:
        """Joints of which it takes away a good part of what is not noise."""
        falls = before - self.excess
        return np.flatnonzero((before > limit.SENSORS) & (falls > limit.TELLING * (before - 1.0))).tolist()

    def lowers(self, before: HeldOut) -> bool:
        """Whether it lowers the held-out error of some joint as an effect must, and of none raises it so."""
        after = held_out(self.wider, self.fitted)
        falls = 1.0 - np.stack([after.whole, after.within]) / np.maximum([before.whole, before.within], 1e-12)
        return bool(falls.max() > limit.LOWERED and falls.min() > -limit.LOWERED)


def _likeliest(view: Hypothesis, those: list[Place], hyper: Hyper, least: float) -> list[Sitting]:
    """Each with its likeliest spring, of all that are not far less likely than the likeliest one; none where none has the score ``least``."""
    first = [s for s in side_by_side(lambda place: _coarse(view, place, hyper), those) if s is not None]
    best = max((s.score for s in first), default=0.0)
    found = side_by_side(lambda s: _climbed(view, s, hyper), [s for s in first if s.score > max(NEAR * best, least)])
    best = max((s.score for s in found), default=0.0)
    return [s for s in found if s.score > (1.0 - limit.PATTERN_SHARE) * best]


def _coarse(view: Hypothesis, place: Place, hyper: Hyper) -> Sitting | None:
    """The likeliest of all rates, axes and feet; None where nothing stands on it."""
    at = _giving(view, place)
    best: Sitting | None = None
    for angle, foot in product(ANGLES if place.crossing else (0.0,), FEET if place.standing else (0.0,)):
        springs = [Spring(rate, LIGHTLY, angle, foot) for rate in RATES]
        giving = at(springs[0])
        if giving.stands:
            moving = np.stack([giving.columns(s) for s in springs], axis=-1)
            scores = _scores(view, moving, hyper)
            top = int(np.argmax(scores))
            if best is None or scores[top] > best.score:
                best = Sitting(float(scores[top]), place, springs[top], moving[..., top])
    return best


def _climbed(view: Hypothesis, s: Sitting, hyper: Hyper) -> Sitting:
    """The spring of most evidence near the one of ``s``: one step at a time, of which each is shorter where none leads up."""
    at, steps, rounds = _giving(view, s.place), 1.0, ROUNDS
    shapes = ["rate", "damping", *["angle"] * s.place.crossing, *["foot"] * s.place.standing]
    while steps > FINEST and rounds:
        rounds -= 1
        beside = [x for shape in shapes for x in _moved(s.spring, shape, steps * STEPS[shape])]
        moving = np.stack([at(x).columns(x) for x in beside], axis=-1)
        scores = _scores(view, moving, hyper)
        top = int(np.argmax(scores))
        if scores[top] > s.score:
            s = Sitting(float(scores[top]), s.place, beside[top], moving[..., top])
        else:
            steps *= 0.5
    return s


def _moved(s: Spring, shape: str, by: float) -> Iterator[Spring]:
    """``s`` with one shape larger, and smaller, where that is a swing that was looked for."""
    for side in (by, -by):
        x = getattr(s, shape)
        moved = replace(s, **{shape: x * float(np.exp(side)) if shape in LOGARITHMIC else x + side})
        if RATES[0] <= moved.rate <= RATES[-1] and DAMPED[0] <= moved.damping <= DAMPED[1] and moved.foot >= 0.0:
            yield moved


def _giving(view: Hypothesis, place: Place) -> Callable[[Spring], Giving]:
    """What gives at a place with a spring's axis and foot; what its chain is asked for is kept."""
    stored: dict[float, Giving] = {}

    def at(s: Spring) -> Giving:
        if s.foot not in stored:
            first = s.foot in FEET  # at which every hypothesis begins
            stored[s.foot] = view.engine.giving(place, s.foot) if first else Giving.of(view.engine.source, place, s.foot)
        return stored[s.foot].crossed(s.angle) if place.crossing else stored[s.foot]

    return at


def _scores(view: Hypothesis, moving: Array, hyper: Hyper) -> Array:
    """(k,) of columns (N, n, k) each by itself, priced and sized as a gear's, whose swing has the size that its stiffness gives it."""
    wider, cols = _bordered(view, moving, rows=False)
    p = project(wider.total(hyper)[0], 0, view.nuisance, cols, view.precision(hyper), view.mean)
    share = _gear().terms[0]
    value, theta, _ = gains(np.diag(p.S)[:, None, None], p.s[:, None], np.full((len(cols), 1), share.typical**-2))
    return np.where((theta[:, 0] > 0.0) & (theta[:, 0] < share.hi), value - limit.SWING_PRICE, -np.inf)


def _bordered(view: Hypothesis, moving: Array, *, rows: bool) -> tuple[Hypothesis, Index]:
    """The model with swings of these rows (N, n, k) at all joints, and their columns."""
    own, k = view.engine, moving.shape[-1]
    cols = np.arange(own.size, own.size + k)
    grams = [
        g.bordered(r.column(moving[:, j]), cols, rows=rows) for j, (g, r) in enumerate(zip(own.grams, own.rows, strict=True))
    ]
    return replace(view, engine=replace(own, grams=grams, size=own.size + k)), cols


def _in_one_fold(view: Hypothesis) -> Hypothesis:
    """The same for scores alone, which are of all rows: hundreds of columns are held against them."""
    grams = [
        replace(g, G=g.G.sum(axis=0, keepdims=True), row_fold=np.zeros_like(g.row_fold), trial_fold=np.zeros_like(g.trial_fold))
        for g in view.engine.grams
    ]
    return replace(view, engine=replace(view.engine, grams=grams))


def _gear() -> Effect:
    return next(e for e in catalogue().values() if e.role == "swing")
