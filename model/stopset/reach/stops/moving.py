"""Accelerations of an arm whose joints slide or stick, whoever does which.

At almost every time the joints split into moving ones ``f`` and resting ones, with acceleration exactly zero for these,
and ``M_ff a_f = r_f``.  Every subset of the joints whose state is uncertain is visited in Gray-code order, each one pivot
from the last.  Source: Goodnight (1979) for the sweep operator.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from stopset.robot.rigid import Array

ROUNDING = 1e-9  # relative outward widening of accelerations; the arithmetic itself errs by some 1e-13


@njit(cache=True)
def pivot(A: Array, k: int, into: bool) -> None:
    """Sweep joint k into (or out of) the moving set: A_ff = -M_ff^-1, A_sf = M_sf M_ff^-1, A_ss = Schur complement."""
    n = A.shape[0]
    d = 1.0 / A[k, k]
    for i in range(n):
        if i != k:
            c = A[i, k] * d
            for j in range(n):
                if j != k:
                    A[i, j] -= c * A[k, j]
    s = d if into else -d
    for i in range(n):
        if i != k:
            A[i, k] *= s
            A[k, i] *= s
    A[k, k] = -d


@njit(cache=True, inline="always")
def _least(x: float, d: float) -> float:
    """Least of ``x / (1 + e)`` over ``|e| <= d``."""
    if x >= 0.0:
        return x / (1.0 + d)
    return x / (1.0 - d) if d < 1.0 else -np.inf


@njit(cache=True)
def accelerations(
    M: Array, dM: Array, s_lo: Array, s_hi: Array, own_up: Array, own_down: Array, B_lo: Array, B_hi: Array,
    B_later: Array, sign: Array,
    plus: Array, minus: Array, zero: Array, a_far: Array,
    out: Array, work: Array,
) -> None:  # fmt: skip
    """Hull over all moving sets of each joint's acceleration, into ``out`` (10, n).

    ``s``: torque without dry friction; ``own_up``: by how much the viscous torque of the joint itself exceeds its
    smallest value when it moves at the upper speed bound (``own_down``: at the lower bound, below its largest value).
    ``plus, minus, zero``: which signs are possible (1.0 or 0.0).  Rows of ``out`` 0-3: forward lo, hi, backward lo, hi;
    row 4: forward hi at the upper speed bound, row 5: forward lo at the lower; rows 6, 7 the same backward; rows 8, 9:
    forward hi and backward lo of a joint that has rested before, whose dry friction is at least ``B_later``.
    ``sign``: direction in which a joint can move with less than that, 0 for both.
    """
    n = M.shape[0]
    r_lo, r_hi = work[0], work[1]  # any sign that is possible
    f_lo, f_hi, b_lo, b_hi, later = work[2], work[3], work[4], work[5], work[6]  # forward, backward
    for i in range(n):
        push = 0.0
        for j in range(n):
            if j != i:
                push += dM[i, j] * a_far[j]
        f_lo[i], f_hi[i] = s_lo[i] - push - B_hi[i], s_hi[i] + push - (B_lo[i] if sign[i] >= 0.0 else B_later[i])
        b_lo[i], b_hi[i] = s_lo[i] - push + (B_lo[i] if sign[i] <= 0.0 else B_later[i]), s_hi[i] + push + B_hi[i]
        later[i] = B_later[i] - B_lo[i]
        own = dM[i, i] * a_far[i]
        r_lo[i] = (f_lo[i] if plus[i] > 0.0 or minus[i] == 0.0 else b_lo[i]) - own
        r_hi[i] = (b_hi[i] if minus[i] > 0.0 else f_hi[i]) + own
    for i in range(n):
        for row in (0, 2, 5, 7, 9):
            out[row, i] = np.inf
        for row in (1, 3, 4, 6, 8):
            out[row, i] = -np.inf
    A = M.copy()
    inside = np.zeros(n, np.bool_)
    open_ = np.empty(n, np.int64)
    count = 0
    for i in range(n):
        if zero[i] == 0.0:
            pivot(A, i, True)
            inside[i] = True
        elif plus[i] > 0.0 or minus[i] > 0.0:
            open_[count] = i
            count += 1
    subset = 0
    while True:
        for i in range(n):
            if not inside[i] and (plus[i] > 0.0 or minus[i] > 0.0):
                continue  # visited with i moving instead: the same equation
            lo, hi = 0.0, 0.0
            for j in range(n):
                if j == i or not inside[j]:
                    continue
                w = -A[i, j]
                if w > 0.0:
                    lo += w * r_lo[j]
                    hi += w * r_hi[j]
                else:
                    lo += w * r_hi[j]
                    hi += w * r_lo[j]
            # a resting joint would start with this acceleration, were it to start
            w = -A[i, i] if inside[i] else 1.0 / A[i, i]
            if not inside[i]:
                lo *= w
                hi *= w
            # the joint's own inertia M_ii +- dM_ii scales its answer: a_i (1 + w d) = the rest, |d| <= dM_ii
            d = w * dM[i, i]
            if zero[i] > 0.0 or plus[i] > 0.0:
                out[0, i] = min(out[0, i], _least(lo + w * f_lo[i], d))
                out[1, i] = max(out[1, i], -_least(-hi - w * f_hi[i], d))
                out[4, i] = max(out[4, i], -_least(-hi - w * (f_hi[i] - own_up[i]), d))
                out[5, i] = min(out[5, i], _least(lo + w * (f_lo[i] + own_down[i]), d))
                rested = later[i] if sign[i] >= 0.0 else 0.0
                out[8, i] = max(out[8, i], -_least(-hi - w * (f_hi[i] - rested), d))
            if zero[i] > 0.0 or minus[i] > 0.0:
                out[2, i] = min(out[2, i], _least(lo + w * b_lo[i], d))
                out[3, i] = max(out[3, i], -_least(-hi - w * b_hi[i], d))
                out[6, i] = max(out[6, i], -_least(-hi - w * (b_hi[i] - own_up[i]), d))
                out[7, i] = min(out[7, i], _least(lo + w * (b_lo[i] + own_down[i]), d))
                rested = later[i] if sign[i] <= 0.0 else 0.0
                out[9, i] = min(out[9, i], _least(lo + w * (b_lo[i] + rested), d))
        subset += 1
        if subset >= 1 << count:
            break
        bit = 0
        while (subset >> bit) & 1 == 0:
            bit += 1
        k = open_[bit]
        pivot(A, k, not inside[k])
        inside[k] = not inside[k]
    for row in range(10):
        for i in range(n):
            slack = ROUNDING * (abs(out[row, i]) + 1.0)
            if row in (0, 2, 5, 7, 9):
                out[row, i] -= slack
            else:
                out[row, i] += slack
