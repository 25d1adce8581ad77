"""How sure the parameters of the claims are: shapes and all else estimated together, errors of a trial not taken as independent.

The evidence takes rows as independent once the sensors' noise and each trial's friction scales are off.  What a law leaves over
is not: it is alike within a motion.  So the scores of whole trials (of some seconds, where trials are few) are added up before
they are squared, and a standard deviation is the larger one of the two.  A shape (a Stribeck speed, a stiffness) stands in the
fit with the derivative of the law's torque by it.

Source: Liang & Zeger (1986), Longitudinal data analysis using generalized linear models; Cameron, Gelbach & Miller (2008), Bootstrap-based
improvements for inference with clustered errors: the quantile of few parts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import stdtrit

from stopset.offline.campaign.hold_out import BLOCK
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.evidence.candidate import Candidate
from stopset.offline.diagnose.evidence.engine import Engine
from stopset.offline.diagnose.evidence.hypothesis import Hyper, Hypothesis
from stopset.offline.diagnose.rows.prepare import Prepared
from stopset.types import Array, Index

TWO_SIDES = 1.96  # standard deviations to either side of a 95 % interval
STEP = 0.01  # relative step of a shape's numerical derivative
BY_ROWS = "by its rows"  # of a lag, beside its symbol: its error by its own rows alone, without what stamps mean


def deviations(now: Hypothesis, hyper: Hyper, theta: Array, claims: Sequence[Candidate]) -> list[dict[str, float]]:
    """Standard deviation of every term and shape of ``claims``, of a lag `BY_ROWS` too; ``theta``: coefficients of ``now``, claims included.

    Of a load against a description alone it is that of all scales of the description's errors, each as likely as it is, none below the
    description's own: a fit that leaves little tells that its links agree with each other, not with the truth.
    """
    out = fitted_deviations(now, hyper, theta, claims, 1.0)
    carried = [k for k, c in enumerate(claims) if c.effect.carried]
    if now.engine.modelled or not carried:
        return out
    place = {column: k for k, column in enumerate(now.nuisance.tolist())}
    scales = [replace(hyper, scale=s) for s in now.engine.scales if s >= 1.0]
    evidence = np.array([now.evidence(h) for h in scales])
    odds = np.exp((evidence - evidence.max()) / 2)
    variance = [dict.fromkeys(out[k], 0.0) for k in carried]
    for h, share in zip(scales, odds / odds.sum(), strict=True):
        if share < limit.EDGE:
            continue
        x = now.view().project(h)[0].theta
        for k, d, total in zip(carried, fitted_deviations(now, h, x, [claims[k] for k in carried], 1.0), variance, strict=True):
            for t, at in zip(claims[k].effect.terms, (place[c] for c in claims[k].cols.tolist()), strict=True):
                total[t.symbol] += share * (d[t.symbol] ** 2 + float(x[at] - theta[at]) ** 2)
    for k, total in zip(carried, variance, strict=True):
        out[k] = {symbol: float(np.sqrt(v)) for symbol, v in total.items()}
    return out


def fitted_deviations(
    now: Hypothesis, hyper: Hyper, theta: Array, claims: Sequence[Candidate], described: float = 0.0
) -> list[dict[str, float]]:
    """`deviations` at one scale of the description's errors; ``described``: how far its masses may all be off alike, of their tolerance.

    Whether there is a load is decided by what the fit itself says: the arm is heavier at its flange than described, or all of it is.
    """
    engine, view = now.engine, now.view()
    place = {column: k for k, column in enumerate(now.nuisance.tolist())}
    grams, precision, shapes = list(view.engine.grams), [view.precision(hyper)], []
    size = view.engine.size
    for number, c in enumerate(claims):
        value = theta[[place[k] for k in c.cols.tolist()]]
        varied = [(s.symbol, s.hi - s.lo) for s in (c.effect.shapes if c.given is None else c.effect.terms)]
        for symbol, span in varied:
            parts = _slope(engine, c, symbol, value)
            if parts:
                for j, w in parts.items():
                    grams[j] = grams[j].bordered(w[:, None], np.array([size]))
                shapes.append((number, symbol, size - 1))
                precision.append(np.array([4.0 / span**2]))
                size += 1
    wide = replace(view, engine=replace(view.engine, grams=grams, size=size))
    full = np.concatenate([theta, np.zeros(size - view.engine.size)])
    P = np.concatenate(precision)
    A = wide.total(hyper)[0][1:, 1:] + np.diag(P)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(A), 1e-30))  # a column that these motions leave empty tells nothing
    inverse = np.linalg.pinv(A * np.outer(scale, scale), rcond=1e-12, hermitian=True) * np.outer(scale, scale)
    S = _scores(engine, wide, hyper, full)
    free = max(1, len(S) - 1)
    # of a short recording's few parts a scatter is hardly known
    student = stdtrit(free, 0.975) / TWO_SIDES if _is_one_part(engine.data) else 1.0
    clustered = inverse @ (S.T @ S * student**2 * len(S) / free + np.diag(P)) @ inverse
    sd = np.sqrt(np.maximum(np.diag(inverse), np.diag(clustered)))
    out = [{t.symbol: float(sd[place[k]]) for t, k in zip(c.effect.terms, c.cols.tolist(), strict=True)} for c in claims]
    for number, symbol, at in shapes:
        out[number][symbol] = float(sd[at])
    for c, deviation in zip(claims, out, strict=True):
        if c.effect.carried:
            # a load is known no better than the torque it is weighed with: where that is too large, it is, too. What a fit says of all
            # drives' scale is as true as the description's masses, which err together, so it tells no more than a data sheet does
            off = engine.source.gain_std if engine.modelled else limit.DRIVES
            # nor than the description's masses, which may all be off alike: links whose errors are independent of each other deny that
            links = [place[k] for k in engine.cad.tolist()]
            tolerance = 0.0 if engine.modelled else described * engine.mass_tolerance
            alike = tolerance * inverse[:, links] @ (P[links] * engine.robot.pi.ravel())
            for t, k in zip(c.effect.terms, c.cols.tolist(), strict=True):
                a = np.zeros(len(full))
                a[place[k]] = 1.0
                a[place[engine.drives]] = 0.0 if engine.modelled else -theta[place[k]]
                own = float(np.sqrt(max(a @ inverse @ a, a @ clustered @ a)))
                deviation[t.symbol] = float(np.linalg.norm([own, off * theta[place[k]], np.sum(a * alike)]))
        if c.effect.enters == "input_delay":
            # a lag is known no better than what its stamps mean, and what was taken out of it before
            symbol = c.effect.terms[0].symbol
            stamped = [place[int(k)] for k in engine.stamps]
            deviation[BY_ROWS] = deviation[symbol]
            by_stamps = _lag_deviation(now, deviation[symbol], theta[stamped], sd[stamped])
            deviation[symbol] = float(np.hypot(by_stamps, engine.lag_std))
    return out


def _lag_deviation(now: Hypothesis, own: float, late: Array, std: Array) -> float:
    """[s] error of a joint's lag whose fit has the error ``own``; ``late, std`` (n,): how late each joint's stamps are, by the fit.

    One logger reads all joints at once, so what a stamp means is the same at all: those that have no lag of their own tell it.  By what they
    are late, and by the error of that, the lag may be off; where they say nothing, by what is believed beforehand.
    """
    engine = now.engine
    believed = engine.prior_sd[engine.stamps]
    most = float(np.hypot(own, np.median(believed)))
    weight = np.maximum(1.0 / std**2 - 1.0 / believed**2, 0.0)  # what the rows say, beyond what was believed
    weight[[c.joints[0] for c in now.active if c.effect.enters == "input_delay"]] = 0.0
    if not (weight > 0).any():
        return most
    said = late / np.where(weight > 0, std**2 * weight, 1.0)
    mean = float(weight @ said) / float(weight.sum())
    scatter = float(weight @ (said - mean) ** 2) / max(int((weight > 0).sum()) - 1, 1)
    # what all are late by is no error that a square root makes small: where the lag counts, it must be one beyond that
    return min(most, float(np.hypot(own, np.sqrt(max(scatter, 1.0) / weight.sum()))) + abs(mean) / limit.SURE)


def drives_scale(now: Hypothesis, theta: Array) -> float:
    """Recorded over true torque of all drives, by a fit; ``theta``: coefficients of ``now``.

    1 where a model says it already (a load's columns hold it then): what such a fit finds besides is no matter of the drives.
    """
    if now.engine.modelled:
        return 1.0
    return 1.0 + float(theta[now.nuisance.tolist().index(now.engine.drives)])


def _slope(engine: Engine, c: Candidate, symbol: str, value: Array) -> dict[int, Array]:
    """Whitened derivative (K,) by joint of a claim's torque by one of its shapes; empty where it has no such shape."""
    if c.given is not None:  # the law's first order: a slope of the record would hold its noise
        made = engine.make(c.effect, c.joints, {})
        return {} if made is None else {j: w[:, 0] for j, w in made[1].items()}
    if symbol not in c.shapes:
        return {}
    x = c.shapes[symbol]
    up, down = (engine.make(c.effect, c.joints, {**c.shapes, symbol: x * (1 + k * STEP)}) for k in (1, -1))
    if up is None or down is None or x == 0:
        return {}
    return {j: (up[1][j] - down[1][j]) @ value / (2 * STEP * x) for j in up[1]}


def _is_one_part(d: Prepared) -> bool:
    """Whether all that was recorded is one motion, too short for two of its parts."""
    return len(d.trials) == 1 and float(np.ptp(d.t)) < limit.PART


def _scores(engine: Engine, wide: Hypothesis, hyper: Hyper, theta: Array) -> Array:
    """(clusters, columns) derivative of the log likelihood by the coefficients, summed over what may err alike."""
    d, few = engine.data, len(engine.data.trials) < limit.FEW_TRIALS
    parts = (d.t / limit.PART).astype(np.intp) if few else np.zeros(len(d.t), np.intp)
    if _is_one_part(d):
        parts = (d.t / BLOCK).astype(np.intp)  # the scores of a single part add up to nothing, whatever it leaves
    _, cluster = np.unique(np.stack([d.trial, parts]), axis=1, return_inverse=True)
    count = int(cluster.max()) + 1
    poses = max(r.still for r in engine.rows)
    out = np.zeros((count + poses, wide.engine.size - 1))
    v = np.concatenate([[1.0], -theta])
    for gram, rows, sigma, kappa in zip(wide.engine.grams, engine.rows, hyper.sigma, hyper.kappa, strict=True):
        r = gram.residual(v[gram.index], sigma, kappa) / kappa
        of: Index = np.concatenate([cluster[rows.take], count + np.arange(rows.still)]).astype(np.intp)
        first = np.flatnonzero(np.diff(of, prepend=-1))
        mine = gram.index > 0
        out[np.ix_(of[first], gram.index[mine] - 1)] += np.add.reduceat(gram.X[:, mine] * r[:, None], first, axis=0)
    return out
