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

from stopset.offline.diagnose.columns.laws import columns
from stopset.offline.diagnose.evidence.candidate import Candidate, Form
from stopset.offline.diagnose.evidence.engine import Engine
from stopset.offline.diagnose.evidence.hypothesis import Hypothesis
from stopset.types import Array

STEPS = 6  # values of a random function, over as many equal parts of the rows


def with_forms(now: Hypothesis, claims: Sequence[Candidate], theta: Array) -> Hypothesis:
    """``now`` with the random effects of its ``claims``' forms; ``theta``: coefficients of `Hypothesis.nuisance`."""
    place = {column: k for k, column in enumerate(now.nuisance.tolist())}
    view = now.view()
    grams, size, forms = list(view.engine.grams), view.engine.size, list(view.forms)
    for c in claims:
        parts = form_columns(now.engine, c, theta[[place[k] for k in c.cols.tolist()]])
        count = sum(w.shape[1] for w in parts.values())
        at = size
        for i, w in parts.items():
            grams[i] = grams[i].bordered(w, np.arange(at, at + w.shape[1]))
            at += w.shape[1]
        forms.append(Form(c.key, np.arange(size, size + count)))
        size += count
    return replace(view, engine=replace(view.engine, grams=grams, size=size), forms=tuple(forms))


def form_columns(engine: Engine, c: Candidate, value: Array) -> dict[int, Array]:
    """Whitened columns (K, k) by joint: the claim's torque in each part of what it may depend on."""
    out = {}
    for i, (moving, still) in columns(engine.source, c.effect, c.joints, c.shapes).items():
        torque, at_rest = moving @ value, still @ value
        if c.joints and i not in c.joints:
            moved, held = torque[:, None], at_rest[:, None]  # what a law leaves at other joints, it leaves there as a whole
        else:
            parts = [_parts(x, engine.rows[i].take) for x in _depends(engine, i, torque)]
            moved = np.concatenate([torque[:, None] * p for p in parts], axis=1)
            held = np.tile(at_rest[:, None] / len(parts) / STEPS, moved.shape[1])
        if np.any(moved):
            out[i] = engine.rows[i].column(moved, held)
    return out


def _depends(engine: Engine, joint: int, torque: Array) -> list[Array]:
    """(N,) each: what a law's form may depend on at a joint."""
    d = engine.data
    place = d.trial + 0.0
    return [np.abs(torque), d.q[:, joint], d.dq[:, joint], engine.source.gravity[:, joint], place]


def _parts(x: Array, take: Array) -> Array:
    """(N, k) which of the equal parts of the rows ``take`` a row's ``x`` lies in; one part where it does not vary."""
    edges = np.unique(np.quantile(x[take], np.linspace(0, 1, STEPS + 1)[1:-1])) if len(take) else np.zeros(0)
    return np.eye(len(edges) + 1)[np.searchsorted(edges, x)]
