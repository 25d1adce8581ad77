"""Whether a structure gives, rather than a gear or anything else at a joint: a pedestal that rocks, a link that bends."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from stopset.effects import Effect, catalogue
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.columns.structure import Giving, Place, Spring, gears, mixed, places
from stopset.offline.diagnose.evidence.candidate import Candidate
from stopset.offline.diagnose.evidence.evidence import gain, project
from stopset.offline.diagnose.evidence.hypothesis import Hyper, Hypothesis
from stopset.offline.diagnose.search.held_out import HeldOut, held_out
from stopset.types import Array, Index

RATES = tuple(np.geomspace(8.0, 80.0, 20).tolist())  # [rad/s] at which it may swing, to begin with
LIGHTLY = 0.12  # damping to begin with, of the root of stiffness times inertia: as wide as one rate is from the next
ANGLES = tuple(
    np.radians(np.arange(0.0, 180.0, 30.0)).tolist()
)  # [rad] of the one axis that gives, to begin with; beside two alike
FEET = (0.0, 0.5)  # [m] below the arm's base at which a pedestal rocks, to begin with
BATCH = 5  # rates whose columns are held at once
NEAR = 0.5  # of the likeliest place's score, from which on one is looked at more closely
WORTH = 0.1  # of the score that what is wanted would have, from which on any is
STEPS = {
    "rate": 0.06,
    "across": 0.5,
    "damping": 0.5,
    "angle": 0.2,
    "foot": 0.2,
    "own": 0.3,
}  # of the search, first ones in the logarithm
LOGARITHMIC = ("rate", "across", "damping")
ADVICE = (
    "No model takes it (`add` cannot, and no stop bound holds on an arm that swings so): stiffen it, or measure it by an acceleration sensor there "
    "or by encoders behind the gears"
)
FINEST, TRIALS = 0.2, 80  # of these steps; trials at most
DAMPED = (0.01, 0.7)  # beyond, nothing swings


@dataclass(frozen=True, slots=True)
class Sitting:
    """A place where a structure may give: ``score`` as an effect's; its `Spring`; whether it is no structure, but a joint's ``gear``."""

    place: Place
    score: float
    spring: Spring
    moving: Array  # (N, n)
    gear: bool


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


def instead_of(now: Hypothesis, says: float, hyper: Hyper) -> Structure | None:
    """The structure that explains more by a claim's evidence than a claimed gear, whose evidence beside ``now`` is ``says``; None: none does."""
    start, p = now.fit(hyper)
    before, excess = now.evidence(start), np.array(now.excesses(p.theta, start))
    judged = [_Judged.of(now, s, start) for s in _likeliest(now, start)]
    best = max([says, *(t.evidence - before for t in judged if t.sitting.gear)])
    return _structure(
        now, [t for t in judged if not t.sitting.gear and t.evidence - before > best + limit.THRESHOLD], before, excess
    )


def of_what_is_left(now: Hypothesis, says: float, hyper: Hyper, before: HeldOut) -> Structure | None:
    """The structure that explains what ``now`` leaves: by a claim's evidence more than any gear, or than the claims, of which the best ``says``
    so much, at least `TELLING` of it, and with a lower error on motions that were not fitted; None: none does.

    ``before``: that error without it.
    """
    start, p = now.fit(hyper)
    evidence, excess = now.evidence(start), np.array(now.excesses(p.theta, start))
    wanted = limit.TELLING * sum(r.size * (1.0 - 1.0 / k) for r, k in zip(now.engine.rows, start.kappa, strict=True))
    found = _likeliest(now, start, WORTH * wanted)
    judged = [_Judged.of(now, s, start) for s in found if s.score > limit.THRESHOLD]
    best = max([says, 0.0, *(t.evidence - evidence for t in judged if t.sitting.gear)])
    sound = [
        t
        for t in judged
        if not t.sitting.gear
        and t.evidence - evidence > best + limit.THRESHOLD
        and t.explains(now, excess) > limit.TELLING
        and t.lowers(before)
    ]
    return _structure(now, sound, evidence, excess)


def _structure(now: Hypothesis, judged: list[_Judged], evidence: float, excess: Array) -> Structure | None:
    """Of places that are told beside ``now``, which alone has this ``evidence``: those that lack little of what the likeliest one explains."""
    if not judged:
        return None
    judged = sorted(judged, key=lambda t: -t.evidence)
    best = judged[0]
    judged = [t for t in judged if t.evidence - evidence > (1.0 - limit.PATTERN_SHARE) * (best.evidence - evidence)]
    joints = tuple(now.engine.data.joints[j] for j in best.mostly(excess))
    where = tuple(dict.fromkeys(t.sitting.place.where for t in judged))
    return Structure(where, joints, round(best.sitting.spring.rate / (2 * np.pi), 2), round(best.explains(now, excess), 3))


@dataclass(frozen=True, slots=True)
class _Judged:
    """A structure beside the model, all fitted again: its evidence, residual variances over noise (n,), held-out error."""

    sitting: Sitting
    evidence: float
    excess: Array
    after: HeldOut

    @staticmethod
    def of(now: Hypothesis, s: Sitting, hyper: Hyper) -> _Judged:
        wider = _beside(now, s.moving)
        fitted, p = wider.fit(hyper)
        evidence = wider.evidence(fitted) - _charge(s)
        return _Judged(s, evidence, np.array(wider.excesses(p.theta, fitted)), held_out(wider, fitted))

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
        falls = [
            1.0 - a / np.maximum(b, 1e-12) for b, a in ((before.whole, self.after.whole), (before.within, self.after.within))
        ]
        return bool(max(x.max() for x in falls) > limit.LOWERED and min(x.min() for x in falls) > -limit.LOWERED)


