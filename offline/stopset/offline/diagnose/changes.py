"""What changed since a model was identified: friction, offset, torque scale of a joint, or a load, against the model as it is.

The model's own torque, effects and all, is taken off the recordings; nothing is fitted again.  What is left is asked for a change
of level: of Coulomb and viscous friction, of an offset, of the torque's scale, of the last link's mass and its moments.  A change
counts where it lowers the error on blocks of time that it was not fitted to, is several standard errors large, and is more than an
arm's friction differs from day to day anyway.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stopset.artifact import Model
from stopset.effects.base import Effect, Part
from stopset.effects.registry import get
from stopset.effects.selection import of_part
from stopset.offline.campaign.hold_out import blocks
from stopset.offline.compare.known import left_over
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.nominal.preprocess import Preprocessing, motions
from stopset.recording import Recording
from stopset.robot.rigid import regressors, torques
from stopset.types import Array

PARTS: dict[Part, str] = {
    "dry friction": "Coulomb friction", "damping": "viscous friction", "constant torque": "constant torque",
    "torque scale": "torque scale", "load": "load at the flange",
}  # fmt: skip
ColumnLevel = tuple[str, str, str, float, float]  # of a column: effect, symbol, unit, level before, its error


@dataclass(frozen=True, slots=True)
class Change:
    """One level ``before`` (the model's) and ``after`` in ``unit``, with the error ``std`` of the difference.

    ``error_before, error_after`` [N m]: held-out torque error of ``joint`` (of the worst one for a load, where it is None);
    ``since``: from where in the recordings on; empty where they all show it.
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
    since: str = ""

    @property
    def says(self) -> str:
        where = f" of {self.joint}" if self.joint else ""
        when = f"from {self.since} on" if self.since else "before the first of these recordings"
        level = f"from {self.before:.3g} to {self.after:.3g} {self.unit} (+- {self.std:.2g})"
        return f"The {PARTS[get(self.effect).part]}{where} changed {level}, {when}."


@dataclass(frozen=True, slots=True)
class _Candidate:
    """Columns (rows, n, k) of a change, and what each says."""

    joint: int | None
    columns: Array
    terms: tuple[ColumnLevel, ...]
    least: tuple[float, ...]

    def only(self, here: NDArray[np.bool_]) -> _Candidate:
        """The same where ``here``, nothing elsewhere."""
        return replace(self, columns=np.where(here[:, None, None], self.columns, 0.0))

    def rows(self, here: NDArray[np.bool_]) -> _Candidate:
        """The same of these rows alone."""
        return replace(self, columns=self.columns[here])


def changes(model: Model, recordings: Sequence[Recording]) -> tuple[Change, ...]:
    """Changes since the model was identified, the most telling first; empty where the recordings are too short to tell."""
    left, block, found, begins = _rows(model, recordings)
    count = int(block.max()) + 1 if len(block) else 0
    if count < limit.CHANGE_TRIALS:
        return ()
    out: list[Change] = []
    scale = np.maximum(np.sqrt(np.nanmean(left**2, axis=0)), 1e-9)
    for _ in range(limit.CHANGES):
        tried = [(c, *_judged(left, block, count, scale, c)) for c in found]
        best = max(tried, key=lambda t: t[1], default=None)
        if best is None or best[1] <= 0:
            break
        candidate, _, theta, std, before, after = best
        onset = _onset(left, block, count, scale, candidate)
        here = block >= onset
        if onset:
            candidate = candidate.only(here)
            _, theta, std, before, after = _judged(left[here], block[here] - onset, count - onset, scale, candidate.rows(here))
        where = range(model.n) if candidate.joint is None else [candidate.joint]
        worst = max(where, key=lambda j: before[j] - after[j])
        certain = [
            Change(
                effect, None if candidate.joint is None else model.joints[candidate.joint], symbol, unit, level,
                level + float(theta[k]), float(np.hypot(std[k], error)), float(before[worst]), float(after[worst]), begins[onset] if onset else "",
            )
            for k, (effect, symbol, unit, level, error) in enumerate(candidate.terms)
            if abs(theta[k]) > max(limit.CHANGE_SURE * np.hypot(std[k], error), candidate.least[k])
        ]  # fmt: skip
        found = [c for c in found if c is not best[0]]
        if not certain:
            continue
        out += certain
        left = left - np.einsum("rjk,k->rj", candidate.columns, theta)
    return tuple(out[: limit.CHANGES])


def _onset(left: Array, block: np.ndarray, count: int, scale: Array, c: _Candidate) -> int:
    """The block from which on a change explains most; 0 where that is not clearly more than from the first one on."""
    A, b, _ = _sums(left, block, count, scale, c)
    later_A, later_b = (np.cumsum(x[::-1], axis=0)[::-1] for x in (A, b))
    ridge = 1e-9 * np.eye(A.shape[1]) * np.trace(later_A[0])
    gains = np.array([v @ np.linalg.solve(M + ridge, v) for M, v in zip(later_A, later_b, strict=True)])
    best = int(np.argmax(gains[: max(1, count - limit.CHANGE_BLOCKS + 1)]))
    return best if best >= limit.CHANGE_BLOCKS and gains[best] > (1 + limit.CHANGE_ONSET) * gains[0] else 0


def _rows(model: Model, recordings: Sequence[Recording]) -> tuple[Array, np.ndarray, list[_Candidate], list[str]]:
    """Leftover torque (rows, n), nan where a joint stands, the block of each row, all that may have changed, and where blocks begin."""
    parts: list[tuple[Array, ...]] = []
    block: list[int] = []
    begins: list[str] = []
    number, moving = 0, [r for r in recordings if r.phase != "static"]
    whole = len(moving) >= limit.CHANGE_TRIALS  # friction scatters from trial to trial: pieces of one err alike
    for r in moving:
        for piece in (r,) if whole else blocks(r):
            for m in motions(piece, Preprocessing()):
                k = m.retained
                q, dq, ddq, tau = (np.ascontiguousarray(x[k]) for x in (m.q, m.dq, m.ddq, m.tau))
                temp = None if m.temp is None else m.temp[k]
                u = model.input(q, dq, tau, temp, 0.0, m.t[k])
                part = Recording("closed_loop", 0, 0, 0, m.t[k], q, dq, tau)
                e = left_over(model, part, u, float("nan"), ddq, window=1)
                parts.append((q, dq, ddq, np.where(m.moving[k], e, np.nan)))
                block += [number] * len(k)
            if number in block[-1:]:  # one that gave no row, as a stop's, is none
                begins.append(r.label if whole else f"{piece.t[0]:.0f} s of {r.label}")
                number += 1
    if not parts:
        return np.zeros((0, model.n)), np.zeros(0, np.intp), [], []
    q, dq, ddq, left = (np.concatenate(x) for x in zip(*parts, strict=True))
    return left, np.array(block), _candidates(model, q, dq, ddq), begins


def _candidates(model: Model, q: Array, dq: Array, ddq: Array) -> list[_Candidate]:
    n, out = model.n, []
    dry_law, damping, offset, scale, body = map(of_part, PARTS)
    fitted = {(f.effect, f.joint): f for f in model.effects}

    def level(law: Effect, joint: str) -> tuple[float, float]:
        """What the model says, and its error."""
        f, symbol = fitted.get((law.name, joint)), law.terms[0].symbol
        return (0.0, 0.0) if f is None else (f.values.get(symbol, 0.0), f.std.get(symbol) or 0.0)

    rigid = torques(model.robot.chain, model.robot.pi, q, dq, ddq) + model.rotor * ddq
    for j, joint in enumerate(model.joints):
        dry, wet = level(dry_law, joint), level(damping, joint)

        def at(*columns: Array, j: int = j) -> Array:
            block = np.zeros((len(q), n, len(columns)))
            block[:, j] = np.column_stack(columns)
            return block

        friction = at(np.sign(dq[:, j]), dq[:, j])
        out.append(
            _Candidate(
                j, friction, (_column(dry_law, *dry), _column(damping, *wet)), (limit.DAILY * dry[0], limit.DAILY * wet[0])
            )
        )
        out.append(_Candidate(j, at(np.ones(len(q))), (_column(offset),), (limit.DAILY * dry[0],)))
        out.append(_Candidate(j, at(rigid[:, j]), (_column(scale),), (limit.LEAST_GAIN,)))
    tip = regressors(model.robot.chain, q, dq, ddq)[:, :, -10:]
    load = tuple(_column(body, term=k) for k in range(4))
    out.append(_Candidate(None, np.ascontiguousarray(tip[:, :, :4]), load, (limit.LEAST_MASS, *(3 * (1e9,)))))
    return out


def _column(law: Effect, before: float = 0.0, error: float = 0.0, term: int = 0) -> ColumnLevel:
    """What a column says."""
    return law.name, law.terms[term].symbol, law.terms[term].unit, before, error


def _sums(
    left: Array, block: np.ndarray, count: int, scale: Array, c: _Candidate
) -> tuple[Array, Array, tuple[Array, Array, NDArray[np.bool_]]]:
    """Normal matrices (count, k, k) and right-hand sides of each block; columns, leftover and which rows count, in units of ``scale``."""
    use = np.isfinite(left)
    y = np.where(use, left, 0.0) / scale
    X = np.where(use[:, :, None], c.columns, 0.0) / scale[:, None]
    k = X.shape[2]
    A, b = np.zeros((count, k, k)), np.zeros((count, k))
    np.add.at(A, block, np.einsum("rjk,rjl->rkl", X, X))
    np.add.at(b, block, np.einsum("rjk,rj->rk", X, y))
    return A, b, (X, y, use)


def _judged(left: Array, block: np.ndarray, count: int, scale: Array, c: _Candidate) -> tuple[float, Array, Array, Array, Array]:
    """Gain of a change (none: not positive), its numbers and their errors, held-out error (n,) before and after."""
    A, b, (X, y, use) = _sums(left, block, count, scale, c)
    k = X.shape[2]
    ridge = 1e-9 * np.eye(k) * np.trace(A.sum(axis=0))
    theta = np.linalg.solve(A.sum(axis=0) + ridge, b.sum(axis=0))
    rest = np.array([np.linalg.solve(A.sum(axis=0) - A[g] + ridge, b.sum(axis=0) - b[g]) for g in range(count)])
    std = np.sqrt((count - 1) / count * np.sum((rest - rest.mean(axis=0)) ** 2, axis=0))
    after = y - np.einsum("rjk,rk->rj", X, rest[block])
    n = np.maximum(use.sum(axis=0), 1)
    e0, e1 = (scale * np.sqrt(np.sum(x**2, axis=0) / n) for x in (y, after))
    where = list(range(len(scale))) if c.joint is None else [c.joint]
    lowered = float(np.max(1.0 - e1[where] / np.maximum(e0[where], 1e-12)))
    gain = float(np.sum(y**2) - np.sum(after**2)) if lowered > limit.CHANGE_LOWERED else 0.0
    return gain, theta, std, e0, e1
