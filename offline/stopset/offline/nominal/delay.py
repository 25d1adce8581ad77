"""How late the torque acts, or is stamped, against the motion: found before anything is fitted.

A delay ``d`` looks like ``d |du/dt|`` of torque error and, unknown, ends in friction and inertia.  The torque is kept at
several lags in the normal equations, so the error of the best model at each lag is known from the sums alone; its lowest
point is the delay.  A drive that holds its command over a sample acts half a sample late: that part is expected and
told apart.

How far a lag may be off is read from the whole course of that error, in units of what chance makes it rise by.  Its lowest point
alone says nothing: an arm that creeps has one too, wherever its noise happens to put it, and as no estimate leaves the search, they
scatter by no more than a part of it.

Source: Pawitan (2001), In All Likelihood, sec. 3.4 (profile likelihood and the interval it gives).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from stopset.offline.nominal.normal_equations import DELAYS, TOGETHER, NormalEquations
from stopset.offline.nominal.prior import Prior
from stopset.types import Array

LEAST_STD = 2e-4  # [s] no clock is known better
BLUNT = 0.005  # [s] joints with a larger standard error do not say where the middle is
CLOSE = 0.002  # [s] joints this near the middle, beside their errors, share the clock
OWN = 0.01  # [s] of one joint against the others: below, unmodelled friction looks alike
FEW = 3  # with fewer motions none can be left out
SIDES = 2.0  # standard errors to either side at which the ends of a lag's interval are looked for
SURE = 4.0  # standard errors from which on a lag is one, however blunt
FALLS = 0.8  # of its sum of squares at no lag: an error that has fallen so far at the end of the search, and falls still, is of a lag beyond
FINE = np.linspace(DELAYS[0], DELAYS[-1], 601)  # 0.1 ms


@dataclass(frozen=True, slots=True)
class Delay:
    """``joint`` (n,) [s] best lag of each joint and ``std`` (n,) its standard error (inf: undetermined);

    ``common`` [s]: the lag all joints share, from clocks rather than from a single drive, and its ``common_std``;
    ``hold`` [s]: the half sample expected of a held command; ``beyond`` [s]: the end of the search where the lag of all joints
    lies farther out, else 0.
    """

    joint: Array
    std: Array
    common: float
    common_std: float
    hold: float
    beyond: float = 0.0

    @property
    def sure(self) -> bool:
        """Whether all joints share a lag that is none of chance."""
        return abs(self.common) > SURE * self.common_std


def has_own_lag(delay: Delay, period: float) -> NDArray[np.bool_]:
    """(n,) which joints' torque is late or early on its own: a slow drive or a filter rather than two clocks; ``period`` [s]."""
    return np.array([_is_own(*x, delay, period) for x in zip(delay.joint.tolist(), delay.std.tolist(), strict=True)])


def _is_own(best: float, std: float, delay: Delay, period: float) -> bool:
    """Whether a lag of one joint is none of the clocks that all share."""
    least = max(OWN, 1.2 * period if np.isfinite(period) else 0.0)
    return bool(abs(best - delay.common) > max(least, SURE * float(np.hypot(std, delay.common_std))))


def lag_weights(d: float) -> Array:
    """(len(DELAYS),) weights that interpolate the torque at lag ``d``: cubic through the four nearest lags."""
    h = DELAYS[1] - DELAYS[0]
    k = int(np.clip(np.floor((d - DELAYS[0]) / h) - 1, 0, len(DELAYS) - 4))
    w = np.zeros(len(DELAYS))
    for a in range(4):
        others = [b for b in range(4) if b != a]
        w[k + a] = np.prod([(d - DELAYS[k + b]) / (DELAYS[k + a] - DELAYS[k + b]) for b in others])
    return w


def joint_reduced(G: Array, lags: Array) -> Array:
    """Normal matrix (.., c, c) with the lagged torques replaced by the one that ``lags`` (len(DELAYS),) weights, without reversals."""
    head = G.shape[-1] - len(lags) - 1
    T = np.zeros((G.shape[-1], head + 1))
    T[:head, :head] = np.eye(head)
    T[-len(lags) :, head] = lags
    return np.asarray(np.swapaxes(T, 0, 1) @ G @ T)


