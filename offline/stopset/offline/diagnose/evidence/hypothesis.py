"""A hypothesis: the base model, the effects assumed beside it and what their forms may leave, and its fit by evidence.

It never changes; assuming one effect more or less makes another one over the same columns (`Engine`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.evidence.candidate import Candidate, Form
from stopset.offline.diagnose.evidence.engine import Engine
from stopset.offline.diagnose.evidence.evidence import Projection, project
from stopset.types import Array, Index, Mask

ROUNDS = 3  # of choosing one hyperparameter after another: they settle in two
GIVEN = 1e-7  # prior deviation of a coefficient that is given


@dataclass(frozen=True, slots=True)
class Hyper:
    """What evidence chooses: friction scale ``sigma`` and noise variance ``kappa`` per joint; ``scale``, ``rotor``: how far the
    description's links and the data sheet's inertias are off, in units of their tolerance; ``forms``: relative deviation of each
    claimed law from its true form."""

    sigma: tuple[float, ...]
    kappa: tuple[float, ...]
    scale: float
    rotor: float = 1.0
    forms: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """The base model of ``engine`` with the effects ``active`` and their ``forms``; ``held``: base columns held at zero."""

    engine: Engine
    active: tuple[Candidate, ...] = ()
    held: tuple[int, ...] = ()
    forms: tuple[Form, ...] = ()
    _view: list[Hypothesis] = field(default_factory=list, init=False, compare=False, repr=False)
    _sums: dict[tuple[tuple[float, ...], ...], tuple[Array, float]] = field(
        default_factory=dict, init=False, compare=False, repr=False
    )

    # -- others beside it -------------------------------------------------------------------------------------------

    def plus(self, candidate: Candidate) -> Hypothesis:
        """The same with one effect more."""
        return replace(self, active=(*self.active, candidate))

    def without(self, key: tuple[str, tuple[int, ...]]) -> Hypothesis:
        """The same without the effect of that `Candidate.key`."""
        return replace(self, active=tuple(c for c in self.active if c.key != key))

    def instead(self, candidate: Candidate, key: tuple[str, tuple[int, ...]] | None = None) -> Hypothesis:
        """The same with ``candidate`` in the place of the effect of that ``key`` (its own, unless given)."""
        return replace(self, active=tuple(candidate if c.key == (key or candidate.key) else c for c in self.active))

    # -- its prior --------------------------------------------------------------------------------------------------

    @property
    def nuisance(self) -> Index:
        """Global columns of the base model, of what was added, and of forms."""
        base = np.arange(1, len(self.engine.prior_sd))
        return np.concatenate([base, *(c.cols for c in self.active), *(f.cols for f in self.forms)]).astype(np.intp)

    def precision(self, h: Hyper) -> Array:
        """Prior precision of `nuisance`; ``h`` says how well description, data sheet and forms hold.

        A delay that was added is `given`, and says all about its joint's stamps.
        """
        sd = self.engine.prior_sd.copy()
        sd[self.engine.cad] *= h.scale
        sd[self.engine.rotors] *= h.rotor
        late = [self.engine.stamps[c.joints[0]] for c in self.active if c.effect.enters == "input_delay"]
        sd[[*self.held, *late]] = 1e-6
        added = [c.sd if c.given is None else np.array([GIVEN]) for c in self.active]
        forms = [np.full(len(f.cols), s) for f, s in zip(self.forms, h.forms, strict=True)]
        return 1.0 / np.concatenate([sd[1:], *added, *forms]) ** 2

    @property
    def mean(self) -> Array:
        """Prior mean of `nuisance`: zero but for what is `given`."""
        out = np.zeros(len(self.nuisance))
        at = len(self.engine.prior_sd) - 1
        for c in self.active:
            out[at : at + len(c.cols)] = c.given or 0.0
            at += len(c.cols)
        return out

    # -- its fit ----------------------------------------------------------------------------------------------------

    def refit(self, h: Hyper) -> tuple[Hyper, Projection]:
        """Coefficients and noise variances where all else that evidence chooses is given."""
        view = self.view()
        p = view.project(h)[0]
        h = replace(h, kappa=tuple(view.kappa(j, p.theta, s) for j, s in enumerate(h.sigma)))
        return h, view.project(h)[0]

    def fit(self, start: Hyper | None = None) -> tuple[Hyper, Projection]:
        """Hyperparameters by evidence, and coefficients."""
        engine, view = self.engine, self.view()
        n = engine.data.n
        h = start or Hyper((limit.USUAL_SCATTER,) * n, (1.0,) * n, min(1.0, engine.scales[-1]))
        h = replace(h, forms=(*h.forms, *(limit.FORMS[0],) * len(self.forms))[: len(self.forms)])
        for _ in range(ROUNDS):
            before = h
            for j in range(n):
                if (
                    len(view.engine.grams[j].starts) >= limit.SCATTERED
                ):  # of fewer trials no scatter is known: it stays at the usual one
                    h = view._best(h, [replace(h, sigma=_put(h.sigma, j, s)) for s in limit.SCATTERS])
            h = view._best(h, [replace(h, scale=s) for s in engine.scales])
            h = view._best(h, [replace(h, rotor=s) for s in engine.rotor_scales])
            for k in range(len(self.forms)):
                h = view._best(h, [replace(h, forms=_put(h.forms, k, s)) for s in limit.FORMS])
            h, p = view.refit(h)
            if h == before:
                break
        return h, p

    def evidence(self, h: Hyper) -> float:
        """Twice the log evidence at ``h``, comparable between hypotheses about the same data."""
        view = self.view()
        p, logdet = view.project(h)
        spread = sum(r.size * float(np.log(k)) for r, k in zip(self.engine.rows, h.kappa, strict=True))
        return view.criterion(p, h, logdet) - spread

    def excesses(self, theta: Array, h: Hyper) -> tuple[float, ...]:
        """Residual variance over the sensors' noise of each joint; ``theta``: coefficients of `nuisance`."""
        view = self.view()
        return tuple(view.excess(j, theta, h.sigma[j], h.kappa[j]) for j in range(self.engine.data.n))

    def descriptions(self, h: Hyper) -> list[Hyper]:
        """``h`` with the description or the data sheet holding better or worse, or a claim's form truer."""
        links = [replace(h, scale=s) for s in self.engine.scales if s != h.scale]
        rotors = [replace(h, rotor=s) for s in self.engine.rotor_scales if s != h.rotor]
        truer = [replace(h, forms=_put(h.forms, k, s)) for k, x in enumerate(h.forms) for s in limit.FORMS if s < x]
        return links + rotors + truer

    # -- its linear algebra -----------------------------------------------------------------------------------------

    def view(self) -> Hypothesis:
        """The same over an engine with no other columns than its own: small and quick to refit."""
        if not self._view:
            engine = self.engine
            wanted = np.concatenate([[0], self.nuisance])
            number = np.full(engine.size, -1)
            number[wanted] = np.arange(len(wanted))
            grams = []
            for gram in engine.grams:
                small = gram.keep(np.flatnonzero(number[gram.index] >= 0))
                small.index, small.of_a_view = number[small.index], True
                grams.append(small)
            own = replace(engine, grams=grams, size=len(wanted))
            active = tuple(replace(c, cols=number[c.cols]) for c in self.active)
            forms = tuple(replace(f, cols=number[f.cols]) for f in self.forms)
            self._view.append(Hypothesis(own, active, self.held, forms))
        return self._view[0]

    def total(self, hyper: Hyper, folds: Mask | None = None) -> tuple[Array, float]:
        """(C, C) Gram of all joints and the friction scales' log determinant."""
        G, logdet = np.zeros((self.engine.size, self.engine.size)), 0.0
        for gram, s, k in zip(self.engine.grams, hyper.sigma, hyper.kappa, strict=True):
            if gram.of_a_view and folds is None:
                whole, ld = gram.among_all(s, k)
                G[: len(whole), : len(whole)] += whole
            else:
                part, ld = gram.at(s, k, folds)
                G[gram.index[:, None], gram.index] += part
            logdet += ld
        return G, logdet

    def criterion(self, p: Projection, h: Hyper, logdet: float) -> float:
        """Twice the log evidence without candidate, up to a constant of the data."""
        precision = self.precision(h)
        price = sum(c.price for c in self.active)
        return -(p.rss + p.logdet - float(np.log(precision[precision > 0]).sum()) + logdet + price)

    def project(self, h: Hyper) -> tuple[Projection, float]:
        """The coefficients, and the friction scales' log determinant, of a `view`, whose columns stay as they are.

        The sums of the last scatter and noise are kept: how far description and forms may be off changes none of them.
        """
        key = (h.sigma, h.kappa)
        if (found := self._sums.get(key)) is None:
            found = self.total(h)
            self._sums.clear()
            self._sums[key] = found
        G, logdet = found
        return project(G, 0, self.nuisance, np.zeros(0, np.intp), self.precision(h), self.mean), logdet

    def kappa(self, joint: int, theta: Array, sigma: float) -> float:
        """Residual variance of a joint's rows over the sensors' own noise; 1 where nothing is missing."""
        return max(1.0, self.excess(joint, theta, sigma, 1.0))

    def excess(self, joint: int, theta: Array, sigma: float, kappa: float) -> float:
        """As `kappa`, not cut off at 1; ``theta``: coefficients of `nuisance`."""
        gram = self.engine.grams[joint]
        full = np.zeros(self.engine.size)
        full[0] = -1.0
        full[self.nuisance] = theta
        G, _ = gram.at(sigma, kappa)
        v = full[gram.index]
        return float(v @ G @ v * kappa) / max(1, self.engine.rows[joint].size)

    def _best(self, now: Hyper, choices: Sequence[Hyper]) -> Hyper:
        """The choice of highest evidence uphill from ``now``: it has a single top along the choices, which stand in order."""
        values: dict[int, float] = {}

        def value(k: int) -> float:
            if k not in values:
                p, logdet = self.project(choices[k])
                values[k] = self.criterion(p, choices[k], logdet)
            return values[k]

        at = choices.index(now) if now in choices else len(choices) // 2
        while better := [k for k in (at - 1, at + 1) if 0 <= k < len(choices) and value(k) > value(at)]:
            at = max(better, key=value)
        return choices[at]


def _put(values: tuple[float, ...], j: int, value: float) -> tuple[float, ...]:
    return (*values[:j], value, *values[j + 1 :])
