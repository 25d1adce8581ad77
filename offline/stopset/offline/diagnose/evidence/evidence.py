"""How much better an effect explains the rows than the model without it: a mixed model's evidence.

Each joint's rows are independent after whitening, but for one thing: from trial to trial the friction of a joint scales by a
per cent or two, its Coulomb and its viscous part each on its own.  Those scales are random effects of the trial with
deviation ``sigma`` (one per joint, found by maximum likelihood for each hypothesis on its own).  So a cause that only differs
between trials, like warming, is judged by the number of trials, not of samples.  All else is linear algebra on sums over
rows ("Grams"), built once and bordered when columns are added.

Source: Laird & Ware (1982), Random-effects models for longitudinal data.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dtrtrs

from stopset.types import Array, Index

REPEATED = 1e-12  # of a matrix's largest eigenvalue: rounding
RIDGES = (1e-10, 1e-8, 1e-6, 1e-4)  # relative, the first that makes a matrix of repeated columns regular


@dataclass(slots=True)
class JointGram:
    """One joint's whitened columns and their sums.

    ``parts``: the columns (K, ...) in blocks beside each other, which Grams of one engine share; ``G`` (F, c, c) by fold; per trial
    ``g`` (T, r, c) = f'X and ``ff`` (T, r) = f'f with the random effects' columns ``f`` (K, r), turned within each trial so that
    these are orthogonal; ``index`` (c,): the columns' numbers in the whole.
    """

    parts: tuple[Array, ...]
    f: Array
    row_fold: Index  # (K,)
    starts: Index  # (T,) first row of each trial
    ends: Index
    trial: Index  # (T,)
    trial_fold: Index  # (T,)
    index: Index
    G: Array
    g: Array
    ff: Array
    of_a_view: bool = False  # few columns, asked again and again: kept in their places in the whole, too
    _at: dict[tuple[float, float], tuple[Array, float]] = field(default_factory=dict)
    _among_all: dict[tuple[float, float], tuple[Array, float]] = field(default_factory=dict)
    _whole: Array | None = None  # (c, c) `G` of all folds

    @property
    def X(self) -> Array:
        """(K, c) all columns, copied."""
        return np.concatenate(self.parts, axis=1)

    def _places(self) -> list[tuple[Array, int, int]]:
        """Each part with its first column's place and that after its last one."""
        ends = np.cumsum([p.shape[1] for p in self.parts])
        return [(p, int(end) - p.shape[1], int(end)) for p, end in zip(self.parts, ends, strict=True)]

    @staticmethod
    def of(X: Array, f: Array, trial: Index, fold_of_trial: Index, folds: int, index: Index) -> JointGram:
        """Sums of ``X``; ``trial`` (K,) of each row, trials together, -1 for poses at the end (they count to fold 0)."""
        moving = trial >= 0
        starts = np.flatnonzero(np.diff(trial[moving], prepend=-2) != 0)
        ends = np.append(starts, moving.sum())[1:].astype(np.intp)  # none of a joint that stands
        used = trial[moving][starts]
        r = f.shape[1]
        empty = JointGram(
            (), f, np.where(moving, fold_of_trial[trial], 0), starts, ends, used, fold_of_trial[used], index[:0],
            np.zeros((folds, 0, 0)), np.zeros((len(starts), r, 0)), np.zeros((len(starts), r)),
        )  # fmt: skip
        empty._orthogonal()
        return empty.bordered(X, index)

    def _orthogonal(self) -> None:
        """Turn the two columns of each trial into orthogonal ones: their scales have equal priors, so nothing else changes."""
        last = int(self.ends[-1]) if len(self.ends) else 0
        self.ff, turns = np.linalg.eigh(self._by_trial(self.f))
        turned = np.einsum("kr,krs->ks", self.f[:last], np.repeat(turns, self.ends - self.starts, axis=0))
        self.f = np.concatenate([turned, self.f[last:]])

    def _by_trial(self, w: Array) -> Array:
        """(T, r, k): f'w of each trial."""
        if not len(self.starts):
            return np.zeros((0, self.f.shape[1], w.shape[1]))
        last = int(self.ends[-1])
        out = [np.add.reduceat(w[:last] * self.f[:last, c, None], self.starts, axis=0) for c in range(self.f.shape[1])]
        return np.stack(out, axis=1)

    def bordered(self, w: Array, index: Index, *, rows: bool = True) -> JointGram:
        """With the further columns ``w`` (K, k); without any ``rows`` where only the sums are asked for."""
        k, c = w.shape[1], len(self.index)
        G = np.zeros((len(self.G), c + k, c + k))
        G[:, :c, :c] = self.G
        for at, fold in self._runs():
            for part, first, last in self._places():
                G[fold, first:last, c:] += part[at].T @ w[at]
            G[fold, c:, c:] += w[at].T @ w[at]
        G[:, c:, :c] = G[:, :c, c:].transpose(0, 2, 1)
        return JointGram(
            (*self.parts, w) if rows else (), self.f, self.row_fold, self.starts, self.ends, self.trial, self.trial_fold,
            np.concatenate([self.index, index]), G, np.concatenate([self.g, self._by_trial(w)], axis=2), self.ff,
        )  # fmt: skip

    def _runs(self) -> Iterator[tuple[slice, int]]:
        """Rows of one fold beside each other, and the fold."""
        begin = np.flatnonzero(np.diff(self.row_fold, prepend=-1) != 0)
        for start, end in pairwise([*begin.tolist(), len(self.row_fold)]):
            yield slice(start, end), int(self.row_fold[start])

    def keep(self, local: Index, *, rows: bool = True) -> JointGram:
        """The same sums over some of the columns, ``local`` in order; without their ``rows`` where only the sums are asked for."""
        taken = []
        for part, first, last in self._places() if rows else ():
            here = local[(first <= local) & (local < last)] - first
            if len(here):
                taken.append(part if len(here) == last - first else part[:, here])
        return JointGram(
            tuple(taken), self.f, self.row_fold, self.starts, self.ends, self.trial,
            self.trial_fold, self.index[local], self.G[:, local][:, :, local], self.g[:, :, local], self.ff,
        )  # fmt: skip

    def at(self, sigma: float, kappa: float, folds: NDArray[np.bool_] | None = None) -> tuple[Array, float]:
        """Gram (c, c) and log determinant with friction scale ``sigma`` and noise variance ``kappa``; of some ``folds``."""
        if folds is not None:
            chosen = folds[self.trial_fold]
            return self._marginal(self.G[folds].sum(axis=0), self.g[chosen], self.ff[chosen], sigma, kappa)
        if (sigma, kappa) not in self._at:
            if self._whole is None:
                self._whole = self.G.sum(axis=0)
            self._at[sigma, kappa] = self._marginal(self._whole, self.g, self.ff, sigma, kappa)
        return self._at[sigma, kappa]

    def among_all(self, sigma: float, kappa: float) -> tuple[Array, float]:
        """`at`, its columns in their places in the whole, which ends with the last of them; zero between."""
        if (sigma, kappa) not in self._among_all:
            part, logdet = self.at(sigma, kappa)
            size = int(self.index.max(initial=-1)) + 1
            whole = np.zeros((size, size))
            whole[self.index[:, None], self.index] = part
            self._among_all[sigma, kappa] = whole, logdet
        return self._among_all[sigma, kappa]

    @staticmethod
    def _marginal(G: Array, g: Array, ff: Array, sigma: float, kappa: float) -> tuple[Array, float]:
        """The trials' friction scales integrated out."""
        ratio = kappa / sigma**2
        w = (g / np.sqrt(ff + ratio)[:, :, None]).reshape(-1, G.shape[0])
        logdet = np.log(ff + ratio).sum() - ff.size * np.log(ratio)
        return (G - w.T @ w) / kappa, float(logdet)

    def times(self, theta: Array) -> Array:
        """(K,) the columns' sum with the coefficients ``theta`` (c,)."""
        out = np.zeros(len(self.f))
        for part, first, last in self._places():
            out += part @ theta[first:last]
        return out

    def residual(self, theta: Array, sigma: float, kappa: float) -> Array:
        """(K,) whitened residual at the coefficients ``theta`` (c,), each trial's friction scales taken out."""
        return self._less_scales(self.times(theta), self.g @ theta, sigma, kappa)

    def left_by_folds(self, theta: Array, sigma: float, kappa: float) -> tuple[Array, Array]:
        """(K,) `times` and `residual` of every row with the coefficients of its own fold, ``theta`` (F, c)."""
        whole = np.zeros(len(self.f))
        for rows, fold in self._runs():
            for part, first, last in self._places():
                whole[rows] += part[rows] @ theta[fold, first:last]
        scales = np.einsum("trc,tc->tr", self.g, theta[self.trial_fold])
        return whole, self._less_scales(whole.copy(), scales, sigma, kappa)

    def _less_scales(self, out: Array, summed: Array, sigma: float, kappa: float) -> Array:
        """``out`` (K,) without the likeliest friction scales of each trial, by the sums (T, r) of the random effects with it."""
        b = summed / (self.ff + kappa / sigma**2)
        last = int(self.ends[-1]) if len(self.ends) else 0
        out[:last] -= np.sum(self.f[:last] * np.repeat(b, self.ends - self.starts, axis=0), axis=1)
        return out


