"""Whether the torque was low-passed before it was recorded, below what the motion does: friction then turns over slowly.

Public recordings are often smoothed, forwards and backwards, by whoever prepared them.  Torque of a real drive has noise; torque
without any was smoothed.  Left alone, each reversal leaves the joint's friction as an error that grows with its Coulomb part and takes equally
long at every joint and speed, which looks like hysteresis.  A model whose columns pass the same filter shows the cut-off: it is where the
least error is left.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from stopset.effects.selection import usual_friction
from stopset.offline.nominal.delay import joint_reduced, lag_weights
from stopset.offline.nominal.fit import residual
from stopset.offline.nominal.normal_equations import accumulate
from stopset.offline.nominal.preprocess import Preprocessing, even_pieces
from stopset.recording.types import Recording
from stopset.robot import Robot

QUIET = 1e-5  # of a torque's range: less noise than a million counts; drives' torque has 2e-4 of it and more
CUTOFFS = tuple(0.7 * 2 ** (k / 2) for k in range(10))  # [Hz]: 0.7 to 16
FINER = tuple(2 ** (k / 8) for k in (-3, -2, -1, 1, 2, 3))  # times the best of them
KNOWN = 0.026  # of the cut-off, standard deviation: even over a step of the finer search
FILTER_LOWERS = 0.2  # share by which the filter must lower the torque error, joints taken together
TURNS_OVER = 0.44  # periods of the filter that its step takes from a tenth to nine tenths
SECONDS = 60.0  # of the recordings, looked at
RELATIVE = 1e-9  # of the largest direction: below, columns are told apart by rounding alone


def recorded_low_pass(robot: Robot, trials: Sequence[Recording]) -> float:
    """Cut-off [Hz] of the low-pass without phase that the recorded torque went through; 0 where the data show none."""
    some = _some(trials)
    if not some or not all(_quiet(r) for r in some):
        return 0.0
    plain = _left(robot, some, 0.0)
    tried = {f: _left(robot, some, f) for f in CUTOFFS}
    best = min(tried, key=lambda f: tried[f])
    tried |= {f * best: _left(robot, some, f * best) for f in FINER}
    best = min(tried, key=lambda f: tried[f])
    return round(best, 2) if tried[best] < plain + np.log1p(-FILTER_LOWERS) else 0.0


def in_words(cutoff: float) -> str:
    """What it means, for people."""
    return (
        f"the recorded torque went through a low-pass of about {cutoff:.2g} Hz without phase: at a reversal it shows friction turning over "
        f"{TURNS_OVER / cutoff:.2g} s too slowly; the model passed the same filter when it was fitted, but the sets hold the difference: record "
        "the torque unfiltered"
    )


def _some(trials: Sequence[Recording]) -> list[Recording]:
    """Moving trials of `SECONDS` together, evenly over those there are; of a longer one its beginning."""
    moving = [r.cut(0, int(np.searchsorted(r.t, r.t[0] + SECONDS))) for r in trials if r.phase != "static" and len(r.t) > 2]
    total = sum(float(r.t[-1] - r.t[0]) for r in moving)
    return moving[:: max(1, int(total / SECONDS))]


def _quiet(r: Recording) -> bool:
    """Whether no joint's torque has the noise that drives have: fourth differences, which a motion hardly reaches, leave nothing."""
    pieces = [tau for _, _, tau, _ in even_pieces(r)]
    return all(bool(np.all(np.median(np.abs(np.diff(x, 4, axis=0)), axis=0) <= QUIET * np.ptp(x, axis=0))) for x in pieces)


def _left(robot: Robot, trials: Iterable[Recording], cutoff: float) -> float:
    """Logarithm of the torque error of the best model of each joint by itself, in the mean of the joints that move."""
    data = accumulate(robot, trials, usual_friction(), replace(Preprocessing(), low_pass=cutoff))
    lags, out = lag_weights(0.0), []
    for j in np.flatnonzero(data.rows_moving.sum(axis=0) > 0):
        G = joint_reduced(data.moving[:, j].sum(axis=0), lags)
        k = len(data.layout.index(int(j)))
        G = G[np.ix_([*range(k), -1], [*range(k), -1])]
        scale = 1 / np.sqrt(np.maximum(np.diag(G)[:-1], 1e-300))
        A, b = scale[:, None] * G[:-1, :-1] * scale, scale * G[:-1, -1]
        theta = scale * np.linalg.lstsq(A, b, rcond=RELATIVE)[0]
        out.append(0.5 * np.log(max(residual(G, theta), 1e-300) / data.rows_moving[:, j].sum()))
    return float(np.mean(out)) if out else 0.0
