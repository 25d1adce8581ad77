"""What changed since a model was identified: friction, offset, torque scale of a joint, or a load, against the model as it is.

The model's own torque, effects and all, is taken off the recordings; nothing is fitted again.  What is left is asked for a change
of level: of Coulomb and viscous friction, of an offset, of the torque's scale, of the last link's mass and its moments.  A change
counts where it lowers the error on blocks of time that it was not fitted to, is several standard errors large, and is more than an
arm's friction differs from day to day anyway.  How friction is shared between its two parts may always differ: motions of few speeds
hardly tell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stopset.artifact import Model
from stopset.effects.base import Fitted
from stopset.effects.registry import get
from stopset.offline.campaign.hold_out import blocks
from stopset.offline.compare.known import Rows, rows_left
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.levels import PARTS, LevelChange, level_changes, look_alikes, while_moving
from stopset.offline.diagnose.rows.sampling import period_of
from stopset.recording import Recording
from stopset.types import Array

RIDGE = 1e-9  # relative: rounding
STEPS = 3  # joints that weigh what is left of them, from equal shares on


@dataclass(frozen=True, slots=True)
class Change:
    """One level ``before`` (the model's) and ``after`` in ``unit``, with the error ``std`` of the difference.

    ``error_before, error_after`` [N m]: held-out torque error at the joint ``at``: ``joint``, or the worst one for a load, where it is
    None.
    """

    effect: str
    joint: str | None
    symbol: str
    unit: str
    before: float
    after: float
    std: float
    error_before: float
    error_after: float
    at: str
    since: str = ""
    alike: tuple[str, ...] = ()  # laws that explain as much of it in these recordings

    @property
    def label(self) -> str:
        """``effect:joint``."""
        return f"{self.effect}:{self.joint}" if self.joint else self.effect

    @property
    def says(self) -> str:
        where = f" of {self.joint}" if self.joint else " of all joints" if get(self.effect).scope == "joint" else ""
        part = get(self.effect).part
        what = PARTS[part] if part else f"{self.symbol} of {self.effect}"
        when = f"from {self.since} on" if self.since else "before the first of these recordings"
        level = f"from {self.before:.3g} to {self.after:.3g} {self.unit} (+- {self.std:.2g})"
        return f"The {what}{where} changed {level}, {when}."


@dataclass(frozen=True, slots=True)
class _Judged:
    """A candidate's ``gain`` (none: not positive), coefficients ``theta``, ``std`` (k,), those of what is ``beside`` (m,), and the
    held-out error (n,) before and after."""

    gain: float
    theta: Array
    std: Array
    beside: Array
    before: Array
    after: Array

    def certain(self, c: LevelChange) -> NDArray[np.bool_]:
        """(k,) which coefficients are a change."""
        return np.asarray(np.abs(self.theta) > np.maximum(limit.CHANGE_SURE * np.hypot(self.std, c.error), c.least))


def changes(model: Model, recordings: Sequence[Recording], transmitted: Sequence[Fitted] = ()) -> tuple[Change, ...]:
    """Changes since the model was identified, the most telling first; empty where the recordings are too short to tell.

    ``transmitted``: laws of the load that are of all that their gears transmit, of which the model has gravity's part.
    """
    left, block, found, alike, begins = _rows(model, recordings, transmitted)
    count = int(block.max()) + 1 if len(block) else 0
    if count < limit.CHANGE_TRIALS:
        return ()
    out: list[Change] = []
    rows = np.isfinite(left).sum(axis=0)  # none where a joint stands throughout
    scale = np.maximum(np.sqrt(np.nansum(left**2, axis=0) / np.maximum(rows, 1)), 1e-9)
    while len(out) < limit.CHANGES:
        tried = [(c, j) for c in found if (j := _judged(left, block, count, scale, c)).gain > 0]
        if not tried:
            break
        candidate, judged = _simplest(tried)
        onset = _onset(left, block, count, scale, candidate)
        here, since = block >= onset, partial(_since, left, block, onset, scale)
        if onset:
            of_it = [c for c in found if c is candidate or (c.friction and candidate.friction and c.joint == candidate.joint)]
            again = [(c.only(here), since(c)) for c in of_it]
            candidate, judged = _simplest([(c, j) for c, j in again if j.gain > 0] or [(candidate, judged)])
        certain = bool(judged.certain(candidate).any())
        same = [c for c in found if c.friction and candidate.friction and c.joint == candidate.joint and (certain or onset)]
        found = [c for c in found if not c.same_as(candidate) and not any(c is x for x in same)]
        if certain:
            rivals = [(c.only(here), since(c)) for c in alike if candidate.friction and c.joint == candidate.joint]
            rivals = [(c, j) for c, j in rivals if c.possible(j.theta)]
            candidate, judged = _truer(candidate, judged, rivals)
            found = [c for c in found if not c.same_as(candidate)]
            if not candidate.enough(judged.theta):
                continue
            same_law = _as_good(candidate, judged, rivals)
            out += [replace(c, alike=same_law) for c in _said(model, candidate, judged, begins[onset] if onset else "")]
            left = left - np.einsum("rjk,k->rj", candidate.columns, judged.theta)
    return tuple(out[: limit.CHANGES])


def _since(left: Array, block: np.ndarray, onset: int, scale: Array, c: LevelChange) -> _Judged:
    """A candidate judged on the rows from a block on."""
    here, count = block >= onset, int(block.max()) + 1
    return _judged(left[here], block[here] - onset, count - onset, scale, c.rows(here))


def _truer(c: LevelChange, judged: _Judged, rivals: Sequence[tuple[LevelChange, _Judged]]) -> tuple[LevelChange, _Judged]:
    """A level of a joint's friction, or the law that looks like it and leaves less of the error by as much as a change must take."""
    j = c.joint
    less = [t for t in rivals if t[1].certain(t[0]).all() and t[1].after[j] < (1.0 - limit.CHANGE_LOWERED) * judged.after[j]]
    return min(less, key=lambda t: float(t[1].after[j]), default=(c, judged))


def _as_good(c: LevelChange, judged: _Judged, rivals: Sequence[tuple[LevelChange, _Judged]]) -> tuple[str, ...]:
    """Laws that look like a changed level and explain it as well, for want of other loads or speeds in these recordings.

    None where ``c`` is such a law itself: it left clearly less than the level.
    """
    if any(c is x for x, _ in rivals):
        return ()
    return tuple(x.levels[0].effect for x, j in rivals if j.certain(x).all() and j.gain > limit.ALIKE * judged.gain)


def _onset(left: Array, block: np.ndarray, count: int, scale: Array, c: LevelChange) -> int:
    """The block from which on a change explains most; 0 where that is not clearly more than from the first one on."""
    y, X, _ = _scaled(left, scale, c.columns)
    A, b = _normal(y, X, block, count)
    later_A, later_b = (np.cumsum(x[::-1], axis=0)[::-1] for x in (A, b))
    ridge = RIDGE * np.eye(A.shape[1]) * np.trace(later_A[0])
    gains = np.array([v @ np.linalg.solve(M + ridge, v) for M, v in zip(later_A, later_b, strict=True)])
    best = int(np.argmax(gains[: max(1, count - limit.CHANGE_BLOCKS + 1)]))
    return best if best >= limit.CHANGE_BLOCKS and gains[best] > (1 + limit.CHANGE_ONSET) * gains[0] else 0


def _simplest(tried: Sequence[tuple[LevelChange, _Judged]]) -> tuple[LevelChange, _Judged]:
    """The change of largest gain, but a constant torque where it says as much; of a joint's friction the one by which both its numbers
    need differ least from the model's.

    A motion of few speeds tells how much friction there is, but hardly how it is shared between its dry and its viscous part.
    """
    best = max(tried, key=lambda t: t[1].gain)
    if not best[0].friction:  # a load that hardly varies is a constant torque, which is plainer than a scale of it
        flat = (t for t in tried if t[0].constant and t[0].joint == best[0].joint and t[1].gain > limit.ALIKE * best[1].gain)
        return next(flat, best)
    same = [t for t in tried if t[0].friction and t[0].joint == best[0].joint]
    both = [t for t in same if len(t[1].theta) > 1 and t[1].certain(t[0]).all()]
    alike = [t for t in same if len(t[1].theta) == 1 and t[1].gain > limit.ALIKE * best[1].gain]
    return next(iter(both), min(alike, key=lambda t: float(np.sum(np.abs(t[1].beside))), default=best))


def _said(model: Model, c: LevelChange, judged: _Judged, since: str) -> list[Change]:
    """What is told of a change, the coefficients that are one."""
    where = range(model.n) if c.joint is None else [c.joint]
    worst = max(where, key=lambda j: judged.before[j] - judged.after[j])
    certain, std = judged.certain(c), np.hypot(judged.std, c.error)
    return [
        Change(
            x.effect, None if c.joint is None else model.joints[c.joint], x.symbol, x.unit, x.before,
            x.before + x.per * float(judged.theta[x.of]), abs(x.per) * float(std[x.of]), float(judged.before[worst]),
            float(judged.after[worst]), model.joints[worst], since,
        )
        for x in c.levels if certain[x.of]
    ]  # fmt: skip


class _Taken(NamedTuple):
    """Rows of motions: ``q, dq, ddq``, what the model leaves of the torque, ``left``, nan where a joint stands (rows, n), each row's ``block``,
    and where blocks begin."""

    q: Array
    dq: Array
    ddq: Array
    left: Array
    block: NDArray[np.intp]
    begins: list[str]


def _taken(model: Model, recordings: Sequence[Recording], *, filtered: bool = False) -> _Taken | None:
    parts: list[Rows] = []
    block: list[int] = []
    begins: list[str] = []
    number, moving = 0, [r for r in recordings if r.phase != "static"]
    whole = len(moving) >= limit.CHANGE_TRIALS  # friction scatters from trial to trial: pieces of one err alike
    for r in moving:
        for piece in (r,) if whole else blocks(r):
            for rows in rows_left(model, piece, filtered=filtered):
                parts.append(rows)
                block += [number] * len(rows.left)
            if number in block[-1:]:  # one that gave no row, as a stop's, is none
                begins.append(r.label if whole else f"{piece.t[0]:.0f} s of {r.label}")
                number += 1
    if not parts:
        return None
    q, dq, ddq, left, rate = (np.concatenate(x) for x in zip(*parts, strict=True))
    return _Taken(q, dq, ddq, _in_step(left, dq, rate, period_of(moving)), np.array(block), begins)


def _rows(
    model: Model, recordings: Sequence[Recording], transmitted: Sequence[Fitted]
) -> tuple[Array, np.ndarray, list[LevelChange], list[LevelChange], list[str]]:
    """Leftover torque (rows, n), nan where a joint stands, the block of each row, all levels that may have changed, the laws that look
    like them, and where blocks begin."""
    x = _taken(model, recordings)
    if x is None:
        return np.zeros((0, model.n)), np.zeros(0, np.intp), [], [], []
    levels = level_changes(model, x.q, x.dq, x.ddq, np.isfinite(x.left))
    left = x.left - while_moving(model, transmitted, x.q, x.dq, x.ddq)
    return left, x.block, levels, look_alikes(model, x.q, x.dq, x.ddq, levels), x.begins


def left_beside_friction(model: Model, recordings: Sequence[Recording]) -> Array:
    """(n,) [N m] root mean square of the torque that a model leaves of each joint beside friction, of which a joint has another day more or
    less; nan where it never moves.  What laws say passes the filter of the rows."""
    x = _taken(model, recordings, filtered=True)
    out = np.full(model.n, np.nan)
    if x is None:
        return out
    for j in range(model.n):
        use = np.isfinite(x.left[:, j])
        rubs, y = np.column_stack([np.sign(x.dq[use, j]), x.dq[use, j]]), x.left[use, j]
        if len(y) > rubs.shape[1]:
            out[j] = float(np.sqrt(np.mean((y - rubs @ np.linalg.lstsq(rubs, y, rcond=None)[0]) ** 2)))
    return out


def _in_step(left: Array, dq: Array, rate: Array, period: float) -> Array:
    """What is ``left`` without what a lag of less than a sample, of all torque alike, makes of it; ``rate`` [N m/s]: of the recorded torque.

    Up to half a sample stamps tell no lag, so none of that size was taken out.  Gravity that comes late looks like friction: at six
    milliseconds a change of a shoulder's by 11 %.  Friction and a constant torque of every joint stand beside the lag.
    """
    use = np.isfinite(left)
    joints = range(left.shape[1])
    own = [np.column_stack([np.sign(dq[:, j]), dq[:, j], np.ones(len(dq))])[use[:, j]] for j in joints]
    y, late = ([x[use[:, j], j] for j in joints] for x in (left, rate))

    def beside(x: Array, j: int) -> Array:
        return np.asarray(x - own[j] @ np.linalg.lstsq(own[j], x, rcond=None)[0])

    some = [j for j in joints if len(y[j]) > own[j].shape[1]]
    rest, slope = ({j: beside(x[j], j) for j in some} for x in (y, late))
    noise = {j: float(np.mean(rest[j] ** 2)) for j in some}
    lag, known = 0.0, (limit.STAMPS * period) ** -2
    for _ in range(STEPS):  # each joint weighs what the lag leaves of it
        weight = {j: 1.0 / max(noise[j], 1e-12) for j in some}
        lag = sum(w * float(slope[j] @ rest[j]) for j, w in weight.items()) / (
            known + sum(w * float(slope[j] @ slope[j]) for j, w in weight.items())
        )
        noise = {j: float(np.mean((rest[j] - lag * slope[j]) ** 2)) for j in some}
    return np.asarray(left - lag * rate)


def _judged(left: Array, block: np.ndarray, count: int, scale: Array, c: LevelChange) -> _Judged:
    """A candidate beside what may differ besides, against the latter alone, on blocks that were left out."""
    k = c.columns.shape[2]
    y, X, use = _scaled(left, scale, np.concatenate([c.columns, c.beside], axis=2))
    e0, _ = _left_out(y, X[:, :, k:], block, count)
    e1, (theta, rest) = _left_out(y, X, block, count)
    std = np.sqrt((count - 1) / count * np.sum((rest - rest.mean(axis=0)) ** 2, axis=0))
    n = np.maximum(use.sum(axis=0), 1)
    before, after = (scale * np.sqrt(np.sum(x**2, axis=0) / n) for x in (e0, e1))
    where = list(range(len(scale))) if c.joint is None else [c.joint]
    lowered = float(np.max(1.0 - after[where] / np.maximum(before[where], 1e-12)))
    gain = float(np.sum(e0**2) - np.sum(e1**2)) if lowered > limit.CHANGE_LOWERED else 0.0
    return _Judged(gain, theta[:k], std[:k], theta[k:], before, after)


def _left_out(y: Array, X: Array, block: np.ndarray, count: int) -> tuple[Array, tuple[Array, Array]]:
    """(rows, n) errors on blocks that a fit has not seen; coefficients of the whole (k,) and without each block (count, k)."""
    A, b = _normal(y, X, block, count)
    ridge = RIDGE * np.diag(np.maximum(np.diagonal(A.sum(axis=0)), 1e-30))
    whole, right = A.sum(axis=0), b.sum(axis=0)
    theta = np.linalg.solve(whole + ridge, right)
    rest = np.linalg.solve(whole - A + ridge, (right - b)[:, :, None])[:, :, 0]
    return y - np.einsum("rjk,rk->rj", X, rest[block]), (theta, rest)


def _scaled(left: Array, scale: Array, columns: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Leftover (rows, n) and columns in units of ``scale``, zero where a joint stands; which count."""
    use = np.isfinite(left)
    return np.where(use, left, 0.0) / scale, np.where(use[:, :, None], columns, 0.0) / scale[:, None], use


def _normal(y: Array, X: Array, block: np.ndarray, count: int) -> tuple[Array, Array]:
    """Normal matrices (count, k, k) and right-hand sides of each block."""
    k = X.shape[2]
    A, b = np.zeros((count, k, k)), np.zeros((count, k))
    np.add.at(A, block, np.einsum("rjk,rjl->rkl", X, X))
    np.add.at(b, block, np.einsum("rjk,rj->rk", X, y))
    return A, b
