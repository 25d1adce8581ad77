"""The noise that the sensors themselves leave in a smoothed row, and the filter that makes its rows independent.

Nothing here looks at the model's residual, so a hidden effect can't be taken for noise: the torque's white noise and the
position's, which reaches the row through the acceleration times the inertia, are measured from fourth differences.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stopset.core.library import ffi, flags, given, integers, lib, view
from stopset.offline.diagnose.rows.prepare import Kernel
from stopset.types import Array, Index, Mask

ORDER = 6  # rows the prediction looks back: the kernel's correlation is below 1e-4 after 5 rows


def autocovariance(kernel: Kernel, step: int, torque: float, acceleration: float) -> Array:
    """(ORDER + 1,) autocovariance [N m]^2 of a row of one joint at lags of whole rows.

    ``torque``: white noise of the torque [N m]; ``acceleration``: white noise of the position times inertia [N m s^2].
    """
    out = np.zeros(ORDER + 1)
    for k in range(ORDER + 1):
        lag = k * step
        for h, s in ((kernel.h, torque), (kernel.h2, acceleration)):
            if lag < len(h):
                out[k] += s**2 * float(h[lag:] @ h[: len(h) - lag])
    return out


def predictor(c: Array) -> tuple[Array, Array]:
    """Levinson's recursion: coefficients (ORDER + 1, ORDER) and deviations (ORDER + 1,) for 0, 1, ... rows of history."""
    n = len(c) - 1
    a, var = np.zeros((n + 1, n)), np.zeros(n + 1)
    var[0] = c[0]
    for m in range(1, n + 1):
        k = (c[m] - a[m - 1, : m - 1] @ c[m - 1 : 0 : -1]) / var[m - 1]
        a[m, : m - 1] = a[m - 1, : m - 1] - k * a[m - 1, : m - 1][::-1]
        a[m, m - 1] = k
        var[m] = var[m - 1] * max(1.0 - k * k, 1e-6)
    return a, np.sqrt(var)


@dataclass(frozen=True, slots=True)
class Whitening:
    """Makes K rows independent: ``a`` (P, ORDER + 1, ORDER), ``sd`` (P, ORDER + 1) of `predictor` for each kind of row, ``kind``
    (K,) of each row, ``start`` (K,): a new run of rows begins."""

    start: Mask
    kind: Index
    a: Array
    sd: Array

    @staticmethod
    def of(start: Mask, kind: Index, covariances: Sequence[Array]) -> Whitening:
        """For rows of these `autocovariance`s, one for each kind."""
        a, sd = zip(*map(predictor, covariances), strict=True)
        return Whitening(start, np.ascontiguousarray(kind, np.int64), np.stack(a), np.stack(sd))

    def __call__(self, X: Array) -> Array:
        """Rows (K, k) minus their prediction from the rows before, in units of its deviation."""
        out = np.empty(X.shape)
        lib.stopset_whiten(self.struct(len(X)), *X.shape, view(given(X)), flags(self.start), view(out))
        return out

    def coloured(self, e: Array) -> Array:
        """The rows again out of their whitened values: the inverse for one column."""
        out = np.empty(e.shape)
        lib.stopset_coloured(self.struct(len(e)), len(e), view(given(e)), flags(self.start), view(out))
        return out

    def adjoint(self, r: Array) -> Array:
        """The rows whose product with plain columns equals that of ``r`` with the whitened ones."""
        out = np.empty(r.shape)
        lib.stopset_whiten_adjoint(self.struct(len(r)), len(r), view(given(r)), flags(self.start), view(out))
        return out

    def power(self, covariances: Array) -> Array:
        """(P,) variance that a noise of this autocovariance (ORDER + 1,) is left with in rows of each kind, far from a run's beginning."""
        lag = np.abs(np.subtract.outer(np.arange(ORDER + 1), np.arange(ORDER + 1)))
        filters = np.column_stack([np.ones(len(self.sd)), -self.a[:, -1]]) / self.sd[:, -1:]
        out: Array = np.einsum("pi,ij,pj->p", filters, covariances[lag], filters)
        return out

    def struct(self, rows: int) -> Any:
        """For the core, which reads as many rows."""
        kinds, order = len(self.sd), self.sd.shape[1] - 1
        if self.a.shape != (kinds, order + 1, order) or not len(self.start) == len(self.kind) == rows:
            raise ValueError(
                f"a predictor of shapes {self.a.shape}, {self.sd.shape} for {rows} rows with {len(self.start)} beginnings"
            )
        if rows and not 0 <= self.kind.min() <= self.kind.max() < kinds:
            raise ValueError(f"rows of kinds {self.kind.min()} to {self.kind.max()} for {kinds} predictors")
        return ffi.new("StopsetPredictor *", (order, view(self.a), view(self.sd), integers(self.kind)))
