"""The fit itself: weighted normal equations of all joints, the CAD as prior, friction that never pushes, possible bodies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri, stdtrit

from stopset.offline.nominal.floor import Floor
from stopset.offline.nominal.friction import ParameterLimits, passivity, ranges, worst
from stopset.offline.nominal.normal_equations import TOGETHER, Layout, NormalEquations
from stopset.offline.nominal.physical import consistent, solve_consistent
from stopset.offline.nominal.prior import Prior
from stopset.offline.nominal.qp import solve_qp
from stopset.types import Array

ROUNDS = 8  # of re-weighting: noise levels settle to 1 % within four
FEW_GROUPS = 4  # with fewer groups of motions the correlation of errors cannot be seen
MOST_INFLATION = 1000.0
ASSUMED_SPREAD = 0.02  # of friction from motion to motion, where one motion cannot tell
ASSUMED_FREEDOM = 4.0  # motions that the assumed spread counts for beside those seen
COVERED = 0.975  # by two standard errors, one-sided
# [N m] of one unit of a parameter, root mean square over the rows: less is a rounded zero, as a cosine of 90 degrees leaves it, and scaled
# to one it would count as a direction that the data determine, in which rounding decides how correlated errors are
FELT = 1e-9
RIDGE = 1e-6  # relative: moves a well-determined friction parameter by a millionth
WIDEST_PRIOR = 30.0  # times: a CAD further off than this is another robot
NOTABLY_OFF = 1.5  # times: a description is said to be contradicted
ANOTHER_ARM = 8.0  # times: a real UR10e is 3.5 off its own description, 9 off a UR10's, 30 with a joint's zero a right angle off
# by which something undescribed at the last link must lower minus twice the log evidence: 2.8 kg on a real arm lower it by 75 to 550, and
# by 12 on a simulated one of three joints; four real arms that carried nothing by 3 at most
CLEARLY = 10.0


@dataclass(frozen=True, slots=True)
class Fit:
    """``theta``, ``covariance``: all parameters; ``sigma, sigma_still, inflation`` (n,): noise of a row, motions and poses."""

    theta: Array
    covariance: Array
    sigma: Array
    sigma_still: Array
    inflation: Array
    precision: Array  # of the description, as it counted
    rms: Array
    rms_before: Array
    notes: tuple[str, ...]
    limited: tuple[str, ...]  # those of the notes that say what a limit decided
    off: float  # times its tolerance that the description is off, at least 1


@dataclass(slots=True)
class _Problem:
    """Reduced sums of each joint: ``A[j] (k, k), b[j] (k,), yy[j]`` with ``k`` its own columns, motions and poses apart."""

    layout: Layout
    index: list[NDArray[np.intp]]
    moving: list[Array]
    still: list[Array]
    rows: Array
    rows_still: Array


def problem_of(layout: Layout, moving: Array, still: Array, rows: Array, rows_still: Array) -> _Problem:
    n = layout.n
    index = [layout.index(j) for j in range(n)]
    cut = [np.r_[0 : len(index[j]), moving.shape[-1] - 1] for j in range(n)]
    return _Problem(
        layout, index,
        [moving[j][np.ix_(cut[j], cut[j])] for j in range(n)],
        [still[j][np.ix_(cut[j], cut[j])] for j in range(n)],
        rows, rows_still,
    )  # fmt: skip


def residual(G: Array, theta: Array) -> float:
    """Sum of squared residuals of one joint, from its normal matrix with the torque last."""
    v = np.append(theta, -1.0)
    return max(float(v @ G @ v), 0.0)


def assemble(p: _Problem, w: Array, w_still: Array, precision: Array, mean: Array) -> tuple[Array, Array]:
    """Normal matrix and right-hand side of all parameters."""
    size, m = p.layout.size, len(mean)
    H, b = np.zeros((size, size)), np.zeros(size)
    for j in range(p.layout.n):
        G = w[j] * p.moving[j] + w_still[j] * p.still[j]
        at = p.index[j]
        H[np.ix_(at, at)] += G[:-1, :-1]
        b[at] += G[:-1, -1]
    H[:m, :m] += precision
    b[:m] += precision @ mean
    # friction has no prior: a weak pull to zero keeps columns that never moved, or always move together, regular
    own = np.diag(H)[m:].copy()
    typical = float(np.median(own[own > 0])) if (own > 0).any() else 1.0
    H[range(m, size), range(m, size)] += RIDGE * (own + typical)
    return H, b


def _solve(
    p: _Problem, H: Array, b: Array, limits: ParameterLimits, floor: Floor, speed: Array, reference: Array
) -> tuple[Array, list[str], list[str]]:
    """Parameters under all limits, what was done, and of that what a limit decided."""
    notes: list[str] = []
    limited: list[str] = []
    n = p.layout.n
    theta, active = solve_qp(H, b, limits.A, limits.lower, limits.upper)
    weak = floor.binding(theta, np.asarray(np.linalg.inv(H), np.float64))
    if weak.joint:
        limits = limits + weak.limits
        theta, active = solve_qp(H, b, limits.A, limits.lower, limits.upper)
    for _ in range(20):
        more = worst(p.layout, theta, speed)
        if not len(more.A):
            break
        limits = limits + more
        theta, active = solve_qp(H, b, limits.A, limits.lower, limits.upper)
    names = p.layout.names()
    held = {names[k] for row in limits.A[active] for k in np.flatnonzero(row)}
    if held:
        limited.append(f"held at a limit (admissible range, or friction that would push): {', '.join(sorted(held))}")
        notes.append(limited[-1])
    if not consistent(theta[: 10 * n].reshape(n, 10), reference):
        theta = solve_consistent(H, b, limits.A, limits.lower, limits.upper, reference)
        notes.append("inertias moved to the nearest that bodies can have (positive definite pseudo-inertia)")
    for j in dict.fromkeys(weak.joint):
        why = next(w for k, w in zip(weak.joint, weak.why, strict=True) if k == j)
        limited.append(
            f"held at a physical floor: the rotor inertia of {p.layout.joints[j]} at {theta[10 * n + j]:.3g} kg m^2; these recordings "
            f"determine it too weakly, and with less {why}"
        )
        notes.append(limited[-1])
    return theta, notes, limited


@dataclass(frozen=True, slots=True)
class _Scores:
    """A joint's scores of whole groups of motions, ``torque - columns @ theta`` in the directions its data determine."""

    torque: Array  # (groups, directions)
    columns: Array  # (groups, directions, k)

    def inflation(self, theta: Array, variance: float) -> float:
        """How much wider errors are than for independent rows."""
        m, directions = self.torque.shape
        z = self.torque - self.columns @ theta
        ratio = float(np.sum(z**2)) * m / (m - 1) / (max(variance, 1e-300) * directions)
        return float(np.clip(ratio, 1.0, MOST_INFLATION))