def _likeliest(now: Hypothesis, hyper: Hyper, least: float = 0.0) -> list[Sitting]:
    """Structures, and gears, each with its likeliest spring, of all that are not far less likely than the likeliest one of their kind; none
    where at first sight no structure has the score ``least``."""
    robot, view = now.engine.robot, _in_one_fold(now.view())
    out = []
    for gear in (False, True):
        first = [s for p in (gears(robot) if gear else places(robot)) if (s := _coarse(view, p, hyper, gear=gear)) is not None]
        best = max((s.score for s in first), default=0.0)
        if not gear and best <= least:
            return []
        out += [_climbed(view, s, hyper) for s in first if s.score > max(NEAR * best, 0.0)]
    return out


def _coarse(view: Hypothesis, place: Place, hyper: Hyper, *, gear: bool) -> Sitting | None:
    """The likeliest of all rates and axes; None where nothing stands on it."""
    best = None
    axes = [(0.0, 1.0), *((a, None) for a in ANGLES)] if len(place.axes) > 1 else [(0.0, None)]
    for foot in FEET if place.standing else FEET[:1]:
        giving = Giving.of(view.engine.source, place, foot)
        if not np.all(np.einsum("naa->na", giving.own_mass) > 0.0):
            continue
        for first in range(0, len(RATES), BATCH):
            rates = RATES[first : first + BATCH]
            S, s = _projected(view, np.concatenate([giving.parts(r, LIGHTLY) for r in rates], axis=-1), hyper)
            for k, rate in enumerate(rates):
                at = slice(3 * k, 3 * k + 3)
                for angle, across in axes:
                    score = _score(S[at, at], s[at], mixed(angle, across))
                    if best is None or score > best[0]:
                        best = score, Spring(rate, LIGHTLY, angle, across, foot)
    return None if best is None else Sitting(place, best[0], best[1], np.zeros(0), gear)


def _climbed(view: Hypothesis, s: Sitting, hyper: Hyper) -> Sitting:
    """The spring of most evidence near the one of ``s``: compass search with shrinking steps."""
    givings: dict[float, Giving] = {}
    seen: dict[Spring, tuple[float, Array]] = {}

    def value(spring: Spring) -> float:
        if spring not in seen:
            foot = spring.foot
            if foot not in givings:
                givings[foot] = Giving.of(view.engine.source, s.place, foot)
            moving = givings[foot].columns(spring)
            S, y = _projected(view, moving[..., None], hyper)
            seen[spring] = _score(S, y, np.ones(1)), moving
        return seen[spring][0]

    best, steps = s.spring, 1.0
    shapes = ["rate", "damping"]
    shapes += [] if s.spring.across is None else ["across"]
    shapes += ["angle"] if len(s.place.axes) > 1 else []
    shapes += ["foot", "own"] if s.place.standing else []
    while steps > FINEST and len(seen) < TRIALS:
        better = False
        for shape in shapes:
            top = max(_moved(best, shape, steps * STEPS[shape]), key=value, default=best)
            if value(top) > value(best):
                best, better = top, True
        if not better:
            steps *= 0.5
    return replace(s, score=value(best) - _charge(s), spring=best, moving=seen[best][1])


def _moved(s: Spring, shape: str, by: float) -> Iterator[Spring]:
    """``s`` with one shape larger, and smaller, where that is a swing that was looked for."""
    for side in (by, -by):
        x = getattr(s, shape)
        moved = replace(s, **{shape: x * float(np.exp(side)) if shape in LOGARITHMIC else x + side})
        if RATES[0] <= moved.rate <= RATES[-1] and DAMPED[0] <= moved.damping <= DAMPED[1] and min(moved.foot, moved.own) >= 0.0:
            yield moved


def _charge(s: Sitting) -> float:
    """Evidence that shapes cost beyond a gear's stiffness and damping: as much again."""
    return 0.0 if s.gear else limit.SWING_PRICE


def _projected(view: Hypothesis, moving: Array, hyper: Hyper) -> tuple[Array, Array]:
    """What is left of columns (N, n, k) after the model: sums (k, k), and with the torque (k,)."""
    wider, cols = _bordered(view, moving, rows=False)
    p = project(wider.total(hyper)[0], 0, view.nuisance, cols, view.precision(hyper), view.mean)
    return p.S, p.s


def _bordered(view: Hypothesis, moving: Array, *, rows: bool) -> tuple[Hypothesis, Index]:
    own = view.engine
    k = moving.shape[-1]
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


def _score(S: Array, s: Array, shares: Array) -> float:
    """Of a column with these ``shares`` of columns, priced and sized as a gear's, whose swing has the size that its stiffness gives it."""
    share = _gear().terms[0]
    value, theta, _ = gain((shares @ S @ shares)[None, None], (shares @ s)[None], np.array([share.typical**-2]))
    return value - limit.SWING_PRICE if 0.0 < float(theta[0]) < share.hi else -np.inf


def _beside(now: Hypothesis, moving: Array) -> Hypothesis:
    """The model with a swing of these rows (N, n) at all joints."""
    wider, cols = _bordered(now.view(), moving[..., None], rows=True)
    effect = _gear()
    return wider.plus(Candidate(effect, (), {}, cols, np.array([effect.terms[0].typical])))
