"""What the form of a claimed law leaves: its torque times a random function of what it depends on.

No law of a catalogue is quite that of the drive it is claimed of.  What it leaves is large where its torque is, so later claims
are asked against a hypothesis in which every earlier law may be off by a relative amount that differs with its own size, with
position, speed and load of its joint and from one part of the session to the next: a random effect with one variance per
claim, found by marginal likelihood (`Hyper.forms`).  A law that is true has next to none, and leaves room for small ones.

Source: Laird & Ware (1982), Random-effects models for longitudinal data.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.polynomial.legendre import legvander

from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.evidence.candidate import Candidate, Form
from stopset.offline.diagnose.evidence.engine import Engine
from stopset.offline.diagnose.evidence.hypothesis import Hypothesis
from stopset.types import Array, Index


def with_forms(
    now: Hypothesis, claims: Sequence[Candidate], theta: Array, *, varying: bool = False, whole: bool = False
) -> Hypothesis:
    """``now`` with the random effects of its ``claims``' forms; ``theta``: coefficients of `Hypothesis.nuisance`.

    ``varying``: of a law with a constant beside other terms, shares of what its torque varies by (`has_no_zero`); ``whole``: one share of
    all its torque for each joint, and no curves.
    """
    place = {column: k for k, column in enumerate(now.nuisance.tolist())}
    view = now.view()
    grams, size, forms = list(view.engine.grams), view.engine.size, list(view.forms)
    for c in claims:
        parts = form_columns(now.engine, c, theta[[place[k] for k in c.cols.tolist()]], varying=varying)
        parts = {i: w[:, :1] for i, w in parts.items()} if whole else parts
        count = sum(w.shape[1] for w in parts.values())
        at = size
        for i, w in parts.items():
            grams[i] = grams[i].bordered(w, np.arange(at, at + w.shape[1]))
            at += w.shape[1]
        forms.append(Form(c.key, np.arange(size, size + count)))
        size += count
    return replace(view, engine=replace(view.engine, grams=grams, size=size), forms=tuple(forms))


def has_no_zero(engine: Engine, c: Candidate) -> bool:
    """Whether a law has a constant beside other terms: where its torque is zero is as free then as where its joint's position is.

    Of a spring that is recorded far from its rest, over a small part of its range, next to all is constant: a few percent of that make
    a straight line of any curve.
    """
    return any(
        moving.shape[1] > 1 and bool(np.any(np.ptp(moving, axis=0) == 0.0))
        for moving, _ in engine.columns(c.effect, c.joints, c.shapes).values()
    )


def form_columns(engine: Engine, c: Candidate, value: Array, *, varying: bool = False) -> dict[int, Array]:
    """Whitened columns (K, k) by joint: the claim's torque times curves over what it may depend on; ``varying``: as in `with_forms`."""
    out = {}
    for i, (moving, still) in engine.columns(c.effect, c.joints, c.shapes).items():
        torque, at_rest = moving @ value, still @ value
        if varying and has_no_zero(engine, c):
            level = float(np.mean(engine.rows[i].plain(torque)))
            torque, at_rest = torque - level, at_rest - level
        shares = np.ones((len(torque), 1))  # what a law leaves at other joints, it leaves there as a whole
        if not c.joints or i in c.joints:
            shares = np.column_stack([shares, *(_curves(x, engine.rows[i].take) for x in _depends(engine, i, torque))])
        held = np.zeros((len(at_rest), shares.shape[1]))
        held[:, 0] = at_rest
        if np.any(torque):
            out[i] = engine.rows[i].column(torque[:, None] * shares, held)
    return out


def _depends(engine: Engine, joint: int, torque: Array) -> list[Array]:
    """(N,) each: what a law's form may depend on at a joint."""
    d = engine.data
    return [np.abs(torque), d.q[:, joint], d.dq[:, joint], engine.source.gravity[:, joint], d.trial + 0.0]


def _curves(x: Array, take: Index) -> Array:
    """(N, `DEGREE`) Legendre polynomials over the range of ``x`` in the rows ``take``; none where it does not vary."""
    lo, hi = (float(np.min(x[take])), float(np.max(x[take]))) if len(take) else (0.0, 0.0)
    if hi <= lo:
        return np.zeros((len(x), 0))
    return np.asarray(legvander(np.clip(2 * (x - lo) / (hi - lo) - 1, -1.0, 1.0), limit.DEGREE)[:, 1:], np.float64)