@dataclass(frozen=True, slots=True)
class Projection:
    """What is left of columns and y after the nuisance: ``S`` (m, m), ``s`` (m,), ``rss``; its fit; its log determinant."""

    S: Array
    s: Array
    rss: float
    theta: Array
    logdet: float


def _factor(A: Array) -> Array:
    """Cholesky factor of a scaled matrix; columns that repeat each other (a joint that never turns) leave it singular to rounding."""
    for ridge in RIDGES[:-1]:
        try:
            return np.asarray(np.linalg.cholesky(_more(A, ridge)))
        except np.linalg.LinAlgError:
            continue
    return np.asarray(np.linalg.cholesky(_more(A, RIDGES[-1])))


def _more(A: Array, diagonal: Array | float) -> Array:
    """A copy with more on its diagonal."""
    out = A.copy()
    out.flat[:: len(A) + 1] += diagonal
    return out


def _solved(L: Array, b: Array, *, turned: bool = False) -> Array:
    """``L^-1 b`` of a Cholesky factor, or of it ``turned``: LAPACK's own, as asked thousands of times its wrapper takes longer."""
    out, info = dtrtrs(L.T, b, lower=0, trans=0 if turned else 1)
    if info:
        raise np.linalg.LinAlgError(f"zero at {info} of a Cholesky factor's diagonal")
    return np.asarray(out)


