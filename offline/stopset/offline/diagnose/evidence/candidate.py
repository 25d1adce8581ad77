"""A candidate: an effect at its joints with fixed shapes, and how it stands against the model without it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from stopset.effects import Effect
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.evidence.evidence import gain, gains
from stopset.types import Array, Index

EffectKey = tuple[str, tuple[int, ...]]  # effect and joints
HELD = 1e12  # prior precision of a term held at zero


def has_room(effect: Effect) -> bool:
    """Whether a law's prior may be wider or smaller as a whole: it has many terms, or levers that carry a small part of a weight or all of it."""
    return len(effect.terms) >= limit.MANY or effect.moment_arms


@dataclass(frozen=True, slots=True)
class Candidate:
    """An effect at its joints with fixed shapes; ``cols``: its global columns; ``sd``: prior deviation of each term."""

    effect: Effect
    joints: tuple[int, ...]
    shapes: Mapping[str, float]
    cols: Index
    sd: Array
    charge: float = 0.0  # evidence to pay for having searched many shapes

    @property
    def key(self) -> EffectKey:
        return (self.effect.name, self.joints)

    @property
    def given(self) -> float | None:
        """The coefficient where it is not free: a record is shifted as a whole or not at all."""
        return self.shapes.get("d0") if self.effect.enters == "input_delay" else None

    @property
    def roomy(self) -> bool:
        """`has_room` of its law."""
        return has_room(self.effect)

    @property
    def price(self) -> float:
        """Evidence that finely sought shapes cost: a lag, with its prior at this value, and a gear's stiffness and damping."""
        if self.given is not None:
            return (self.given / float(self.sd[0])) ** 2 + limit.LAG_PRICE
        return limit.SWING_PRICE if self.effect.role == "swing" else 0.0


@dataclass(frozen=True, slots=True)
class Form:
    """What a claimed law leaves where its form is not quite true; ``cols``: global columns, each the law's torque times one
    function of what it looks at."""

    of: EffectKey
    cols: Index


@dataclass(frozen=True, slots=True)
class Scored:
    """A candidate against the current model: ``score`` twice the log Bayes factor; ``theta``, ``cov`` of its terms."""

    candidate: Candidate
    score: float
    theta: Array
    cov: Array

    @property
    def admissible(self) -> bool:
        """Every term within its range, `SURE` standard deviations allowed beyond it."""
        beyond = limit.SURE * np.sqrt(np.maximum(np.diag(self.cov), 0.0))
        return all(t.lo - b <= v <= t.hi + b for t, v, b in zip(self.candidate.effect.terms, self.theta, beyond, strict=True))


@dataclass(frozen=True, slots=True)
class Alike:
    """Candidates with as many free terms each, judged at once: ``which`` (m,) they are; their columns, prior deviations and ranges (m, k)."""

    which: list[int]
    cols: Index
    sd: Array
    lo: Array
    hi: Array
    price: Array

    @staticmethod
    def of(candidates: Sequence[Candidate], which: Sequence[int]) -> tuple[list[Alike], list[int]]:
        """Those ``which`` are alike in that, and the others: given ones, and roomy ones."""
        own = [k for k in which if candidates[k].given is not None or candidates[k].roomy]
        groups: dict[int, list[int]] = {}
        for k in sorted(set(which) - set(own)):
            groups.setdefault(len(candidates[k].effect.terms), []).append(k)

        def group(which: list[int]) -> Alike:
            of = [candidates[k] for k in which]
            ends = np.array([[(t.lo, t.hi) for t in c.effect.terms] for c in of], dtype=float)
            cols, sd = np.array([c.cols for c in of]), np.array([c.sd for c in of])
            return Alike(which, cols, sd, ends[..., 0], ends[..., 1], np.array([c.price for c in of]))

        return [group(x) for x in groups.values()], own

    def gains(self, S: Array, s: Array) -> tuple[Array, Array, Array]:
        """`gain_within` of all: ``S`` (m, k, k), ``s`` (m, k)."""
        precision = 1.0 / self.sd**2
        value, theta, cov = gains(S, s, precision)
        beyond = ~((self.lo <= theta) & (theta <= self.hi)) & (self.lo <= 0.0) & (self.hi >= 0.0)
        if theta.shape[1] > 1 and (again := beyond.any(axis=1) & ~beyond.all(axis=1)).any():
            value[again], theta[again], cov[again] = gains(S[again], s[again], np.where(beyond, HELD, precision)[again])
        return value - self.price, theta, cov


def gain_within(S: Array, s: Array, c: Candidate) -> tuple[float, Array, Array]:
    """`gain`; of several terms those that come out beyond their range are held at zero, where that lies in it."""
    terms = c.effect.terms
    if c.given is not None:
        value = float(2 * c.given * s[0] - c.given**2 * S[0, 0] - c.price)
        return value, np.array([c.given]), np.zeros((1, 1))
    if c.roomy:
        precision = 1.0 / (np.array(limit.SIZES)[:, None] * c.sd) ** 2
        m, k = precision.shape
        values, thetas, covs = gains(np.broadcast_to(S, (m, k, k)), np.broadcast_to(s, (m, k)), precision)
        best = int(np.argmax(values))
        value, theta, cov = float(values[best]) - 2 * float(np.log(len(limit.SIZES))), thetas[best], covs[best]
    else:
        value, theta, cov = gain(S, s, 1.0 / c.sd**2)
    beyond = np.array([not t.lo <= v <= t.hi and t.lo <= 0.0 <= t.hi for t, v in zip(terms, theta, strict=True)])
    if len(terms) == 1 or not beyond.any() or beyond.all():
        return value - c.price, theta, cov
    value, theta, cov = gain(S, s, np.where(beyond, HELD, 1.0 / c.sd**2))
    return value - c.price, theta, cov
