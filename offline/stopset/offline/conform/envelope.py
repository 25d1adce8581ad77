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
        out = self.upto(len(self.hi) - 1)
        out.absorb(other)
        return out

    def absorb(self, other: Envelope) -> None:
        """`merge` in place."""
        shift = np.array([len(self.labels), 0])
        for mine, theirs, mine_at, theirs_at, beyond in (
            (self.hi, other.hi, self.hi_at, other.hi_at, other.hi > self.hi),
            (self.lo, other.lo, self.lo_at, other.lo_at, other.lo < self.lo),
        ):
            mine[beyond], mine_at[beyond] = theirs[beyond], theirs_at[beyond] + shift
        self.count += other.count
        self.labels += other.labels

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


# a float's bits, those below the sign turned over where it is set, are a whole number in the floats' own order (IEEE 754,
# sec. 5.10); the compiler takes maxima of whole numbers many at a time, those of floats one by one for the sake of NaN
_BELOW_SIGN = 0x7FFF_FFFF_FFFF_FFFF


@njit(cache=True, nogil=True, inline="always")
def _ordered(bits: int) -> int:
    return bits ^ ((bits >> 63) & _BELOW_SIGN)  # its own inverse


@njit(cache=True, nogil=True)
def _extremes(x: Array) -> tuple[float, float]:
    """Largest and smallest of ``x``, which holds no NaN and lies in one piece."""
    bits = x.view(np.int64)
    top, bottom = -_BELOW_SIGN - 1, _BELOW_SIGN
    for s in range(len(bits)):
        key = _ordered(bits[s])
        top, bottom = max(top, key), min(bottom, key)
    # a zero's sign is not a difference
    return np.int64(_ordered(top)).view(np.float64) + 0.0, np.int64(_ordered(bottom)).view(np.float64) + 0.0


@njit(cache=True, nogil=True)
def _first(x: Array, value: float) -> int:
    for s in range(len(x)):
        if x[s] == value:
            return s
    return -1


@njit(cache=True, nogil=True)
def _add(x: Array, weight: float, y: Array) -> None:
    if weight != 0.0:
        for s in range(len(x)):
            x[s] += weight * y[s]


@njit(cache=True, nogil=True)
def _advance(a: Array, rq: Array, rd: Array, eq: Array, ed: Array) -> None:
    """Windows of one joint a step on: ``e <- a e + r`` of position and speed, in place."""
    a11, a12, a21, a22 = a[0, 0], a[0, 1], a[1, 0], a[1, 1]
    for s in range(len(eq)):
        q = rq[s] + a11 * eq[s] + a12 * ed[s]
        d = rd[s] + a21 * eq[s] + a22 * ed[s]
        eq[s], ed[s] = q, d


@njit(cache=True, nogil=True)
def _widen(
    x: Array, top: float, bottom: float, h: int, i: int, trial: int, hi: Array, lo: Array, hi_at: Index, lo_at: Index
) -> None:
    """Column ``i`` of the envelope at age ``h``, by the deviations ``x`` of all windows of that age, from bottom to top."""
    if top > hi[h, i]:
        hi[h, i] = top
        hi_at[h, i, 0], hi_at[h, i, 1] = trial, _first(x, top)
    if bottom < lo[h, i]:
        lo[h, i] = bottom
        lo_at[h, i, 0], lo_at[h, i, 1] = trial, _first(x, bottom)


@njit(cache=True, nogil=True)
def _update_decoupled(
    a: Array, residual: Array, starts: int, trial: int, hi: Array, lo: Array, hi_at: Index, lo_at: Index
) -> None:
    """`_update` of joints on their own, each in one pass over its windows: ``a`` (n, 2, 2), ``residual`` (N-1, 2n)."""
    N, n = residual.shape[0], len(a)
    r = np.ascontiguousarray(residual.T)
    for j in range(n):
        aj, rq, rd = a[j], r[j], r[n + j]
        eq, ed = np.zeros(starts), np.zeros(starts)
        for h in range(1, min(hi.shape[0] - 1, N) + 1):
            live = min(starts, N - h + 1)
            q, d = eq[:live], ed[:live]
            _advance(aj, rq[h - 1 :], rd[h - 1 :], q, d)
            for i, x in ((j, q), (n + j, d)):
                top, bottom = _extremes(x)
                if top > hi[h, i] or bottom < lo[h, i]:  # asked here: most are not, and the call costs more than the question
                    _widen(x, top, bottom, h, i, trial, hi, lo, hi_at, lo_at)