def to_unit_length(squares: Array, rows: float) -> Array:
    """(k,) what scales columns of these ``squares``, summed over ``rows``, to length one; zero for what is zero but for rounding."""
    felt = squares > FELT**2 * rows
    return np.where(felt, 1 / np.sqrt(np.where(felt, squares, 1.0)), 0.0)


def _scores(data: NormalEquations, moving: Array, p: _Problem) -> list[_Scores | None]:
    """Of each joint; None with too few groups to tell."""
    out: list[_Scores | None] = []
    for j in range(p.layout.n):
        groups = np.flatnonzero(data.rows_moving[:, j] > 0)
        if len(groups) < FEW_GROUPS:
            out.append(None)
            continue
        cut = np.r_[0 : len(p.index[j]), moving.shape[-1] - 1]
        G = moving[groups, j][:, cut][:, :, cut]
        A = G[:, :-1, :-1].sum(axis=0)
        d = to_unit_length(np.diag(A), float(data.rows_moving[groups, j].sum()))
        values, vectors = np.linalg.eigh(d[:, None] * A * d)
        sound = values > 1e-7 * values[-1]
        W = (d[:, None] * vectors[:, sound] / np.sqrt(values[sound])).T
        out.append(_Scores(G[:, :-1, -1] @ W.T, W @ G[:, :-1, :-1]))
    return out


def fit(data: NormalEquations, moving: Array, still: Array, prior: Prior, floor: Floor, reference: Array) -> Fit:
    """Weighted least squares of all joints at once.

    ``moving`` (GROUPS, n, c, c), ``still`` (n, c, c): sums with one torque column last; weights, the correlation of errors and
    the spread of the CAD's errors are estimated with the parameters (empirical Bayes): a CAD that the data contradict
    counts for less.
    """
    layout, n = data.layout, data.layout.n
    rows, rows_still = data.rows_moving.sum(axis=0), data.rows_still
    p = problem_of(layout, moving.sum(axis=0), still, rows, rows_still)
    # a description believed too much explains itself: what it leaves then counts as noise, and the noise lets it be believed
    starts = [(1.0, False), (WIDEST_PRIOR, False), (1.0, True), (WIDEST_PRIOR, True)]
    scores = _scores(data, moving, p)
    tried = [_weighed(p, scores, prior, scale, loaded=loaded) for scale, loaded in starts]
    weighed = min(tried, key=lambda x: x.unlikely + CLEARLY * x.loaded)
    variance, variance_still, inflation, scale, H, b = (
        weighed.variance, weighed.variance_still, weighed.inflation, weighed.scale, weighed.H, weighed.b
    )  # fmt: skip
    limits = ranges(layout) + passivity(layout, *_seen(data))
    theta, notes, limited = _solve(p, H, b, limits, floor, _seen(data)[0], reference)
    if scale > NOTABLY_OFF:
        notes.append(
            f"the CAD is contradicted: its errors are {scale:.1f} times the tolerance, so it counted for less{another_arm(scale)}"
        )
    if weighed.loaded:
        notes.append(_carried(layout, theta, prior))
    rms: Array = np.array([np.sqrt(residual(p.moving[j], theta[p.index[j]]) / rows[j]) if rows[j] else np.nan for j in range(n)])
    return Fit(
        theta, np.asarray(np.linalg.inv(H), np.float64), np.sqrt(variance), np.sqrt(variance_still), inflation, weighed.precision, rms,
        _before(p, prior, rows), tuple(notes), tuple(limited), scale,
    )  # fmt: skip


