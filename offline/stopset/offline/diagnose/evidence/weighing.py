"""What a load weighs where the joints do not agree on it, and how sure that is.

Every joint weighs a load with its own drive.  Torque constants that are off joint by joint, or a description that puts a joint elsewhere, make
each of them find another mass.  A model of the empty arm shows none of that: it took every joint's torque as it is recorded for what the
links weigh.  So each joint may see the load's torque off by a share of its own: random effects with one deviation, of which
evidence says how likely each size is.  Joints that agree leave it next to none, and nothing is widened.  Where a load's torque is more of
what moves it than of what it weighs (an upright axis) no mass is told, but an inertia, and a share of that is as free as shares go.

Source: DerSimonian & Laird (1986), Meta-analysis in clinical trials.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.evidence.candidate import Candidate, Form
from stopset.offline.diagnose.evidence.forms import with_forms
from stopset.offline.diagnose.evidence.hypothesis import Hyper, Hypothesis
from stopset.offline.diagnose.evidence.uncertainty import deviations
from stopset.robot.rigid import regressors
from stopset.types import Array, Index


@dataclass(frozen=True, slots=True)
class Weighing:
    """A load's terms ``theta`` (k,), their ``deviation`` by symbol, and by which ``shares`` each joint that weighs it has it off, (share,
    standard deviation) by joint."""

    theta: Array
    deviation: Mapping[str, float]
    shares: Mapping[int, tuple[float, float]]

    def disagreeing(self) -> dict[int, float]:
        """The share of each joint that has the load heavier or lighter than the others, beyond its own error."""
        return {j: s for j, (s, std) in self.shares.items() if abs(s) > max(limit.SURE * std, limit.STANDS_OUT)}


def weighed(now: Hypothesis, hyper: Hyper, theta: Array, load: Candidate) -> Weighing:
    """``load``, one of the claims of ``now``, weighed by all joints, of which each may be off; ``hyper``, ``theta``: the fit of ``now``.

    How far they are off is not known well from a handful of joints: the answer is that of all sizes, each as likely as it is.  What they are
    off by on the average is counted once: as far as the drives' common scale may be off, or as their scatter leaves it, whichever is more.
    """
    weighing = _weighing(now, load, theta[_places(now, load.cols)])
    loose, mine = _loosened(now, load, theta, weighing)
    at = _places(loose, mine.cols)
    fits = []
    for size in limit.FORMS:
        h, p = loose.refit(replace(hyper, forms=(*hyper.forms, size, limit.FORMS[-1])))
        fits.append((loose.evidence(h), size, h, p.theta))
    most = max(evidence for evidence, *_ in fits)
    odds = [float(np.exp((evidence - most) / 2)) for evidence, *_ in fits]
    values, variances = [], []
    for _, size, h, x in fits:
        std = deviations(loose, h, x, [mine])[0]
        own = np.array([std[t.symbol] for t in load.effect.terms])
        twice = min(now.engine.source.gain_std, size / np.sqrt(max(1, weighing.sum()))) * x[at]
        values.append(x[at])
        variances.append(np.maximum(own**2 - twice**2, twice**2))
    weight, value = np.array(odds) / sum(odds), np.array(values)
    mean = weight @ value
    spread = np.sqrt(weight @ (np.array(variances) + (value - mean) ** 2))
    deviation = {t.symbol: float(x) for t, x in zip(load.effect.terms, spread, strict=True)}
    _, _, h, best = max(fits, key=lambda fit: fit[0])
    return Weighing(mean, deviation, _shares(loose, h, best))


@dataclass(frozen=True, slots=True)
class Misfit:
    """What a load's torque may be off by, with the load itself and all else that is claimed: its direction, a drive's scale, what it rubs."""

    loose: Hypothesis
    hyper: Hyper

    @staticmethod
    def of(now: Hypothesis, hyper: Hyper, theta: Array) -> Misfit | None:
        """That of the load among the effects of ``now``; ``hyper``, ``theta``: its fit.  None where there is none, or no model."""
        load = next((c for c in now.active if c.effect.carried), None)
        if load is None or not now.engine.modelled:
            return None
        loose = with_forms(now, [load], theta)
        return Misfit(loose, loose.fit(hyper)[0])

    def leaves(self, now: Hypothesis, hyper: Hyper, c: Candidate) -> tuple[float, float]:
        """Evidence for another claim of ``now``, twice the log Bayes factor: with the load taken to be told exactly, and beside all this."""
        return says(now, hyper, c), says(self.loose, self.hyper, c)


def says(now: Hypothesis, hyper: Hyper, c: Candidate) -> float:
    """Twice the log Bayes factor of one of the effects of ``now``, each side at its own noise."""
    base = now.without(c.key)
    return now.evidence(hyper) - base.evidence(base.fit(hyper)[0])


def joint_shares(now: Hypothesis, hyper: Hyper, theta: Array, c: Candidate) -> tuple[float, dict[int, float]]:
    """Evidence, twice the log Bayes factor, that joints have an arm's law off by shares of their own as wide as any that is asked; and these."""
    loose = with_forms(now, [c], theta, whole=True)
    h, p = loose.refit(replace(hyper, forms=(*hyper.forms, limit.FORMS[-1])))
    cols = loose.forms[-1].cols
    shares = {joint_of(loose, int(k)): float(p.theta[i]) for k, i in zip(cols, _places(loose, cols), strict=True)}
    return loose.evidence(h) - now.evidence(hyper), shares


