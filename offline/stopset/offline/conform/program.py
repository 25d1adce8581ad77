"""The one linear program behind all sets: unknown are the bounds of ``X0``, ``V`` and ``U``, every reading is a row.

``z = (X0.lo, X0.hi, V.lo, V.hi, U.lo, U.hi)``; a reading ``d`` at some age lies in the tube if ``G z >= d`` for the row of
its upper side and ``G z >= -d`` for that of its lower side.  Signs of the responses decide which bound takes part (trap
P1).  Solved by constraint generation on HiGHS; callers re-check in floating point (trap P17).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stopset.errors import NotConformant
from stopset.offline.abstraction.metrics import STOP_TIME
from stopset.offline.campaign.reading_error import ReadingError
from stopset.types import Array

# HiGHS keeps rows to 1e-7 at best (it was seen 9e-8 outside): rows start this much inside, and are re-checked
SOLVER_SLACK = 2e-7
ROUNDS = 40  # of constraint generation
FIRST, MORE = 600, 300  # rows to begin with, and added in one round
# a vanishing charge on every width keeps directions that cost nothing from wandering off
CHARGE = 1e-9
# what a solver's status means to whoever reads it; 2, that no sets exist, is said by who asked
BEYOND = (
    "expected deviations, inertias and dampings of one order of magnitude: look for a joint that the data hardly move or whose inertia "
    "comes out next to nothing (`stopset inspect --robot`), and state its rotor inertia in robot.json"
)
UNSOLVED = {
    1: f"the search for them did not end; {BEYOND}",
    3: f"nothing in the data bounds their width; {BEYOND}",
    4: f"the numbers of the model lie too far apart in size to be computed with; {BEYOND}",
}


@dataclass(frozen=True, slots=True)
class Bounds:
    """The unknowns of ``m`` states and ``k`` inputs, and what holds for them whatever was recorded.

    ``readings`` (m,): between which boxes ``V`` lies; ``capped``: ``X0`` lies in ``-V``, so that it cannot hide stiction (trap
    P12); the first ``points`` inputs are single values and the others symmetric (a zonotope's centre and generators), or all
    are free intervals (None; trap P7).
    """

    readings: ReadingError
    k: int
    capped: bool = True
    points: int | None = None

    @property
    def m(self) -> int:
        return self.readings.dim

    def split(self, z: Array) -> tuple[Array, Array, Array, Array, Array, Array]:
        """Views of ``z``: X0.lo, X0.hi, V.lo, V.hi, U.lo, U.hi."""
        m, k = self.m, self.k
        return z[:m], z[m : 2 * m], z[2 * m : 3 * m], z[3 * m : 4 * m], z[4 * m : 4 * m + k], z[4 * m + k :]

    def rows(self) -> Array:
        """Rows ``L z <= 0``: bounds in order, X0 within -V, the shape of a zonotope."""
        m, k = self.m, self.k
        out = []

        def row(*entries: tuple[int, float]) -> None:
            r = np.zeros(4 * m + 2 * k)
            for column, value in entries:
                r[column] = value
            out.append(r)

        for a in range(m):
            row((a, 1.0), (m + a, -1.0))
            if self.capped:  # X0.lo >= -V.hi, X0.hi <= -V.lo
                row((a, -1.0), (3 * m + a, -1.0))
                row((m + a, 1.0), (2 * m + a, 1.0))
        for a in range(k):
            low, high = 4 * m + a, 4 * m + k + a
            row((low, 1.0), (high, -1.0))
            if self.points is not None:
                sign = -1.0 if a < self.points else 1.0  # hi = lo, or hi = -lo
                row((low, sign), (high, 1.0))
                if a >= self.points:
                    row((low, -1.0), (high, -1.0))
        return np.array(out)

    def limits(self) -> list[tuple[float, float]]:
        """Bounds of each unknown."""
        inf = np.inf
        least, most = self.readings.least, self.readings.most
        out: list[tuple[float, float]] = [(-inf, inf)] * (2 * self.m)
        out += zip(most.lo.tolist(), least.lo.tolist(), strict=True)
        out += zip(least.hi.tolist(), most.hi.tolist(), strict=True)
        return out + [(-inf, inf)] * (2 * self.k)

    def tidy(self, z: Array) -> Array:
        """``z`` with its bounds in order and a zonotope's shape exact, both of which the solver keeps to its tolerance only."""
        z = z.copy()
        x_lo, x_hi, v_lo, v_hi, u_lo, u_hi = self.split(z)  # views into z
        for low, high in ((x_lo, x_hi), (v_lo, v_hi), (u_lo, u_hi)):
            np.maximum(high, low, out=high)
        if self.points is not None:
            p = self.points
            u_lo[:p] = u_hi[:p] = 0.5 * (u_lo[:p] + u_hi[:p])
            length = np.maximum(np.abs(u_lo[p:]), np.abs(u_hi[p:]))
            u_lo[p:], u_hi[p:] = -length, length
        return z

    def widths(self) -> Array:
        """Signs with which the unknowns add up to the sum of all widths."""
        return np.concatenate([np.tile(np.repeat([-1.0, 1.0], self.m), 2), np.repeat([-1.0, 1.0], self.k)])


def sides(E: Array, L: Array, P: Array, N: Array) -> tuple[Array, Array]:
    """Rows of the upper and of the lower side (each (R, 4m + 2k)) from responses to start ``E``, reading ``L``, inputs ``P, N``."""
    Ep, En, Lp, Ln = np.maximum(E, 0.0), np.minimum(E, 0.0), np.maximum(L, 0.0), np.minimum(L, 0.0)
    return np.hstack([En, Ep, Ln, Lp, N, P]), -np.hstack([Ep, En, Lp, Ln, P, N])


def price(E: Array, L: Array, P: Array, N: Array, importance: Array, weight: Array) -> Array:
    """Cost of the unknowns: mean width of the tube over ages (H,) of an ``importance`` of sum 1 and rows (r,) of some ``weight``.

    ``E``: (H, r, m), ``L``: (r, m), ``P, N``: (H, r, k).
    """
    start = importance @ (np.abs(E) * weight[:, None]).sum(axis=1)
    torque = importance @ ((P - N) * weight[:, None]).sum(axis=1)
    own = (np.abs(L) * weight[:, None]).sum(axis=0)
    return np.concatenate([-start, start, -own, own, -torque, torque])


def age_weights(last: int, dt: float) -> Array:
    """(last,) weights of ages ``dt .. last dt`` in the cost, sum 1: every decade of age beyond a stop's counts alike.

    A plain mean over some seconds would trade width at stop horizons away for width that nobody looks at.
    """
    w = 1.0 / (dt * np.arange(1, last + 1) + STOP_TIME)
    return np.asarray(w / w.sum())


def solved(c: Array, A: Array, b: Array, limits: Sequence[tuple[float | None, float | None]], who: str, none: str) -> Array:
    """The ``z`` of least ``c z`` with ``A z <= b`` and within ``limits``; ``none``: what it means that there is none.

    Raises `NotConformant`, in our words, when none is found.
    """
    from scipy.optimize import linprog  # half a second, not for who only looks at sets

    status = 4
    if np.isfinite(A).all() and np.isfinite(b).all() and np.isfinite(c).all():
        result = linprog(c, A_ub=A, b_ub=b, bounds=limits, method="highs-ds")
        status = int(result.status)
        if status == 0:
            return np.asarray(result.x)
    raise NotConformant(f"no sets make {who} conformant: {none if status == 2 else UNSOLVED[status]}")


def cheapest(G: Array, h: Array, cost: Array, bounds: Bounds, who: str) -> Array:
    """The ``z`` of least ``cost`` with ``G z >= h`` and within ``bounds``, up to the solver's tolerance; ``who``: of whom.

    Raises `NotConformant` when there is none.
    """
    limits = bounds.rows()
    c = cost + CHARGE * float(np.abs(cost).max()) * bounds.widths()
    # a row scaled to unit size: the solver's absolute tolerance then means the same for every age
    scale = np.maximum(np.abs(G).max(axis=1), 1e-12)
    unit, need = G / scale[:, None], h / scale + SOLVER_SLACK
    chosen = np.unique(np.linspace(0, len(need) - 1, min(len(need), FIRST)).astype(int))
    z = np.zeros(len(c))
    for _ in range(ROUNDS):
        A = np.vstack([-unit[chosen], limits])
        b = np.concatenate([-need[chosen], np.zeros(len(limits))])
        z = solved(
            c, A, b, bounds.limits(), who,
            "the data jump within one sample by more than the noise allows; expected a model whose error torques explain: "
            "check the velocity signal with `stopset inspect`, and what was held at a limit",
        )  # fmt: skip
        short = need - unit @ z
        new = np.setdiff1d(np.flatnonzero(short > SOLVER_SLACK), chosen)
        if not len(new):
            break
        chosen = np.union1d(chosen, new[np.argsort(-short[new])[:MORE]])
    return z


def tight(G: Array, h: Array, z: Array, bounds: Bounds) -> dict[int, int]:
    """Per unknown of V and U (place in ``z``), the tight row of ``G z >= h`` in which it counts most; not those in none."""
    slack = (G @ z - h) / np.maximum(np.abs(G).max(axis=1), 1e-12)
    rows = np.flatnonzero(slack <= 20 * SOLVER_SLACK)
    weight = np.abs(G[rows])
    return {v: int(rows[weight[:, v].argmax()]) for v in range(2 * bounds.m, len(z)) if len(rows) and weight[:, v].max() > 0}