def block(G: Array, rows: Index, columns: Index) -> Array:
    """``G[np.ix_(rows, columns)]``; of runs of neighbours a view, which is several times as fast."""
    if _run(rows) and _run(columns):
        return G[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    return np.asarray(G[rows[:, None], columns])


def _run(index: Index) -> bool:
    return len(index) > 0 and bool(index[-1] - index[0] == len(index) - 1 and (index[1:] - index[:-1] == 1).all())


def project(G: Array, y: int, nuisance: Index, rest: Index, precision: Array, mean: Array) -> Projection:
    """Take the ``nuisance`` (with prior ``mean`` and ``precision``) out of the columns ``rest`` and of ``y``."""
    y_nuisance, y_rest, square = G[nuisance, y], G[rest, y], float(G[y, y])
    at = np.flatnonzero(mean)
    if len(at):
        known, m = nuisance[at], mean[at]
        y_nuisance, y_rest = y_nuisance - block(G, nuisance, known) @ m, y_rest - block(G, rest, known) @ m
        square = float(square - 2 * m @ G[known, y] + m @ block(G, known, known) @ m)
    A = _more(block(G, nuisance, nuisance), precision)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(A), 1e-30))
    A *= np.outer(scale, scale)
    L = _factor(A)
    B = np.column_stack([block(G, nuisance, rest), y_nuisance]) * scale[:, None]
    W = _solved(L, B)
    S = block(G, rest, rest) - W[:, :-1].T @ W[:, :-1]
    s = y_rest - W[:, :-1].T @ W[:, -1]
    rss = float(square - W[:, -1] @ W[:, -1])
    theta = mean + scale * _solved(L, W[:, -1], turned=True)
    return Projection(S, s, rss, theta, float(2 * np.log(np.diag(L)).sum() - 2 * np.log(scale).sum()))


def gain(S: Array, s: Array, precision: Array) -> tuple[float, Array, Array]:
    """Twice the log Bayes factor of a group, its parameters (k,) and their covariance (k, k).

    ``S, s``: the group's part of a `Projection`; ``precision`` (k,): of the parameters' zero-mean normal prior.
    """
    value, theta, cov = gains(S[None], s[None], precision[None])
    return float(value[0]), theta[0], cov[0]


def gains(S: Array, s: Array, precision: Array) -> tuple[Array, Array, Array]:
    """`gain` of m groups of as many terms: ``S`` (m, k, k), ``s`` and ``precision`` (m, k); (m,), (m, k), (m, k, k)."""
    if s.shape[1] == 1:
        total = np.maximum(S[:, :, 0] + precision, 1e-300)
        value = s**2 / total - np.maximum(np.log(total / precision), 0.0)
        return value[:, 0], s / total, 1.0 / total[:, :, None]
    A = S + precision[:, :, None] * np.eye(s.shape[1])
    scale = 1.0 / np.sqrt(np.maximum(np.diagonal(A, axis1=1, axis2=2), 1e-300))
    w, V = np.linalg.eigh(A * (scale[:, :, None] * scale[:, None, :]))
    size = np.abs(w)
    sound = size > REPEATED * size.max(axis=1, keepdims=True)  # a group whose columns repeat each other has fewer directions
    half = V * scale[:, :, None]
    cov = (half * (sound / np.where(sound, w, 1.0))[:, None, :]) @ half.transpose(0, 2, 1)
    theta = (cov @ s[:, :, None])[:, :, 0]
    logdet = np.where(np.prod(np.sign(w), axis=1) > 0, np.log(np.maximum(size, 1e-300)).sum(axis=1), 0.0)
    occam = logdet - 2 * np.log(scale).sum(axis=1) - np.log(precision).sum(axis=1)
    return (s * theta).sum(axis=1) - np.maximum(occam, 0.0), theta, cov
