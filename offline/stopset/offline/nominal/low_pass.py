"""Whether the torque was low-passed before it was recorded, below what the motion does: friction then turns over slowly.

Public recordings are often smoothed, forwards and backwards, by whoever prepared them.  Torque of a real drive has noise; torque
without any was smoothed.  Left alone, each reversal leaves the joint's friction as an error that grows with its Coulomb part and takes equally
long at every joint and speed, which looks like hysteresis.  A model whose columns pass the same filter shows the cut-off: it is where the
least error is left.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from stopset.effects.selection import usual_friction
from stopset.offline.nominal.delay import joint_reduced, lag_weights
from stopset.offline.nominal.fit import residual, to_unit_length
from stopset.offline.nominal.normal_equations import accumulate
from stopset.offline.nominal.preprocess import Preprocessing, even_pieces
from stopset.recording.types import Recording
from stopset.robot import Robot

QUIET = 1e-5  # of a torque's range: less noise than a million counts; drives' torque has 2e-4 of it and more
CUTOFFS = tuple(0.7 * 2 ** (k / 2) for k in range(8))  # [Hz]: 0.7 to 8
FINER = tuple(2 ** (k / 8) for k in (-3, -2, -1, 1, 2, 3))  # times the best of them
KNOWN = 0.026  # of the cut-off, standard deviation: even over a step of the finer search
FILTER_LOWERS = 0.2  # share by which the filter must lower the torque error, joints taken together
TURNS_OVER = 0.44  # periods of the filter that its step takes from a tenth to nine tenths
SECONDS = 60.0  # of the recordings, looked at
PIECE = 10.0  # [s] about, of one fit
TELLING_ROWS = 100  # rows of a joint in a piece that says something
RELATIVE = 1e-9  # of the largest direction: below, columns are told apart by rounding alone


def recorded_low_pass(robot: Robot, trials: Sequence[Recording]) -> float:
    """Cut-off [Hz] of the low-pass without phase that the recorded torque went through; 0 where the data show none."""
    some = a_minute(trials)
    if not some or not all(_quiet(r) for r in some):
        return 0.0
    plain = log_torque_error(robot, some, 0.0)
    tried = {f: log_torque_error(robot, some, f) for f in CUTOFFS}
    best: float = min(CUTOFFS, key=lambda f: tried[f])
    if tried[best] > plain + np.log1p(-FILTER_LOWERS):
        return 0.0
    # the ends of pieces, which the filter did not have, pull the cut-off down: where it is, the longest trial says in one
    longest = max(trials, key=lambda r: float(r.t[-1] - r.t[0]) if r.phase != "static" else 0.0)
    whole = [longest.cut(0, int(np.searchsorted(longest.t, longest.t[0] + SECONDS)))]
    finer = {f * best: log_torque_error(robot, whole, f * best) for f in (1.0, *FINER)}
    sharpest: float = min(finer, key=lambda f: finer[f])
    return round(sharpest, 2)


def in_words(cutoff: float) -> str:
    """What it means, for people."""
    return (
        f"the recorded torque went through a low-pass of about {cutoff:.2g} Hz without phase: at a reversal it shows friction turning over "
        f"{TURNS_OVER / cutoff:.2g} s too slowly; the model passed the same filter when it was fitted, but the sets hold the difference: record "
        "the torque unfiltered"
    )


def a_minute(trials: Sequence[Recording]) -> list[Recording]:
    """Pieces of moving trials, of `SECONDS` together, evenly over those there are."""
    pieces = []
    for r in trials:
        if r.phase != "static" and len(r.t) > 2:
            edges = np.linspace(0, len(r.t), max(1, round(float(r.t[-1] - r.t[0]) / PIECE)) + 1).astype(int)
            pieces += [r.cut(lo, hi) for lo, hi in pairwise(edges.tolist()) if hi - lo > 2]
    total = sum(float(r.t[-1] - r.t[0]) for r in pieces)
    return pieces[:: max(1, int(total / SECONDS))]


def _quiet(r: Recording) -> bool:
    """Whether no joint's torque has the noise that drives have: fourth differences, which a motion hardly reaches, leave nothing."""
    pieces = [tau for _, _, tau, _ in even_pieces(r)]
    return all(bool(np.all(np.median(np.abs(np.diff(x, 4, axis=0)), axis=0) <= QUIET * np.ptp(x, axis=0))) for x in pieces)


def log_torque_error(robot: Robot, pieces: Sequence[Recording], cutoff: float) -> float:
    """Logarithm of the torque error in the mean over joints that move and pieces, each fitted by itself.

    What a few seconds ask for is little; over a minute what the model lacks hides what the filter does.
    """
    lags, out = lag_weights(0.0), []
    for piece in pieces:
        data = accumulate(robot, [piece], usual_friction(), Preprocessing(low_pass=cutoff))
        for j in np.flatnonzero(data.rows_moving.sum(axis=0) > TELLING_ROWS):
            G = joint_reduced(data.moving[:, j].sum(axis=0), lags)
            k = len(data.layout.index(int(j)))
            G = G[np.ix_([*range(k), -1], [*range(k), -1])]
            rows = float(data.rows_moving[:, j].sum())
            scale = to_unit_length(np.diag(G)[:-1], rows)
            A, b = scale[:, None] * G[:-1, :-1] * scale, scale * G[:-1, -1]
            theta = scale * np.linalg.lstsq(A, b, rcond=RELATIVE)[0]
            out.append(0.5 * np.log(max(residual(G, theta), 1e-300) / rows))
    return float(np.mean(out)) if out else 0.0
