"""In which form a claimed lag of the torque is one: stamps that are apart, or a drive that follows its command as 1 / (T s + 1).

To first order both are the same law, and so are their torques as long as nothing happens within the lag.  What happens faster a drive's
lag makes smaller, its torque's noise, too: a record through it always leaves less.  So the noise that the lag takes off is counted
against it, as the noise that the rows were whitened by, but no more than they leave.  What is left beyond that may be of any frequency:
the lag is believed if all of it were as fast as noise, stamps are if none of it were.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stopset.effects import Effect, catalogue
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.evidence.candidate import Scored
from stopset.offline.diagnose.evidence.engine import Engine
from stopset.offline.diagnose.evidence.hypothesis import Hypothesis
from stopset.offline.diagnose.evidence.scores import score_new
from stopset.offline.diagnose.rows.noise import autocovariance
from stopset.offline.diagnose.search.settled import Settled, refitted
from stopset.offline.diagnose.search.wanted import asked
from stopset.offline.nominal.filters import first_order
from stopset.types import Array

FINEST = 0.01  # of the time constant
SETTLED = 20.0  # time constants until nothing is left of what a lag was fed with


@dataclass(frozen=True, slots=True)
class Form:
    """A lag in its form, and the names of the others that the rows do not tell from it."""

    settled: Settled
    alike: tuple[str, ...] = ()


def formed(now: Hypothesis, top: Settled, names: Sequence[str] | None) -> Form:
    """The claimed ``top`` beside ``now`` in the form that it has; of forms of ``names`` only, where some are asked for.

    Where rows do not tell, the plainer form stands, with the other one beside it.
    """
    c = top.candidate
    finer = [e for e in catalogue().values() if c.effect.name in e.refines and e.acting and asked(e, names)]
    if not finer or c.given is None or c.given >= 0.0:
        return Form(top)
    weighed = _Weighed.of(now, top, finer[0])
    T, plain = weighed.best(), weighed.scored(c.effect, c.given)
    found = None if T is None else score_new(now, finer[0], c.joints, {"d0": T}, top.hyper)
    if T is None or plain is None or found is None:
        return Form(top)
    other = refitted(now, replace(found, score=found.score - weighed.noise(T)), top.hyper)
    if names is not None and c.effect.name not in names:
        return Form(other)
    most, least = weighed.noise_of(other, T)
    gained = weighed.raw(T) - plain.score
    if gained - most > limit.THRESHOLD:
        return Form(other)
    return Form(top) if gained - least < -limit.THRESHOLD else Form(top, (finer[0].name,))


@dataclass(frozen=True, slots=True)
class _Weighed:
    """A drive's lag of any time constant in the place of the claimed lag ``top`` of a joint beside ``held``.

    ``whole``: variance that the torque's noise has in the whitened rows, summed; ``left``: and what they leave, the position's noise off.
    """

    held: Hypothesis  # with the joint's stamps held: they would take a share of a lag
    top: Settled
    effect: Effect
    joint: int
    whole: float
    left: float

    @staticmethod
    def of(now: Hypothesis, top: Settled, effect: Effect) -> _Weighed:
        (j,) = top.candidate.joints
        whole = _noise(now.engine, j, now.engine.data.kernel.h)
        return _Weighed(replace(now, held=(int(now.engine.stamps[j]),)), top, effect, j, whole, _left(now.engine, j, whole, top))

    def scored(self, effect: Effect, lag: float) -> Scored | None:
        """As lags are scored while they are searched."""
        return score_new(self.held, effect, (self.joint,), {"d0": lag}, self.top.hyper, quick=True)

    def raw(self, T: float) -> float:
        """Score of a time constant with the noise that it takes off the record."""
        term, found = self.effect.terms[0], self.scored(self.effect, T)
        return found.score if found is not None and term.lo <= T <= term.hi else -np.inf

    def through(self, T: float) -> float:
        """What of ``whole`` passes a lag."""
        kernel = self.held.engine.data.kernel
        return _noise(self.held.engine, self.joint, _smoothed(kernel.h, T / kernel.dt))

    def noise(self, T: float) -> float:
        """Score that a lag gains by the noise it takes off the record, which is no more than the rows leave."""
        share = 1.0 - self.through(T) / self.whole
        return share * max(min(self.left, self.whole), 0.0) / self.top.hyper.kappa[self.joint]

    def noise_of(self, other: Settled, T: float) -> tuple[float, float]:
        """The same at most and at least: as if all that the rows leave beside either form were as fast as noise, or the noise alone."""
        through, kappa = self.through(T), self.top.hyper.kappa[self.joint]
        left = _left(self.held.engine, self.joint, self.whole, other) * self.whole / through
        fast, share = max(min(self.left, left), 0.0), 1.0 - through / self.whole
        return share * fast * (1 + limit.NOISE_KNOWN) / kappa, share * min(fast, self.whole) * (1 - limit.NOISE_KNOWN) / kappa

    def best(self) -> float | None:
        """The time constant of most evidence near the claimed lag; None where the effect can have none such."""

        def value(T: float) -> float:
            raw = self.raw(T)
            return raw - self.noise(T) if np.isfinite(raw) else raw

        best, step = abs(self.top.candidate.given or 0.0), 0.3
        most = value(best)
        while step > FINEST:
            tried = {T: value(T) for T in (best * float(np.exp(side * step)) for side in (1.0, -1.0))}
            better = max(tried, key=lambda T: tried[T])
            if tried[better] > most:
                best, most = better, tried[better]
            else:
                step *= 0.5
        return best if np.isfinite(most) else None


def _left(engine: Engine, joint: int, whole: float, form: Settled) -> float:
    """Variance that a joint's whitened rows leave beside a form, summed, without the part of the position's noise."""
    rows = len(engine.rows[joint].take)
    return rows * form.now.excesses(form.fit.theta, form.hyper)[joint] - (rows - whole)


def _noise(engine: Engine, joint: int, h: Array) -> float:
    """Sum over a joint's whitened rows of the variance that the torque's noise leaves in them, smoothed by ``h``."""
    d, rows = engine.data, engine.rows[joint]
    per = [
        float(rows.whiten.power(autocovariance(replace(d.kernel, h=h), d.step, float(noise), 0.0))[k])
        for k, noise in enumerate(d.torque_noise[:, joint])
    ]
    return float(np.array(per)[rows.whiten.kind].sum())


def _smoothed(h: Array, time: float) -> Array:
    """What the kernel ``h`` and a lag of ``time`` [samples] weigh samples by."""
    fed = np.concatenate([[0.0], h, np.zeros(int(SETTLED * time) + 1)])
    return first_order(fed[:, None], time)[:, 0]
