"""Which laws of friction a joint has beside Coulomb and viscous, by the error on what was not fitted.

Joints share masses, so laws cannot be judged joint by joint from nothing: first the laws that the arm as a whole asks for are found
(every subset of them, at all joints), then laws of single joints are taken in and out as long as that lowers the error: each must lower the
product of all joints' held-out torque errors by a stated share.  Held out are whole motions where there are enough, else
blocks of time with a guard interval.  One pass over the recordings is enough: everything is answered from
the sums.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from stopset.effects.selection import base, usual
from stopset.offline.campaign.hold_out import FOLDS, blocks
from stopset.offline.nominal.delay import joint_reduced, lag_weights
from stopset.offline.nominal.fit import assemble, problem_of, residual
from stopset.offline.nominal.nominal import Nominal, solve_nominal
from stopset.offline.nominal.normal_equations import GROUPS, NormalEquations, accumulate
from stopset.offline.nominal.preprocess import Preprocessing
from stopset.recording.types import Recording
from stopset.robot import Robot
from stopset.types import Array

GAINS = 0.02  # share by which a law must lower the held-out torque error, joints taken together
LOADS = 2  # times that the load is computed anew
NEVER = 1e12  # times a column's own weight: what is not part of a model stays zero


Places = dict[tuple[int, str], NDArray[np.intp]]  # (joint, law) -> its columns among all parameters


@dataclass(frozen=True, slots=True)
class Gain:
    """A law at a joint, with the held-out torque error [N m] of that joint ``before`` and ``after`` it was taken."""

    effect: str
    joint: str
    before: float
    after: float

    @property
    def name(self) -> str:
        return f"{self.effect}:{self.joint}"

    @property
    def says(self) -> str:
        return (
            f"{self.name} was chosen by evidence: held-out torque error {self.before:.3g} -> {self.after:.3g} N m "
            f"({self.after / self.before - 1:+.0%})"
        )


@dataclass(frozen=True, slots=True)
class Choice:
    """What there is to choose: laws ``asked`` for are there anyway, none is ``barred`` (``effect:joint`` or ``effect``), all are ``among``
    these (``effect:joint``; None: any), and those ``retained`` of these stay whatever the evidence says."""

    asked: Sequence[str] = ()
    barred: Sequence[str] = ()
    among: tuple[str, ...] | None = None
    retained: tuple[str, ...] = ()


def choose(
    robot: Robot,
    trials: Callable[[], Iterable[Recording]],
    motions: int,
    choice: Choice = Choice(),
    settings: Preprocessing | None = None,
) -> tuple[Gain, ...]:
    """The laws that ``trials`` ask for beside `base` friction, by ``choice``; ``motions``: independent ones in the trials."""
    asked, barred, among = choice.asked, choice.barred, choice.among
    laws = [x for x in usual() if x not in asked and x not in barred]
    if not laws or among == ():
        return ()
    whole = motions >= FOLDS

    def pieces() -> Iterator[Recording]:
        for r in trials():
            yield from ([r] if whole or r.phase == "static" else _named(blocks(r)))

    # the load that friction may depend on is that of a fit that had all laws: friction left out would be taken for masses
    reference = solve_nominal(robot, accumulate(robot, pieces(), (*base(), *asked), settings)).pi
    for _ in range(LOADS):
        data = accumulate(robot, pieces(), (*base(), *asked, *laws), settings, reference)
        richest = solve_nominal(robot, data)
        reference = richest.pi
    # noise, delay and how far the description is off are those of the richest model: a poorer one blames them for its lack
    ladder = _Ladder(robot, data, richest, choice.retained)
    allowed = {
        (j, x): p for j in range(robot.n) for x in laws
        if (name := f"{x}:{robot.joints[j]}") not in barred and (among is None or name in among) and len(p := ladder.places(j, x))
    }  # fmt: skip
    return tuple(ladder.retained(ladder.whole_arm(laws, allowed), allowed))


def _named(parts: Iterable[Recording]) -> Iterator[Recording]:
    """Blocks as trials of their own, so that each is in a group of its own."""
    for k, part in enumerate(parts):
        yield replace(part, phase="closed_loop", repetition=1000 * part.repetition + k)


class _Ladder:
    """Held-out errors of models with some of the columns of ``data``."""

    def __init__(self, robot: Robot, data: NormalEquations, richest: Nominal, stay: Sequence[str] = ()) -> None:
        self._robot, self._data, self._richest = robot, data, richest
        self._retained = {(j, x) for j, joint in enumerate(robot.joints) for x in usual() if f"{x}:{joint}" in stay}
        lags = [lag_weights(float(d)) for d in richest.delay_applied]
        moving = np.stack([joint_reduced(data.moving[:, j], w) for j, w in enumerate(lags)], axis=1)
        still = np.array([joint_reduced(data.still[j], w) for j, w in enumerate(lags)])
        groups = [g for g in range(GROUPS) if data.rows_moving[g].sum() > 0]
        # the heaviest first, each to the lightest fold so far: folds of about equal weight
        folds: list[list[int]] = [[] for _ in range(min(FOLDS, len(groups)))]
        for g in sorted(groups, key=lambda g: -data.rows_moving[g].sum()):
            min(folds, key=lambda f: sum(data.rows_moving[k].sum() for k in f)).append(g)
        self._folds = [f for f in folds if f]
        self._still, total = still, moving.sum(axis=0)
        self._rows = data.rows_moving.sum(axis=0)
        held = [(moving[f].sum(axis=0), data.rows_moving[f].sum(axis=0)) for f in self._folds]
        self._systems = [self._system(total - G, self._rows - rows) for G, rows in held]
        self._parts = [problem_of(data.layout, G, still, rows, data.rows_still).moving for G, rows in held]
        self._solutions: dict[bytes, list[Array]] = {}
        self._all = np.concatenate([self.places(j, x) for j in range(robot.n) for x in usual()]).astype(np.intp)

    def places(self, joint: int, effect: str) -> NDArray[np.intp]:
        """Columns of a law at a joint, in the vector of all parameters."""
        own = self._data.layout.index(joint)[10 * self._robot.n + 1 :]
        columns = self._data.layout.columns[joint]
        return np.array([p for p, c in zip(own, columns, strict=True) if c.effect.name == effect], np.intp)

    def whole_arm(self, laws: Sequence[str], allowed: Places) -> Places:
        """The subset of ``laws``, at every joint that allows them, of the least held-out error, joints counting alike."""
        if len(self._folds) < 2:
            return {key: p for key, p in allowed.items() if key in self._retained}

        def of(some: Sequence[str]) -> Places:
            return {key: p for key, p in allowed.items() if (key[1] in some or key in self._retained) and self._rows[key[0]]}

        subsets = [of(some) for k in range(len(laws) + 1) for some in combinations(laws, k)]
        return min(subsets, key=lambda some: self._value(some.values()))

    def retained(self, places: Places, allowed: Places) -> list[Gain]:
        """From ``places`` on, laws of single joints taken in and out as long as that lowers the held-out error and its price.

        A law that helps others only, and not the joint it acts at, stands for something else: it is left out.
        """
        stay = {key: p for key, p in allowed.items() if key in self._retained and self._rows[key[0]]}
        pool = {key: p for key, p in allowed.items() if key not in stay and self._rows[key[0]] and self._possible(p)}
        now = {key: p for key, p in places.items() if key in pool} | stay
        while True:
            now = self._lowest(now, pool)
            gains = {key: self._gain(key, now) for key in now}
            idle = [key for key, g in gains.items() if key not in stay and g.after > (1 - GAINS) * g.before]
            if not idle:
                return list(gains.values())
            pool = {key: p for key, p in pool.items() if key not in idle}
            now = {key: p for key, p in now.items() if key not in idle}

    def _lowest(self, start: Places, pool: Places) -> Places:
        """The subset of ``pool`` from which no single law more or less lowers the held-out error and its price."""
        price = -float(np.log1p(-GAINS))
        now, least = start, self._value(start.values()) + price * len(start)
        stay = {k: p for k, p in start.items() if k not in pool}
        while pool:
            tried = [{k: p for k, p in pool.items() if (k in now) != (k == key)} | stay for key in pool]
            values = [self._value(some.values()) + price * len(some) for some in tried]
            best = int(np.argmin(values))
            if values[best] >= least:
                break
            now, least = tried[best], values[best]
        return now

    def _value(self, columns: Iterable[NDArray[np.intp]]) -> float:
        """Logarithm of the held-out errors of all joints that move, summed: joints count alike, whatever their size."""
        some = list(columns)
        errors = [self._errors(j, some).sum() / self._rows[j] for j in range(self._robot.n) if self._rows[j]]
        return 0.5 * float(np.sum(np.log(np.maximum(errors, 1e-300))))

    def _gain(self, key: tuple[int, str], left: Places) -> Gain:
        j, effect = key
        columns = ([p for k, p in left.items() if k != key or here] for here in (False, True))
        before, after = (float(np.sqrt(self._errors(j, c).sum() / self._rows[j])) for c in columns)
        return Gain(effect, self._robot.joints[j], before, after)

    def _system(self, total: Array, rows: Array) -> tuple[Array, Array]:
        """Normal matrix and right-hand side of all parameters, every law included."""
        f, still = self._richest, self._data.rows_still
        rms = np.nan_to_num(f.rms)
        w = np.where(rows > 0, 1 / np.maximum(rms**2 * f.inflation, 1e-12), 0.0)
        w_still = np.where(still > 0, 1 / np.maximum(rms**2, 1e-12), 0.0)
        return assemble(
            problem_of(self._data.layout, total, self._still, rows, still), w, w_still, f.prior.precision, f.prior.mean
        )

    def _errors(self, joint: int, columns: list[NDArray[np.intp]]) -> Array:
        """(folds,) sum of squared residuals of a joint on each fold that was left out of the fit; of the laws those at ``columns``."""
        out = np.setdiff1d(self._all, np.concatenate([np.zeros(0, np.intp), *columns]))
        key = out.tobytes()
        if key not in self._solutions:
            self._solutions[key] = [_without(H, b, out) for H, b in self._systems]
        at = self._data.layout.index(joint)
        parts = zip(self._parts, self._solutions[key], strict=True)
        return np.array([residual(part[joint], theta[at]) for part, theta in parts])

    def _possible(self, places: NDArray[np.intp]) -> bool:
        """Whether some number of a law is within its range: friction that pushes is none."""
        theta = self._richest.theta
        terms = {t.symbol: t for e in self._data.layout.columns for c in e for t in c.effect.terms}
        names = self._data.layout.names()
        ranges = [terms[names[p].rpartition(".")[2]] for p in places.tolist()]
        return any(t.lo < theta[p] < t.hi for t, p in zip(ranges, places.tolist(), strict=True))


def _without(H: Array, b: Array, out: NDArray[np.intp]) -> Array:
    """The solution with the parameters ``out`` held at zero."""
    A = H.copy()
    A[out, out] += NEVER * np.maximum(A[out, out], 1.0)
    return np.asarray(np.linalg.solve(A, b), np.float64)