def _places(now: Hypothesis, columns: Index) -> list[int]:
    """Where ``columns`` stand among the coefficients of a fit."""
    place = {column: k for k, column in enumerate(now.nuisance.tolist())}
    return [place[k] for k in columns.tolist()]


def _weighing(now: Hypothesis, load: Candidate, value: Array) -> NDArray[np.bool_]:
    """(n,) the joints where more of a load's torque is what it weighs than what moves it; ``value`` (k,): its terms."""
    engine = now.engine
    q = np.ascontiguousarray(engine.data.q)
    at_rest = np.zeros_like(q)
    weight = regressors(engine.source.robot.chain, q, at_rest, at_rest)[:, :, -10:] @ value
    out = np.zeros(engine.data.n, bool)
    for j, (moving, _) in engine.columns(load.effect, load.joints, load.shapes).items():
        rows = engine.rows[j]
        heavy = rows.plain(weight[:, j])
        out[j] = float(np.sum(heavy**2)) > float(np.sum((rows.plain(moving @ value) - heavy) ** 2))
    return out


def _loosened(now: Hypothesis, load: Candidate, theta: Array, weighing: NDArray[np.bool_]) -> tuple[Hypothesis, Candidate]:
    """``now`` with a share for each joint, as two forms: of the joints that are ``weighing`` the load, and of the others; and the load in it.

    Its own numbers are as free as they are allowed to be: were they held to their prior, shares of all joints alike would say them instead.
    """
    loose = with_forms(now, [load], theta, whole=True)
    cols = loose.forms[-1].cols
    of_weighing = weighing[[joint_of(loose, int(k)) for k in cols]]
    both = (Form(load.key, cols[of_weighing]), Form(load.key, cols[~of_weighing]))
    mine = next(c for c in loose.active if c.key == load.key)
    free = replace(mine, sd=mine.sd * max(limit.SIZES))
    return replace(loose, forms=(*loose.forms[:-1], *both)).instead(free), free


def joint_of(now: Hypothesis, column: int) -> int:
    """The joint in whose rows alone a column stands."""
    return next(j for j, gram in enumerate(now.engine.grams) if column in gram.index)


def _shares(loose: Hypothesis, h: Hyper, theta: Array) -> dict[int, tuple[float, float]]:
    """By joint, by what share it has the load off that it weighs, and its standard deviation."""
    view, cols = loose.view(), loose.forms[-2].cols
    A = view.total(h)[0][1:, 1:] + np.diag(view.precision(h))
    scale = 1.0 / np.sqrt(np.maximum(np.diag(A), 1e-30))
    inverse = np.linalg.pinv(A * np.outer(scale, scale), rcond=1e-12, hermitian=True) * np.outer(scale, scale)
    return {
        joint_of(loose, int(k)): (float(theta[i]), float(np.sqrt(max(inverse[i, i], 0.0))))
        for k, i in zip(cols, _places(loose, cols), strict=True)
    }
