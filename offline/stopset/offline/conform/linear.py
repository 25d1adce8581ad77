"""The uncertainty sets of a linear model: an exact linear program over the envelope, solved, re-checked, repaired outward.

Unknowns are the bounds of ``X0``, ``U`` and ``V`` themselves.  ``U`` is found directly (trap P6), centres are free (trap
P7), signs of the response decide corners (trap P1).  ``V`` is the measurement noise for positions and at least that for
velocities: what a velocity reading does beyond it (vibration above the model's bandwidth, a filter's ringing) may widen
it where that is cheaper than a torque at all times.  A start state is a reading too, so ``X0`` lies in ``-V`` (trap P12)
and cannot hide stiction.  With a
decoupled model every joint is a program of its own.  Source: Liu & Althoff (2018), eq. (17)-(21) as corrected there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from stopset.artifact import Abstraction, ActiveBound
from stopset.errors import NotConformant
from stopset.offline.conform.envelope import Envelope
from stopset.reach.flowpipe import Responses
from stopset.sets import Box

Array = NDArray[np.float64]

# HiGHS keeps rows to 1e-7 at best (it was seen 9e-8 outside): rows start this much inside, and are re-checked
SOLVER_SLACK = 2e-7
ROUNDS = 40  # of constraint generation
# trap P11: rad and rad/s are not addable. A velocity counts as the way it goes within a typical stop.
STOP_TIME = 0.2  # [s]


@dataclass(frozen=True, slots=True)
class Fit:
    """The sets, the cost they were chosen by (mean tube width, rad), and what fixes each bound."""

    X0: Box
    U: Box
    V: Box
    cost: float
    active: tuple[ActiveBound, ...]
    conform: str = "all"


@dataclass(frozen=True, slots=True)
class _Block:
    """One linear program: rows ``G z >= h`` over ``z = (X0.lo, X0.hi, V.lo, V.hi, U.lo, U.hi)`` of states xs, inputs us."""

    xs: list[int]
    us: list[int]
    G: Array
    h: Array
    cost: Array
    age: NDArray[np.int64]
    state: NDArray[np.int64]
    upper: NDArray[np.bool_]

    def split(self, z: Array) -> tuple[Array, Array, Array, Array, Array, Array]:
        m, k = len(self.xs), len(self.us)
        return z[:m], z[m : 2 * m], z[2 * m : 3 * m], z[3 * m : 4 * m], z[4 * m : 4 * m + k], z[4 * m + k :]


def age_weights(last: int, dt: float) -> Array:
    """(last,) weights of ages ``dt .. last dt`` in the cost, sum 1: every decade of age beyond a stop's counts alike.

    A plain mean over some seconds would trade width at stop horizons away for width that nobody looks at.
    """
    w = 1.0 / (dt * np.arange(1, last + 1) + STOP_TIME)
    return np.asarray(w / w.sum())


def _block(env: Envelope, R: Responses, states: list[int], xs: list[int], us: list[int], n: int, paper: bool) -> _Block:
    last, m, k = env.steps, len(xs), len(us)
    ages = slice(1, last + 1)
    importance = np.full(last, 1.0 / last) if paper else age_weights(last, R.dt)
    G, h, age, state, upper = [], [], [], [], []
    cost = np.zeros(4 * m + 2 * k)
    for i in states:
        E = R.E1[ages, i][:, xs]
        P, N = R.plus[ages, i][:, us], R.minus[ages, i][:, us]
        Ep, En = np.maximum(E, 0.0), np.minimum(E, 0.0)
        own = np.tile((np.array(xs) == i).astype(float), (last, 1))
        none = np.zeros_like(own)
        G += [np.hstack([En, Ep, none, own, N, P]), -np.hstack([Ep, En, own, none, P, N])]
        h += [env.hi[ages, i], -env.lo[ages, i]]
        age += [np.arange(1, last + 1)] * 2
        state += [np.full(2 * last, i)]
        upper += [np.full(last, True), np.full(last, False)]
        weight = 1.0 if i < n or paper else STOP_TIME
        start, torque = importance @ np.abs(E), importance @ (P - N)
        cost += weight * np.concatenate([-start, start, -own[0], own[0], -torque, torque])
    return _Block(
        xs, us, np.vstack(G), np.concatenate(h), cost, np.concatenate(age), np.concatenate(state), np.concatenate(upper)
    )


def fit_sets(
    env: Envelope, R: Responses, noise: Box, abstraction: Abstraction, joints: tuple[str, ...], conform: str = "all",
    capped: bool = True,
) -> Fit:  # fmt: skip
    """Smallest boxes ``X0`` (2n,), ``U`` (n,), ``V`` (2n,) whose tube encloses the envelope at every age.

    ``noise`` (2n,): what ``V`` holds at least; ``conform``: ``"all"`` states or ``"position"`` only (then ``V`` is exactly
    ``noise``, since positions alone say nothing of velocity readings); ``capped=False`` is the paper's program: ``V`` is
    exactly ``noise``, ``X0`` is free, so stiction may hide in it, and every edge at every age costs the same (eq. 21).
    Raises `NotConformant` when no such sets exist.
    """
    n = abstraction.n
    wanted = range(2 * n) if conform == "all" else range(n)
    blocks = [[j] for j in range(n)] if abstraction.decoupled else [list(range(n))]
    lo = {name: np.zeros(n if name == "U" else 2 * n) for name in ("X0", "V", "U")}
    hi = {name: np.zeros_like(x) for name, x in lo.items()}
    cost = 0.0
    active: list[ActiveBound] = []
    for us in blocks:
        xs = [*us, *(n + j for j in us)]
        block = _block(env, R, [i for i in wanted if i in xs], xs, us, n, not capped)
        z = _solve(block, noise.take(xs), capped, conform == "all", [joints[j] for j in us])
        lo["X0"][xs], hi["X0"][xs], lo["V"][xs], hi["V"][xs], lo["U"][us], hi["U"][us] = block.split(z)
        cost += float(block.cost @ z)
        active += _active(block, z, env, joints)
    return Fit(Box(lo["X0"], hi["X0"]), Box(lo["U"], hi["U"]), Box(lo["V"], hi["V"]), cost, tuple(active), conform)


def _limits(block: _Block, noise: Box, capped: bool, widen: bool) -> tuple[Array, list[tuple[float, float]]]:
    """Rows ``L z <= 0`` (bounds in order; X0 within -V) and bounds of each unknown."""
    m, k = len(block.xs), len(block.us)
    size = 4 * m + 2 * k
    rows = []

    def row(*entries: tuple[int, float]) -> None:
        r = np.zeros(size)
        for column, value in entries:
            r[column] = value
        rows.append(r)

    for a in range(m):
        row((a, 1.0), (m + a, -1.0))
        if capped:  # X0.lo >= -V.hi, X0.hi <= -V.lo
            row((a, -1.0), (3 * m + a, -1.0))
            row((m + a, 1.0), (2 * m + a, 1.0))
    for a in range(k):
        row((4 * m + a, 1.0), (4 * m + k + a, -1.0))
    inf = np.inf
    bounds: list[tuple[float, float]] = [(-inf, inf)] * (2 * m)
    wide = [capped and widen and a >= m // 2 for a in range(m)]  # velocities, the second half of the block's states
    bounds += [(-inf if w else v, v) for v, w in zip(noise.lo.tolist(), wide, strict=True)]
    bounds += [(v, inf if w else v) for v, w in zip(noise.hi.tolist(), wide, strict=True)]
    bounds += [(-inf, inf)] * (2 * k)
    return np.array(rows), bounds


def _solve(block: _Block, noise: Box, capped: bool, widen: bool, names: Sequence[str]) -> Array:
    """Constraint generation on HiGHS, then a floating-point re-check of every row and an outward repair (trap P17)."""
    limits, bounds = _limits(block, noise, capped, widen)
    m = len(block.xs)
    sign = np.concatenate([np.tile(np.repeat([-1.0, 1.0], m), 2), np.repeat([-1.0, 1.0], len(block.us))])
    # a vanishing charge on every width keeps directions that cost nothing from wandering off
    c = block.cost + 1e-9 * float(np.abs(block.cost).max()) * sign
    # a row scaled to unit size: the solver's absolute tolerance then means the same for every age
    scale = np.maximum(np.abs(block.G).max(axis=1), 1e-12)
    G, h = block.G / scale[:, None], block.h / scale + SOLVER_SLACK
    chosen = np.unique(np.linspace(0, len(h) - 1, min(len(h), 600)).astype(int))
    for _ in range(ROUNDS):
        A = np.vstack([-G[chosen], limits])
        b = np.concatenate([-h[chosen], np.zeros(len(limits))])
        result = linprog(c, A_ub=A, b_ub=b, bounds=bounds, method="highs-ds")
        if result.status != 0:
            raise NotConformant(
                f"no sets make joint {', '.join(names)} conformant ({result.message.splitlines()[0].strip()}); the data jump "
                "within one sample by more than the noise allows: check the velocity signal"
            )
        z = np.asarray(result.x)
        short = h - G @ z
        new = np.setdiff1d(np.flatnonzero(short > SOLVER_SLACK), chosen)
        if not len(new):
            break
        chosen = np.union1d(chosen, new[np.argsort(-short[new])[:300]])
    return _repaired(block, z)


def _repaired(block: _Block, z: Array) -> Array:
    """Widen ``V``, by what each row still lacks in floating point, until every row holds with a margin above rounding."""
    z = z.copy()
    m = len(block.xs)
    x_lo, x_hi, v_lo, v_hi, u_lo, u_hi = block.split(z)  # views into z
    for low, high in ((x_lo, x_hi), (v_lo, v_hi), (u_lo, u_hi)):
        np.maximum(high, low, out=high)
    rounding = 2.0**-48 * (np.abs(block.G) @ np.abs(z) + np.abs(block.h))
    short = block.h + rounding - block.G @ z
    for a, state in enumerate(block.xs):
        mine = block.state == state
        v_hi[a] += max(0.0, float(short[mine & block.upper].max(initial=0.0)))
        v_lo[a] -= max(0.0, float(short[mine & ~block.upper].max(initial=0.0)))
    assert m and float((block.h - block.G @ z).max()) <= 0.0
    return z


def _active(block: _Block, z: Array, env: Envelope, joints: tuple[str, ...]) -> list[ActiveBound]:
    """For each bound of U and V, the tightest row in which it takes part: which recording, time and state fix it."""
    n, m, k = len(joints), len(block.xs), len(block.us)
    state_names = [f"{'q' if i < n else 'dq'}_{joints[i % n]}" for i in block.xs]
    labels = [f"V[{x}].{s}" for s in ("lo", "hi") for x in state_names]
    labels += [f"U[{joints[j]}].{s}" for s in ("lo", "hi") for j in block.us]
    slack = (block.G @ z - block.h) / np.maximum(np.abs(block.G).max(axis=1), 1e-12)
    tight = np.flatnonzero(slack <= 20 * SOLVER_SLACK)
    out: list[ActiveBound] = []
    for v, label in zip(range(2 * m, 4 * m + 2 * k), labels, strict=True):
        takes_part = tight[np.abs(block.G[tight, v]) > 0]
        if len(takes_part):
            r = takes_part[np.argmax(np.abs(block.G[takes_part, v]))]
            out.append(env.where(label, int(block.age[r]), int(block.state[r]), "hi" if block.upper[r] else "lo", joints))
    return out