def _profile(G: Array, ridge: Array, mean: Array) -> Array:
    """(len(FINE),) sum of squared residuals of the best fit at each fine lag; ``ridge`` pulls to ``mean`` (head,)."""
    k = len(DELAYS)
    head = G.shape[0] - k
    T = np.eye(len(G))
    T[:head, head:] = -mean[:, None]  # what the prior leaves of the torque: a pull to zero would shift the lag
    G = T.T @ G @ T
    A = G[:head, :head] + ridge
    L = np.linalg.cholesky(A)
    W = np.linalg.solve(L, G[:head, head:])
    S = G[head:, head:] - W.T @ W  # residual products at the coarse lags
    weights = _fine_weights()
    return np.asarray(np.sum((weights @ S) * weights, axis=1))


@cache
def _fine_weights() -> Array:
    return np.array([lag_weights(float(d)) for d in FINE])


def _deviation(profile: Array, rows: float, left: Array) -> float:
    """[s] standard error of the lag where the error is lowest; inf where it rises too little for chance within the search.

    ``rows`` that the error is summed over; ``left``: the best lag without each motion.  By chance the error rises as that of the rows
    does, and no less than motions disagree about the lag; motions are few, so that they may agree by chance.
    """
    if not np.isfinite(left).all():
        return float("inf")
    k = int(np.clip(np.argmin(profile), 20, len(profile) - 21))
    bend = float(profile[k - 20] - 2 * profile[k] + profile[k + 20]) / (20 * (FINE[1] - FINE[0])) ** 2
    m, chance = len(left), float(profile.min()) / rows * TOGETHER
    if m >= FEW:
        chance = max(chance, 0.5 * bend * (m - 1) / m * float(np.sum((left - left.mean()) ** 2)))
    within = np.flatnonzero(profile - profile.min() < SIDES**2 * max(chance, 1e-300))
    if within[0] == 0 or within[-1] == len(FINE) - 1:
        return float("inf")
    best = _lowest(profile)
    return float(max(FINE[within[-1] + 1] - best, best - FINE[within[0] - 1])) / SIDES


def _lowest(profile: Array) -> float:
    """Vertex of the parabola through the lowest point; nan at the edge of the search."""
    k = int(np.argmin(profile))
    if k in (0, len(profile) - 1):
        return float("nan")
    a, b, c = profile[k - 1 : k + 2]
    bend = a - 2 * b + c
    return float(FINE[k] + (0.5 * (a - c) / bend if bend > 0 else 0.0) * (FINE[1] - FINE[0]))


def estimate_delay(data: NormalEquations, prior: Prior) -> Delay:
    """Best lag per joint with a standard error, and the one common to all.

    Joints that disagree with the rest do not pull the common lag.
    """
    n = data.layout.n
    hold = 0.5 * data.period if np.isfinite(data.period) else 0.0
    found = [_of_joint(data, prior, j) for j in range(n)]
    first = _delay(found, hold)
    for j in np.flatnonzero(has_own_lag(first, data.period)):
        best, std, end = _of_joint(data, prior, int(j), any_rotor=True)
        if np.isfinite(std) and not _is_own(best, std, first, data.period):
            found[j] = best, std, end
    return _delay(found, hold)


def _delay(found: Sequence[tuple[float, float, float]], hold: float) -> Delay:
    best, std, ends = (np.array(x) for x in zip(*found, strict=True))
    common, common_std = _common(best, std)
    return Delay(best, std, common, common_std, hold, 0.0 if np.isfinite(common_std) else _beyond(ends))


