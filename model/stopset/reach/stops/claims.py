"""Claims of accelerations on a step of the tube: guessed, turned into speeds, and verified or grown."""

from __future__ import annotations

import numpy as np
from numba import njit

from stopset.robot.rigid import Array


@njit(cache=True)
def claimed_speeds(
    h: float, lo: Array, hi: Array, claim: Array, cap: Array, w_lo: Array, w_hi: Array, plus: Array, minus: Array, zero: Array,
    a_far: Array,
) -> None:  # fmt: skip
    """Speeds on a step under the claimed accelerations and the caps, and which signs are possible."""
    for i in range(lo.shape[0]):
        z = lo[i] + h * min(0.0, claim[0, i] if lo[i] > 0.0 else claim[2, i])
        if lo[i] > 0.0 and z <= 0.0:
            z = h * min(0.0, claim[2, i])
        w_lo[i] = max(z, -cap[i])
        z = hi[i] + h * max(0.0, claim[3, i] if hi[i] < 0.0 else claim[1, i])
        if hi[i] < 0.0 and z >= 0.0:
            z = h * max(0.0, claim[1, i])
        w_hi[i] = min(z, cap[i])
        plus[i] = 1.0 if w_hi[i] > 0.0 else 0.0
        minus[i] = 1.0 if w_lo[i] < 0.0 else 0.0
        zero[i] = 1.0 if w_lo[i] <= 0.0 and w_hi[i] >= 0.0 else 0.0
        a_far[i] = 0.0
        if plus[i] > 0.0:
            a_far[i] = max(abs(claim[0, i]), abs(claim[1, i]))
        if minus[i] > 0.0:
            a_far[i] = max(a_far[i], max(abs(claim[2, i]), abs(claim[3, i])))


@njit(cache=True)
def guess_claims(claim: Array, out: Array, last: Array, k: int) -> None:
    """Claims for step k: the last step's rates, carried on as they changed, and a little more."""
    for i in range(claim.shape[1]):
        for row in range(4):
            guess = out[row, i] if k > 0 and np.isfinite(out[row, i]) else 0.0
            step = guess - last[row, i] if k > 1 else 0.0
            grow = 0.02 * abs(guess) + 1e-3 + abs(step)
            lower = row == 0 or row == 2
            claim[row, i] = guess + min(step, 0.0) - grow if lower else guess + max(step, 0.0) + grow
            last[row, i] = guess
        # a joint that could not start from rest is first taken not to start
        if k > 0 and out[1, i] <= 0.0:
            claim[1, i] = min(claim[1, i], 0.0)
        if k > 0 and out[2, i] >= 0.0:
            claim[2, i] = max(claim[2, i], 0.0)


@njit(cache=True)
def claims_hold(out: Array, claim: Array, plus: Array, minus: Array, zero: Array) -> bool:
    """Do the accelerations lie inside the claims? If not, the claims grow.

    A joint at rest on the whole step (neither sign possible) only has to be kept from starting.
    """
    good = True
    for i in range(claim.shape[1]):
        for row in range(4):
            used = plus[i] > 0.0 or (row == 1 and zero[i] > 0.0) if row < 2 else minus[i] > 0.0 or (row == 2 and zero[i] > 0.0)
            if not used:
                continue
            value = out[row, i]
            if row == 0 or row == 2:
                if value < claim[row, i] and not (row == 2 and minus[i] == 0.0 and value >= 0.0):
                    good = False
                    claim[row, i] = value - 0.05 * abs(value) - 1e-3
            elif value > claim[row, i] and not (row == 1 and plus[i] == 0.0 and value <= 0.0):
                good = False
                claim[row, i] = value + 0.05 * abs(value) + 1e-3
    return good


@njit(cache=True)
def nothing_known(out: Array) -> None:
    """Accelerations of which nothing is known."""
    for row in range(10):
        out[row] = -np.inf if row in (0, 2, 5, 7, 9) else np.inf