@njit(cache=True, nogil=True)
def _update(
    Ad: Array, across: Array, residual: Array, starts: int, trial: int, hi: Array, lo: Array, hi_at: Index, lo_at: Index
) -> None:
    """``e(h+1) = Ad e(h) + r`` of all windows side by side, looked at along ``across`` (k, n), positions, then speeds.

    Zeros of ``Ad`` and ``across`` cost nothing: decoupled joints are done one by one.
    """
    N, m = residual.shape
    n, k = m // 2, across.shape[0]
    own = np.full(k, -1)  # the joint that a direction is, if it is one
    for i in range(k):
        if np.count_nonzero(across[i]) == 1 and across[i].max() == 1.0:
            own[i] = across[i].argmax()
    r = np.ascontiguousarray(residual.T)
    e, ahead, y = np.zeros((m, starts)), np.empty((m, starts)), np.empty(starts)
    for h in range(1, min(hi.shape[0] - 1, N) + 1):
        live = min(starts, N - h + 1)
        for i in range(m):
            ahead[i, :live] = r[i, h - 1 : h - 1 + live]
            for j in range(m):
                _add(ahead[i, :live], Ad[i, j], e[j, :live])
        e, ahead = ahead, e
        for i in range(2 * k):
            x, states = y[:live], e[:n] if i < k else e[n:]
            if own[i % k] >= 0:
                x = states[own[i % k], :live]
            else:
                x[:] = 0.0
                for j in range(n):
                    _add(x, across[i % k, j], states[j, :live])
            top, bottom = _extremes(x)
            _widen(x, top, bottom, h, i, trial, hi, lo, hi_at, lo_at)


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
        self.across = np.eye(abstraction.n) if across is None else np.ascontiguousarray(across)
        self._blocks: Array | None = None
        if abstraction.decoupled and across is None:
            pairs = [[j, abstraction.n + j] for j in range(abstraction.n)]
            self._blocks = np.ascontiguousarray(np.stack([self._Ad[np.ix_(p, p)] for p in pairs]))
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
        if not np.isfinite(residual).all():  # no maximum sees what is not a number
            raise RecordingError(
                f"{r.label}: the model's torque at {np.argwhere(~np.isfinite(residual))[0, 0] * self.dt:.3f} s is not finite; "
                "expected numbers: look for the effect or the signal that overflows there"
            )
        starts = len(residual) if self.windows == "sliding" else 1
        trial = len(env.labels)
        env.labels.append(r.label)
        where = (env.hi, env.lo, env.hi_at, env.lo_at)
        if self._blocks is not None:
            _update_decoupled(self._blocks, residual, starts, trial, *where)
        else:
            _update(self._Ad, self.across, residual, starts, trial, *where)
        reach = min(self.steps, len(residual))
        ages = np.arange(1, reach + 1)
        env.count[1 : reach + 1] += np.minimum(starts, len(residual) - ages + 1)
        env.count[0] += starts
        env.hi[0], env.lo[0] = 0.0, 0.0

    def add_to(self, targets: Sequence[Envelope], r: Recording, u: Array) -> None:
        """`add` to several envelopes at once: the windows are the same, and where none is beyond any of them is not looked up."""
        if len(targets) == 1:
            self.add(targets[0], r, u)
            return
        one = self.empty()
        np.minimum.reduce([t.hi for t in targets], out=one.hi)
        np.maximum.reduce([t.lo for t in targets], out=one.lo)
        self.add(one, r, u)
        for t in targets:
            t.absorb(one)

    def of(self, r: Recording, u: Array) -> Envelope:
        """Envelope of one recording alone."""
        env = self.empty()
        self.add(env, r, u)
        return env
