"""Which laws of friction a joint has beside Coulomb and viscous, by the error on what was not fitted.

Every law that the regression can hold is tried at every joint.  Laws are taken one after another, each where it lowers the
held-out torque error of its joint by a stated share, and does so in most of what is held out.  Held out are whole motions where
there are enough, else blocks of time with a guard interval.  One pass over the recordings is enough: everything is answered from
the sums.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stopset.offline.campaign.hold_out import blocks
from stopset.offline.nominal.delay import joint_reduced, lag_weights
from stopset.offline.nominal.fit import assemble, problem_of, residual
from stopset.offline.nominal.nominal import Nominal, solve_nominal
from stopset.offline.nominal.normal_equations import GROUPS, NormalEquations, accumulate
from stopset.recording.types import Array, Recording
from stopset.robot import Robot

LAWS = ("load_coulomb", "cubic_viscous", "asymmetric_coulomb")  # tried beyond Coulomb and viscous friction
BASE = ("coulomb", "viscous")
GAINS = 0.02  # share by which a law must lower its joint's held-out torque error
MOSTLY = 2 / 3  # of what is held out in turn in which it must lower it
FOLDS = 6
NEVER = 1e12  # times a column's own weight: what is not part of a model stays zero


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


def choose(
    robot: Robot, trials: Callable[[], Iterable[Recording]], motions: int, asked: Sequence[str] = (), barred: Sequence[str] = ()
) -> tuple[Gain, ...]:
    """The laws that ``trials`` ask for beside `BASE` and those ``asked`` for, none of them ``barred`` (``effect:joint`` or
    ``effect``); ``motions``: independent ones in the trials."""
    laws = [x for x in LAWS if x not in asked and x not in barred]
    if not laws:
        return ()
    whole = motions >= FOLDS

    def pieces() -> Iterator[Recording]:
        for r in trials():
            yield from ([r] if whole or r.phase == "static" else _named(blocks(r)))

    first = solve_nominal(robot, accumulate(robot, pieces(), (*BASE, *asked)))
    data = accumulate(robot, pieces(), (*BASE, *asked, *laws), reference=first.pi)
    # noise, delay and how far the description is off are those of the richest model: a poorer one blames them for its lack
    ladder = _Ladder(robot, data, solve_nominal(robot, data))
    out: list[Gain] = []
    for j in range(robot.n):
        places = {x: ladder.places(j, x) for x in laws if f"{x}:{robot.joints[j]}" not in barred}
        out += ladder.climb(j, places)
    return tuple(out)


def _named(parts: Iterable[Recording]) -> Iterator[Recording]:
    """Blocks as trials of their own, so that each is in a group of its own."""
    for k, part in enumerate(parts):
        yield replace(part, phase="closed_loop", repetition=1000 * part.repetition + k)


class _Ladder:
    """Held-out errors of models with some of the columns of ``data``."""

    def __init__(self, robot: Robot, data: NormalEquations, richest: Nominal) -> None:
        self._robot, self._data, self._richest = robot, data, richest
        lags = [lag_weights(float(d)) for d in richest.delay_applied]
        moving = np.stack([joint_reduced(data.moving[:, j], w) for j, w in enumerate(lags)], axis=1)
        still = np.array([joint_reduced(data.still[j], w) for j, w in enumerate(lags)])
        groups = [g for g in range(GROUPS) if data.rows_moving[g].sum() > 0]
        # the heaviest first, each to the lightest fold so far: folds of about equal weight
        folds: list[list[int]] = [[] for _ in range(min(FOLDS, len(groups)))]
        for g in sorted(groups, key=lambda g: -data.rows_moving[g].sum()):
            min(folds, key=lambda f: sum(data.rows_moving[k].sum() for k in f)).append(g)
        self._folds = [f for f in folds if f]
        self._total, self._still = moving.sum(axis=0), still
        self._held = [moving[f].sum(axis=0) for f in self._folds]
        self._rows = data.rows_moving.sum(axis=0)
        self._rows_held = [data.rows_moving[f].sum(axis=0) for f in self._folds]
        self._all = np.concatenate([self.places(j, x) for j in range(robot.n) for x in LAWS]).astype(np.intp)

    def places(self, joint: int, effect: str) -> NDArray[np.intp]:
        """Columns of a law at a joint, in the vector of all parameters."""
        own = self._data.layout.index(joint)[10 * self._robot.n + 1 :]
        columns = self._data.layout.columns[joint]
        return np.array([p for p, c in zip(own, columns, strict=True) if c.effect.name == effect], np.intp)

    def climb(self, joint: int, places: dict[str, NDArray[np.intp]]) -> list[Gain]:
        """Laws taken one after another at a joint, while one helps."""
        left = {x: p for x, p in places.items() if len(p)}
        if len(self._folds) < 2 or not self._rows[joint]:
            return []
        taken: list[NDArray[np.intp]] = []
        error = self._errors(joint, taken)
        out: list[Gain] = []
        while left:
            tried = {x: self._errors(joint, [*taken, p]) for x, p in left.items()}
            best = min(tried, key=lambda x: float(tried[x].sum()))
            before, after = (float(np.sqrt(e.sum() / self._rows[joint])) for e in (error, tried[best]))
            better = float(np.mean(tried[best] < error))
            if after > (1 - GAINS) * before or better < MOSTLY or not self._possible(joint, [*taken, left[best]]):
                break
            out.append(Gain(best, self._robot.joints[joint], before, after))
            taken.append(left.pop(best))
            error = tried[best]
        return out

    def _solved(self, joint: int, columns: list[NDArray[np.intp]], fold: int | None) -> Array:
        """All parameters fitted without a ``fold``, of the laws those at ``columns`` only."""
        total, rows = self._total, self._rows
        if fold is not None:
            total, rows = total - self._held[fold], rows - self._rows_held[fold]
        p = problem_of(self._data.layout, total, self._still, rows, self._data.rows_still)
        f, prior = self._richest, self._richest.prior
        w = np.where(rows > 0, 1 / np.maximum(f.rms**2 * f.inflation, 1e-12), 0.0)
        w = np.nan_to_num(w)
        w_still = np.where(self._data.rows_still > 0, 1 / np.maximum(np.nan_to_num(f.rms) ** 2, 1e-12), 0.0)
        H, b = assemble(p, w, w_still, prior.precision, prior.mean)
        out = np.setdiff1d(self._all, np.concatenate([np.zeros(0, np.intp), *columns]))
        H[out, out] += NEVER * np.maximum(H[out, out], 1.0)
        return np.asarray(np.linalg.solve(H, b), np.float64)

    def _errors(self, joint: int, columns: list[NDArray[np.intp]]) -> Array:
        """(folds,) sum of squared residuals of a joint on each fold that was left out of the fit."""
        at = self._data.layout.index(joint)
        out = []
        for k in range(len(self._folds)):
            p = problem_of(self._data.layout, self._held[k], self._still, self._rows_held[k], self._data.rows_still)
            out.append(residual(p.moving[joint], self._solved(joint, columns, k)[at]))
        return np.array(out)

    def _possible(self, joint: int, columns: list[NDArray[np.intp]]) -> bool:
        """Whether each law has some number within its range: friction that pushes is none."""
        theta = self._solved(joint, columns, None)
        own = dict(
            zip(self._data.layout.index(joint)[10 * self._robot.n + 1 :].tolist(), self._data.layout.columns[joint], strict=True)
        )
        ranges = {p: next(t for t in own[p].effect.terms if t.symbol == own[p].symbol) for c in columns for p in c.tolist()}
        return all(any(ranges[p].lo < theta[p] < ranges[p].hi for p in c.tolist()) for c in columns)
