"""The heavy kernels of the envelope: deviations of all windows of a trial side by side, age by age, and their extremes.

They release the interpreter, and their loops are written so that the compiler takes several windows at a time.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# a float's bits, those below the sign turned over where it is set, are a whole number in the floats' own order (IEEE 754,
# sec. 5.10); the compiler takes maxima of whole numbers many at a time, those of floats one by one for the sake of NaN
_BELOW_SIGN = 0x7FFF_FFFF_FFFF_FFFF


@njit(cache=True, nogil=True, inline="always")
def _ordered(bits: int) -> int:
    return bits ^ ((bits >> 63) & _BELOW_SIGN)  # its own inverse


@njit(cache=True, nogil=True)
def extremes(x: Array) -> tuple[float, float]:
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
def update_decoupled(
    a: Array, residual: Array, starts: int, trial: int, hi: Array, lo: Array, hi_at: Index, lo_at: Index
) -> None:
    """`update` of joints on their own, each in one pass over its windows: ``a`` (n, 2, 2), ``residual`` (N-1, 2n)."""
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
                top, bottom = extremes(x)
                if top > hi[h, i] or bottom < lo[h, i]:  # asked here: most are not, and the call costs more than the question
                    _widen(x, top, bottom, h, i, trial, hi, lo, hi_at, lo_at)


@njit(cache=True, nogil=True)
def update(
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
            top, bottom = extremes(x)
            _widen(x, top, bottom, h, i, trial, hi, lo, hi_at, lo_at)
