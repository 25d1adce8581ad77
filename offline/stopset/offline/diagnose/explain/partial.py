"""What a claimed effect explains, point by point: the residual against the effect's own column, without and with it.

The plain residual is distorted, because friction and masses, fitted again, absorb part of what is missing.  The partial
residual is not: what the whole model leaves, plus the effect's own torque.  Against its column it lies about a line whose
slope is the parameter; with the effect taken off, about zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stopset.offline.diagnose.columns.laws import columns
from stopset.offline.diagnose.evidence.candidate import Candidate
from stopset.offline.diagnose.evidence.hypothesis import Hyper, Hypothesis
from stopset.types import Array

POINTS = 800  # drawn per effect


@dataclass(frozen=True, slots=True)
class Partial:
    """Points of one claim at ``joint``: ``x`` its column (its torque [N m], where it has several), ``without``, ``left`` [N m].

    ``slope``: the line through ``without``; ``axis``: what ``x`` is.
    """

    joint: str
    axis: str
    x: Array
    without: Array
    left: Array
    slope: float


def partial(now: Hypothesis, hyper: Hyper, theta: Array, candidate: Candidate, joint: int) -> Partial | None:
    """Points of the claimed ``candidate`` at ``joint``; ``theta``: coefficients of ``now``, the claim among them."""
    engine = now.engine
    shapes = candidate.shapes if candidate.given is None else {}  # a shifted record holds noise: drawn is the law's first order
    made = columns(engine.source, candidate.effect, candidate.joints, shapes)
    rows = engine.rows[joint]
    if joint not in made or not len(rows.take):
        return None
    gram = now.view().engine.grams[joint]
    full = np.concatenate([[1.0], -theta])
    k = len(rows.take)
    left = rows.whiten.coloured(gram.residual(full[gram.index], hyper.sigma[joint], hyper.kappa[joint])[:k])
    where = {column: at for at, column in enumerate(now.nuisance.tolist())}
    value = theta[[where[c] for c in candidate.cols.tolist()]]
    phi = rows.plain(made[joint][0])
    torque = phi @ value
    single = len(value) == 1
    thin = np.unique(np.linspace(0, k - 1, POINTS).astype(int))
    return Partial(
        engine.data.joints[joint],
        candidate.effect.look_at if single else f"torque of {candidate.effect.name} [N m]",
        (phi[:, 0] if single else torque)[thin], (left + torque)[thin], left[thin], float(value[0]) if single else 1.0,
    )  # fmt: skip