def _of_joint(data: NormalEquations, prior: Prior, j: int, *, any_rotor: bool = False) -> tuple[float, float, float]:
    """Best lag of a joint, its standard error, and the end of the search at which its error falls still, nan and inf where it tells none.

    ``any_rotor``: with a rotor that may be any.  A rotor unlike its data sheet's is a torque in step with the acceleration, ahead of what
    friction and gravity ask for, and looks like a lag of tens of milliseconds where it may not be what it is.
    """
    if data.rows_moving[:, j].sum() < 60:
        return float("nan"), float("inf"), 0.0
    n, G = data.layout.n, data.moving[:, j]
    total, groups = G.sum(axis=0), np.flatnonzero(data.rows_moving[:, j] > 0)
    ridge = _ridge(total, prior, data, j, any_rotor=any_rotor)
    mean = np.zeros(G.shape[-1] - len(DELAYS))
    mean[: 10 * n + 1] = prior.mean[data.layout.index(j)[: 10 * n + 1]]
    profile = _profile(total, ridge, mean)
    best, end = _lowest(profile), _end(profile)
    if not np.isfinite(best):
        return best, float("inf"), end
    several = groups if len(groups) >= FEW else groups[:0]
    left = np.array([_lowest(_profile(total - G[g], ridge, mean)) for g in several])
    return best, _deviation(profile, float(data.rows_moving[:, j].sum()), left), end


def _end(profile: Array) -> float:
    """The end [s] of the search towards which the error falls far, else 0."""
    k = int(np.argmin(profile))
    return float(FINE[k]) if k in (0, len(profile) - 1) and profile[k] < FALLS * profile[len(profile) // 2] else 0.0


def _beyond(ends: Array) -> float:
    """The end [s] that two joints or more agree on, or an arm's only one, and none gainsays."""
    found = ends[ends != 0.0]
    return float(found[0]) if len(found) >= min(2, len(ends)) and len(found) and (found == found[0]).all() else 0.0


def lag_in_words(lag: Delay) -> str:
    """`` ... the motion``: how late or early all joints' torque is."""
    if lag.beyond:
        return f"more than {abs(lag.beyond) * 1e3:.0f} ms {'behind' if lag.beyond < 0 else 'before'}"
    return moved_in_words(lag.common, lag.common_std)


def moved_in_words(value: float, std: float) -> str:
    """The same of torque whose stamps are moved by ``value`` [s], known to ``std`` [s]: below 0 it is late."""
    return f"{abs(value) * 1e3:.1f} +- {std * 1e3:.1f} ms {'behind' if value < 0 else 'before'}"


def own_clock(one: Delay, other: Delay, period: float) -> bool:
    """Whether the torque of some recordings lags the motion unlike that of others: stamps of two clocks; ``period`` [s]."""
    if one.beyond != other.beyond:
        return True
    std = float(np.hypot(one.common_std, other.common_std))
    least = max(OWN, 1.2 * period if np.isfinite(period) else 0.0)
    return bool(np.isfinite(std) and abs(one.common - other.common) > max(least, SURE * std))


def _common(best: Array, std: Array) -> tuple[float, float]:
    """The lag that most joints share: weighted mean of those near the median; a drive that is late alone stays out."""
    sound = np.isfinite(best) & np.isfinite(std)
    if not sound.any():
        return 0.0, float("inf")
    d, s = best[sound], np.maximum(std[sound], LEAST_STD)
    sharp = s <= max(BLUNT, 2 * float(s.min()))
    middle = float(np.median(d[sharp]))
    near = np.abs(d - middle) <= 3 * s + CLOSE
    if not near.any():  # two joints apart, and the median between them
        return middle, float("inf")
    w = near / s**2
    mean = float(w @ d / w.sum())
    chi2 = float(w @ (d - mean) ** 2) / max(int(near.sum()) - 1, 1)
    return mean, float(np.sqrt(max(chi2, 1.0) / w.sum()))


def _ridge(G: Array, prior: Prior, data: NormalEquations, joint: int, *, any_rotor: bool) -> Array:
    """Prior of this joint's columns, its rotor's among them but where that may be any, scaled by a rough noise level, plus a trace of itself
    for what has no prior."""
    index = data.layout.index(joint)
    head = G.shape[0] - len(DELAYS)
    n = data.layout.n
    rows = max(float(data.rows_moving[:, joint].sum()), 1.0)
    k = head + int(np.argmin(np.abs(DELAYS)))
    noise = (0.05**2) * G[k, k] / rows  # 5 % of the torque: the ridge only has to make the matrix regular
    out = np.diag(1e-9 * (np.diag(G)[:head] + 1e-9 * np.trace(G)))
    known = 10 * n if any_rotor else 10 * n + 1
    place = index[:known]
    out[:known, :known] += noise * prior.precision[np.ix_(place, place)]
    return out
