"""Envelope of measured deviations from the nominal prediction, per prediction age: all that the sets need to know.

One pass over the recordings and constant memory: a running maximum and minimum per age and state (a map-reduce, exact
and independent of order).  ``windows='sliding'`` restarts the prediction at every sample (trap P15: conformance from the
trial's start does not survive a restart); ``'start'`` predicts from the trial's first sample only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stopset.artifact import Abstraction, ActiveBound
from stopset.errors import RecordingError
from stopset.reach.flowpipe import discretise
from stopset.recording import Recording

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(slots=True)
class Envelope:
    """Running envelope: ``hi``, ``lo`` (H+1, 2k) of deviations at age ``k dt``; where each was reached; samples per age.

    Columns are positions and speeds of the joints (k = n), and of further directions across them where asked for.
    """

    dt: float
    hi: Array
    lo: Array
    hi_at: Index  # (H+1, 2k, 2) trial number (position in `labels`), start sample
    lo_at: Index
    count: Index  # (H+1,) number of windows that reach this age
    labels: list[str] = field(default_factory=list)

    @classmethod
    def empty(cls, dt: float, steps: int, states: int) -> Envelope:
        shape = (steps + 1, states)
        at = np.full((*shape, 2), -1, np.int64)
        return cls(dt, np.full(shape, -np.inf), np.full(shape, np.inf), at, at.copy(), np.zeros(steps + 1, np.int64))

    @property
    def steps(self) -> int:
        """Last age (in steps) that any window reached."""
        return int(np.flatnonzero(self.count)[-1])

    def merge(self, other: Envelope) -> Envelope:
        """Envelope of both parts; maxima are associative, so the order of merging does not matter."""
        out = Envelope(
            self.dt, self.hi.copy(), self.lo.copy(), self.hi_at.copy(), self.lo_at.copy(),
            self.count + other.count, self.labels + other.labels,
        )  # fmt: skip
        shift = np.array([len(self.labels), 0])
        higher, lower = other.hi > self.hi, other.lo < self.lo
        out.hi[higher], out.hi_at[higher] = other.hi[higher], other.hi_at[higher] + shift
        out.lo[lower], out.lo_at[lower] = other.lo[lower], other.lo_at[lower] + shift
        return out

    def upto(self, steps: int) -> Envelope:
        """The same at ages up to ``steps``; ages that nothing reached are added where it is shorter."""
        out = Envelope.empty(self.dt, steps, self.hi.shape[1])
        m = min(steps, len(self.hi) - 1) + 1
        for name in ("hi", "lo", "hi_at", "lo_at", "count"):
            getattr(out, name)[:m] = getattr(self, name)[:m]
        out.labels = list(self.labels)
        return out

    def where(self, bound: str, age: int, state: int, side: str, names: Sequence[str]) -> ActiveBound:
        """Which recording and time put the envelope where it is at this age and state, ``names`` of which see `state_names`."""
        at = (self.hi_at if side == "hi" else self.lo_at)[age, state]
        label = self.labels[int(at[0])] if at[0] >= 0 else "noise alone"
        return ActiveBound(bound, label, float(at[1]) * self.dt, age * self.dt, names[state])


def state_names(joints: Sequence[str], directions: int) -> list[str]:
    """Names of an envelope's columns: positions, then speeds, of the joints and of further directions across them."""
    across = [*joints, *(f"direction {k + 1}" for k in range(directions - len(joints)))]
    return [f"{x}_{name}" for x in ("q", "dq") for name in across]


@njit(cache=True, nogil=True)
def _update_decoupled(
    a: Array, residual: Array, starts: int, trial: int, hi: Array, lo: Array, hi_at: Index, lo_at: Index
) -> None:
    """Joint by joint ``e(h+1) = Ad e(h) + r``; ``a``: (n, 2, 2), ``residual``: (N-1, 2n)."""
    N, n2 = residual.shape
    n = n2 // 2
    H = hi.shape[0] - 1
    eq, ed = np.empty(starts), np.empty(starts)
    for j in range(n):
        a11, a12, a21, a22 = a[j, 0, 0], a[j, 0, 1], a[j, 1, 0], a[j, 1, 1]
        eq[:] = 0.0
        ed[:] = 0.0
        for h in range(1, min(H, N) + 1):
            live = min(starts, N - h + 1)
            mq, md, nq, nd = -np.inf, -np.inf, np.inf, np.inf
            for s in range(live):
                q = a11 * eq[s] + a12 * ed[s] + residual[s + h - 1, j]
                d = a21 * eq[s] + a22 * ed[s] + residual[s + h - 1, n + j]
                eq[s] = q
                ed[s] = d
                mq = max(mq, q)
                nq = min(nq, q)
                md = max(md, d)
                nd = min(nd, d)
            if mq > hi[h, j]:
                hi[h, j] = mq
                hi_at[h, j, 0], hi_at[h, j, 1] = trial, _first(eq, live, mq)
            if nq < lo[h, j]:
                lo[h, j] = nq
                lo_at[h, j, 0], lo_at[h, j, 1] = trial, _first(eq, live, nq)
            if md > hi[h, n + j]:
                hi[h, n + j] = md
                hi_at[h, n + j, 0], hi_at[h, n + j, 1] = trial, _first(ed, live, md)
            if nd < lo[h, n + j]:
                lo[h, n + j] = nd
                lo_at[h, n + j, 0], lo_at[h, n + j, 1] = trial, _first(ed, live, nd)