def another_arm(off: float) -> str:
    """What to look at where a description is ``off`` by so many times its tolerance that masses hardly explain it; else nothing."""
    return "" if off < ANOTHER_ARM else (
        "; unless its masses are placeholders, look at the zeros and axes of the joints and at how the arm is mounted: what the TCP and "
        "the links sweep in a stop is the description's"
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Weighed:
    """Weights that agree with the parameters they give: variances, correlation, the description's scale; normal equations.

    ``loaded``: whether the last link may carry what is not described; ``precision``: of the description, as it counted;
    ``unlikely``: minus twice the log evidence, up to a constant of the data.
    """

    variance: Array
    variance_still: Array
    inflation: Array
    scale: float
    loaded: bool
    precision: Array
    H: Array
    b: Array
    unlikely: float


def _weighed(p: _Problem, scores: Sequence[_Scores | None], prior: Prior, scale: float, *, loaded: bool) -> _Weighed:
    """Rounds of fitting and weighing, beginning with a description that is off by ``scale`` times its tolerance."""
    n, m = p.layout.n, len(prior.mean)
    rows, rows_still = p.rows, p.rows_still
    variance = np.array([0.05**2 * p.moving[j][-1, -1] / max(rows[j], 1) for j in range(n)])
    variance_still = np.array([0.05**2 * p.still[j][-1, -1] / max(rows_still[j], 1) for j in range(n)])
    inflation = np.full(n, TOGETHER)
    # what a link carries says nothing of how good the description is
    judged = np.setdiff1d(np.arange(m), np.arange(m)[prior.last]) if loaded else np.arange(m)
    own_precision = prior.precision[np.ix_(judged, judged)]
    for _ in range(ROUNDS):
        w, w_still = 1 / np.maximum(variance * inflation, 1e-12), 1 / np.maximum(variance_still, 1e-12)
        w, w_still = np.where(rows > 0, w, 0.0), np.where(rows_still > 0, w_still, 0.0)
        precision = prior.believed(scale, loaded=loaded)
        H, b = assemble(p, w, w_still, precision, prior.mean)
        theta: Array = np.asarray(np.linalg.solve(H, b), np.float64)
        for j in range(n):
            own = theta[p.index[j]]
            if rows[j]:
                variance[j] = residual(p.moving[j], own) / rows[j]
                known = scores[j]
                inflation[j] = TOGETHER if known is None else known.inflation(own, variance[j])
            if rows_still[j]:
                variance_still[j] = residual(p.still[j], own) / rows_still[j]
        left = np.linalg.inv(H)[np.ix_(judged, judged)]
        judged_rank = float(len(judged) - np.sum(own_precision / scale**2 * left))
        off = theta[:m] - prior.mean
        scale = float(np.clip(np.sqrt(off[judged] @ own_precision @ off[judged] / max(judged_rank, 1.0)), 1.0, WIDEST_PRIOR))
    counted = float(np.sum(rows / TOGETHER * np.log(np.maximum(variance, 1e-12))))
    counted += float(np.sum(rows_still * np.log(np.maximum(variance_still, 1e-12))))
    unlikely = counted + float(off @ precision @ off) + float(np.linalg.slogdet(H)[1] - np.linalg.slogdet(precision)[1])
    return _Weighed(variance, variance_still, inflation, scale, loaded, precision, H, b, unlikely)


def _carried(layout: Layout, theta: Array, prior: Prior) -> str:
    """What the last link has beyond its description, in words."""
    extra = (theta[: len(prior.mean)] - prior.mean)[prior.last]
    return (
        f"{layout.joints[-1]} carries what the description does not have: by that description alone {extra[0]:.3g} kg, first moment "
        f"{float(np.linalg.norm(extra[1:4])):.3g} kg m (masses of neighbouring links may be shared between them); if it is a load, tell it with "
        "--condition payload=..., if a tool, describe it"
    )


def _seen(data: NormalEquations) -> tuple[Array, Array]:
    speed, load = np.abs(data.speed).max(axis=1), np.abs(data.load).max(axis=1)
    return np.where(np.isfinite(speed), speed, 0.0), np.where(np.isfinite(load), load, 0.0)


def _before(p: _Problem, prior: Prior, rows: Array) -> Array:
    """(n,) residual with CAD and data sheet believed, friction alone fitted."""
    n = p.layout.n
    out = np.full(n, np.nan)
    for j in range(n):
        if not rows[j]:
            continue
        head = 10 * n + 1
        at = p.index[j][:head]
        T = np.zeros((len(p.moving[j]), len(p.moving[j]) - head))
        T[:head, -1] = -prior.mean[at]
        T[head:, :] = np.eye(len(T) - head)
        G = T.T @ p.moving[j] @ T
        own: Array = np.zeros(0)
        if len(G) > 1:
            own = np.asarray(np.linalg.lstsq(G[:-1, :-1], G[:-1, -1], rcond=1e-12)[0], np.float64)
        out[j] = np.sqrt(residual(G, own) / rows[j])
    return out


def leave_out(data: NormalEquations, moving: Array, still: Array, prior: Prior, full: Fit) -> tuple[Array, Array]:
    """Torque residual (n,) on groups of motions left out of the fit, and the covariance widened by how much they matter.

    The widening is the jackknife over groups: friction differs from motion to motion, so that counting samples would
    promise too much; never narrower than the model's own.  It is added as a whole matrix: terms that only their sum is told of
    (a load friction and a mass) shift together, and their torque stays as sure as it is.  Few motions know their own spread badly:
    the assumed one (`ASSUMED_SPREAD`) counts beside theirs like `ASSUMED_FREEDOM` motions more, and it is widened by Student's
    quantile, so that twice the standard error covers 95 %.  With fewer than two groups the residual is nan and the spread is the
    assumed one.

    Source: Bell & McCaffrey (2002), degrees of freedom of clustered standard errors; Smyth (2004), Linear models and empirical
    Bayes methods, for the assumed spread beside a seen one.
    """
    n = data.layout.n
    groups = np.flatnonzero(data.rows_moving.sum(axis=1) > 0)
    if not len(groups):
        return np.full(n, np.nan), full.covariance
    rows, rows_still = data.rows_moving.sum(axis=0), data.rows_still
    w = np.where(rows > 0, 1 / np.maximum(full.sigma**2 * full.inflation, 1e-12), 0.0)
    w_still = np.where(rows_still > 0, 1 / np.maximum(full.sigma_still**2, 1e-12), 0.0)
    felt = _influences(data.layout, moving[groups], w, full)
    assumed = ASSUMED_SPREAD * np.concatenate(list(felt), axis=1)  # (size, terms of all groups)
    if len(groups) < 2:
        return np.full(n, np.nan), full.covariance + assumed @ assumed.T
    total = moving.sum(axis=0)
    squares = np.zeros(n)
    thetas = []
    for g in groups:
        p = problem_of(data.layout, total - moving[g], still, rows, rows_still)
        H, b = assemble(p, w, w_still, full.precision, prior.mean)
        theta: Array = np.asarray(np.linalg.solve(H, b), np.float64)
        left = problem_of(data.layout, moving[g], still, rows, rows_still)
        squares += [residual(left.moving[j], theta[p.index[j]]) for j in range(n)]
        thetas.append(theta)
    m = len(groups)
    freedom = _freedom((felt**2).sum(axis=2))
    both = freedom + ASSUMED_FREEDOM
    wider = stdtrit(both, COVERED) / ndtri(COVERED)
    seen = np.sqrt(freedom / both) * wider * (np.array(thetas) - np.mean(thetas, axis=0))
    assumed *= (np.sqrt(ASSUMED_FREEDOM / both) * wider)[:, None]
    return np.sqrt(squares / np.maximum(rows, 1)), full.covariance + (m - 1) / m * seen.T @ seen + assumed @ assumed.T


def _influences(layout: Layout, moving: Array, w: Array, full: Fit) -> Array:
    """(groups, size, terms) shift of each parameter where a friction term differs by its own size in one group of motions."""
    head = 10 * layout.n + 1
    out = []
    for j in range(layout.n):
        index = layout.index(j)
        k = len(index)
        felt = w[j] * full.covariance[:, index] @ moving[:, j, :k, head:k]  # (groups, size, friction terms)
        out.append(felt * full.theta[index[head:]])
    return np.concatenate(out, axis=2)


def _freedom(shares: Array) -> Array:
    """(size,) degrees of freedom of each parameter's spread: the groups that make up its variance, less one."""
    top = np.maximum(shares.max(axis=0), 1e-300)
    count = (shares / top).sum(axis=0) ** 2 / np.maximum(((shares / top) ** 2).sum(axis=0), 1.0)
    return np.asarray(np.maximum(np.where(shares.max(axis=0) > 0, count, len(shares)) - 1.0, 1.0))
