"""The heavy loops of the envelope, in the compiled core: deviations of all windows of a trial side by side, and their extremes.

They release the interpreter.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from stopset.core.library import check, ffi, given, integers, lib, view
from stopset.types import Array, Index


class Outermost(NamedTuple):
    """The widest deviations found so far, upward and downward (ages, states), and (trial, start) of each (ages, states, 2)."""

    hi: Array
    lo: Array
    hi_at: Index
    lo_at: Index


def _envelope(trial: int, worst: Outermost) -> Any:
    hi, lo, hi_at, lo_at = worst
    ages, columns = hi.shape
    if lo.shape != hi.shape or hi_at.shape != (ages, columns, 2) or lo_at.shape != hi_at.shape:
        raise ValueError(
            f"envelope of shapes {hi.shape}, {lo.shape}, {hi_at.shape}, {lo_at.shape}; expected one of ages and states"
        )
    return ffi.new("StopsetEnvelope *", (ages, columns, trial, view(hi), view(lo), integers(hi_at), integers(lo_at)))


def _columns(residual: Array, starts: int, states: int) -> Array:
    if not 1 <= starts <= len(residual) or residual.shape[1] != states:
        raise ValueError(
            f"{starts} windows in a residual of shape {residual.shape}; expected 1 to {len(residual)} of {states} states"
        )
    return np.ascontiguousarray(residual.T)


def update_decoupled(a: Array, residual: Array, starts: int, trial: int, worst: Outermost) -> None:
    """`update` of joints on their own, each in one pass over its windows: ``a`` (n, 2, 2), ``residual`` (N-1, 2n)."""
    n, r, work = len(a), _columns(residual, starts, 2 * len(a)), np.empty((2, starts))
    if worst.hi.shape[1] != 2 * n or a.shape != (n, 2, 2):
        raise ValueError(f"steps {a.shape} into an envelope of {worst.hi.shape[1]} columns")
    envelope = _envelope(trial, worst)
    check(lib.stopset_widen_decoupled(envelope, n, view(given(a)), r.shape[1], view(r), starts, view(work)))


def update(Ad: Array, across: Array, residual: Array, starts: int, trial: int, worst: Outermost) -> None:
    """``e(h+1) = Ad e(h) + r`` of all windows side by side, looked at along ``across`` (k, n), positions, then speeds.

    Zeros of ``Ad`` and ``across`` cost nothing.
    """
    k, n = across.shape
    r, work = _columns(residual, starts, 2 * n), np.empty((4 * n + 1, starts))
    if worst.hi.shape[1] != 2 * k or Ad.shape != (2 * n, 2 * n):
        raise ValueError(f"steps {Ad.shape} along {across.shape} into an envelope of {worst.hi.shape[1]} columns")
    envelope = _envelope(trial, worst)
    held = given(Ad), given(across)
    step = ffi.new("StopsetLooked *", (n, k, *(view(x) for x in held)))
    check(lib.stopset_widen_coupled(envelope, step, r.shape[1], view(r), starts, view(work)))