@njit(cache=True)
def _first(x: Array, live: int, value: float) -> int:
    for s in range(live):
        if x[s] == value:
            return s
    return -1


@njit(cache=True, nogil=True)
def _update(
    Ad: Array, across: Array, residual: Array, starts: int, trial: int, hi: Array, lo: Array, hi_at: Index, lo_at: Index
) -> None:
    """The same for a full state matrix, looked at along ``across`` (k, n): positions, then speeds."""
    N, m = residual.shape
    n, k = m // 2, across.shape[0]
    e, x = np.zeros((starts, m)), np.empty(m)
    top, bottom = np.empty(2 * k), np.empty(2 * k)
    top_at, bottom_at = np.empty(2 * k, np.int64), np.empty(2 * k, np.int64)
    for h in range(1, min(hi.shape[0] - 1, N) + 1):
        top[:], bottom[:] = -np.inf, np.inf
        for s in range(min(starts, N - h + 1)):
            for i in range(m):
                x[i] = residual[s + h - 1, i]
                for j in range(m):
                    x[i] += Ad[i, j] * e[s, j]
            e[s] = x
            for i in range(k):
                q = dq = 0.0
                for j in range(n):
                    q += across[i, j] * x[j]
                    dq += across[i, j] * x[n + j]
                if q > top[i]:
                    top[i], top_at[i] = q, s
                if q < bottom[i]:
                    bottom[i], bottom_at[i] = q, s
                if dq > top[k + i]:
                    top[k + i], top_at[k + i] = dq, s
                if dq < bottom[k + i]:
                    bottom[k + i], bottom_at[k + i] = dq, s
        for i in range(2 * k):
            if top[i] > hi[h, i]:
                hi[h, i] = top[i]
                hi_at[h, i, 0], hi_at[h, i, 1] = trial, top_at[i]
            if bottom[i] < lo[h, i]:
                lo[h, i] = bottom[i]
                lo_at[h, i, 0], lo_at[h, i, 1] = trial, bottom_at[i]


def step_residual(Ad: Array, Bd: Array, x: Array, u: Array) -> Array:
    """``x(k+1) - Ad x(k) - Bd u(k)``, (N-1, 2n): what one step of the nominal model leaves unexplained."""
    return np.ascontiguousarray(x[1:] - x[:-1] @ Ad.T - u[:-1] @ Bd.T)


class Deviations:
    """Deviations of one nominal model on one grid, trial by trial; ``windows`` as in the module's first lines.

    ``across``: (k, n) directions in the joints that are looked at, the joints themselves among them (None: only these).
    """

    def __init__(
        self, abstraction: Abstraction, dt: float, steps: int, windows: str = "sliding", across: Array | None = None
    ) -> None:
        self.dt, self.steps, self.windows = dt, steps, windows
        self._Ad, self._Bd = discretise(abstraction, dt)
        self._blocks = None
        if abstraction.decoupled and across is None:
            pairs = [[j, abstraction.n + j] for j in range(abstraction.n)]
            self._blocks = np.ascontiguousarray(np.stack([self._Ad[np.ix_(p, p)] for p in pairs]))
        self.across = np.eye(abstraction.n) if across is None else np.ascontiguousarray(across)
        self.states = 2 * len(self.across)

    def empty(self) -> Envelope:
        return Envelope.empty(self.dt, self.steps, self.states)

    def add(self, env: Envelope, r: Recording, u: Array) -> None:
        """Widen ``env`` by a recording sampled on the grid and its input ``u`` (N, n) [N m].

        Raises `RecordingError` for a trial whose clock is not the grid's (resample it first).
        """
        off = float(np.abs(np.diff(r.t) - self.dt).max())
        if off > 0.05 * self.dt:
            raise RecordingError(
                f"{r.label}: a step of its clock differs from {self.dt} s by {off:.3g} s; resample it to the grid"
            )
        residual = step_residual(self._Ad, self._Bd, np.hstack([r.q, r.dq]), u)
        starts = len(residual) if self.windows == "sliding" else 1
        trial = len(env.labels)
        env.labels.append(r.label)
        if self._blocks is not None:
            _update_decoupled(self._blocks, residual, starts, trial, env.hi, env.lo, env.hi_at, env.lo_at)
        else:
            where = (env.hi, env.lo, env.hi_at, env.lo_at)
            _update(self._Ad, self.across, residual, starts, trial, *where)
        reach = min(self.steps, len(residual))
        ages = np.arange(1, reach + 1)
        env.count[1 : reach + 1] += np.minimum(starts, len(residual) - ages + 1)
        env.count[0] += starts
        env.hi[0], env.lo[0] = 0.0, 0.0

    def of(self, r: Recording, u: Array) -> Envelope:
        """Envelope of one recording alone."""
        env = self.empty()
        self.add(env, r, u)
        return env
