"""How much wider the predicted sets are than what was seen: half width of the tube over the largest deviation in it.

Sets enclose by construction; a set that encloses everything because it is wide says nothing.  1 is as tight as a tube about
zero can be where a deviation repeats to both sides; the margin comes on top.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stopset.artifact import Abstraction, UncertaintySets
from stopset.offline.abstraction.grid import Trial
from stopset.reach.flowpipe import DeviationTube
from stopset.reach.nonlinear import predicted_tube
from stopset.reach.predict import predict
from stopset.types import Array

AGES = (0.0, 0.1, 1.0)  # [s] the first: one sample
NAMES = ("one_sample", "0.1_s", "1_s")
JUDGED = NAMES.index("0.1_s")
WIDE = 3.0  # from here on it is said in words
LIMIT = 10.0  # from here on the sets are no success unless they are accepted
WINDOWS = 6  # of each trial along which a nonlinear model's tube is looked at


@dataclass(frozen=True, slots=True)
class Tightness:
    """``half``, ``seen`` (3, 2n) over (q, dq) at `AGES`: the tube's half width and the largest deviation; nan beyond the horizon."""

    half: Array
    seen: Array

    @property
    def ratio(self) -> Array:
        """(3, 2n) half width over deviation; nan where nothing was promised or nothing ever deviated."""
        known = np.isfinite(self.half) & (self.seen > 0.0)
        return np.divide(self.half, self.seen, out=np.full_like(self.half, np.nan), where=known)

    @property
    def by_joint(self) -> Array:
        """(3, n): of angle and speed the wider one."""
        n = self.half.shape[1] // 2
        return np.asarray(np.fmax(self.ratio[:, :n], self.ratio[:, n:]))

    @property
    def median(self) -> float:
        """Over all angles and speeds at 0.1 s; nan if no prediction is that long."""
        known = self.ratio[JUDGED][np.isfinite(self.ratio[JUDGED])]
        return float(np.median(known)) if len(known) else float("nan")

    def answer(self, joints: Sequence[str]) -> dict[str, Any]:
        """Joint -> `NAMES` -> the wider of angle and speed, and each by itself; null where it is not known."""
        n = len(joints)
        tables = (("tightness", self.by_joint), ("tightness_q", self.ratio[:, :n]), ("tightness_dq", self.ratio[:, n:]))
        return {
            key: {
                j: {name: float(x) if np.isfinite(x) else None for name, x in zip(NAMES, rows[:, k], strict=True)}
                for k, j in enumerate(joints)
            }
            for key, rows in tables
        }

    def words(self, joints: Sequence[str]) -> list[str]:
        """One sentence for each joint whose tube is wide at 0.1 s."""
        n = len(joints)
        out = []
        for k, j in enumerate(joints):
            at = k if not self.ratio[JUDGED, k] < self.ratio[JUDGED, n + k] else n + k
            ratio = self.ratio[JUDGED, at]
            if ratio > WIDE:
                unit = "rad" if at < n else "rad/s"
                out.append(
                    f"{'too wide' if ratio > LIMIT else 'wide'}: after 0.1 s {j} is predicted to within "
                    f"{self.half[JUDGED, at]:.3g} {unit} where {self.seen[JUDGED, at]:.3g} {unit} was the most it deviated "
                    f"({ratio:.1f} times; {WIDE:g} is common)"
                )
        return out

    def too_wide(self) -> bool:
        """Whether some joint's tube passes the limit at 0.1 s."""
        return bool(np.any(self.ratio[JUDGED] > LIMIT))


def _places(dt: float, last: int) -> list[int | None]:
    at = [max(1, round(age / dt)) for age in AGES]
    return [k if k <= last else None for k in at]


def of_tube(tube: DeviationTube, hi: Array, lo: Array, n: int) -> Tightness:
    """Of a constant tube and the envelope ``hi``, ``lo`` (H+1, 2k) of all deviations, joints before other directions."""
    k = hi.shape[1] // 2
    columns = [*range(n), *range(k, k + n)]
    dt = float(tube.ages[1])
    reached = int(np.flatnonzero(np.isfinite(hi).all(axis=1))[-1])
    half, seen = np.full((len(AGES), 2 * n), np.nan), np.full((len(AGES), 2 * n), np.nan)
    for row, at in enumerate(_places(dt, min(len(tube.ages) - 1, reached))):
        if at is not None:
            half[row] = 0.5 * (tube.hi[at] - tube.lo[at])[columns]
            seen[row] = np.maximum(hi[at], -lo[at])[columns]
    return Tightness(half, seen)


class Along:
    """`Tightness` of a nonlinear model, trial by trial: its tube is another one along each window, so its mean counts."""

    def __init__(self, abstraction: Abstraction, sets: UncertaintySets) -> None:
        self._abstraction, self._sets = abstraction, sets
        self._width, self._seen = (np.zeros((len(AGES), 2 * abstraction.n)) for _ in range(2))
        self._count = np.zeros((len(AGES), 1))

    def add(self, trial: Trial) -> None:
        """Look at a trial on the sets' grid from `WINDOWS` starts."""
        (x, u), sets = trial, self._sets
        for s in np.unique(np.linspace(0, len(x) - 2, WINDOWS).astype(int)) if sets.windows == "sliding" else (0,):
            last = min(round(max(AGES) / sets.dt), round(sets.horizon / sets.dt), len(x) - 1 - s)
            lo, hi = predicted_tube(self._abstraction, sets, x[s], u[s : s + last])
            path = predict(self._abstraction, sets.dt, x[s], u[s : s + last + 1])
            for row, at in enumerate(_places(sets.dt, last)):
                if at is not None:
                    self._width[row] += 0.5 * (hi[at] - lo[at])
                    self._seen[row] = np.maximum(self._seen[row], np.abs(x[s + at] - path[at]))
                    self._count[row] += 1

    def result(self) -> Tightness:
        none = self._count == 0
        return Tightness(
            np.where(none, np.nan, self._width / np.maximum(self._count, 1)), np.where(none, np.nan, self._seen)
        )  # fmt: skip


def table(found: Tightness, joints: Sequence[str]) -> list[str]:
    """The printout: a row per joint, and what is wide in words."""
    rows = [f"{'joint':<22}{'1 sample':>10}{'0.1 s':>8}{'1 s':>8}   half width of the tube over the largest deviation seen"]
    for k, j in enumerate(joints):
        cells = (f"{x:.1f}" if np.isfinite(x) else "-" for x in found.by_joint[:, k])
        rows.append(f"{j:<22}" + "".join(f"{c:>{w}}" for c, w in zip(cells, (10, 8, 8), strict=True)))
    middle = f"median over angles and speeds after 0.1 s: {found.median:.2f}" if np.isfinite(found.median) else ""
    return [*rows, *filter(None, [middle]), *found.words(joints)]
