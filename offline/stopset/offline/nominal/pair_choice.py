"""Whether two neighbouring joints share a motor, by the torque the nominal model leaves on what was not fitted.

A wrist whose drive runs through the joint before it shows a torque of the sum of both speeds on both joints; fitted joint by joint it
looks like friction that depends on nothing of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise

import numpy as np

from stopset.effects import Effect, Signals, get
from stopset.effects.selection import base, usual
from stopset.offline.campaign.hold_out import blocks
from stopset.offline.nominal.friction_choice import Gain
from stopset.offline.nominal.nominal import identify_nominal
from stopset.offline.nominal.preprocess import Preprocessing
from stopset.offline.nominal.residual import Residual, residuals
from stopset.recording.types import Recording
from stopset.robot import Robot
from stopset.types import Array

LOWERED = 0.2  # share by which the law must lower the held-out torque error of one of the joints
LOOKED_AT = 16  # trials


def coupled(
    robot: Robot, trials: Callable[[], Iterable[Recording]], sample: Sequence[Recording], settings: Preprocessing | None = None
) -> tuple[Gain, ...]:
    """Pairs of neighbouring joints that ask for a law, worst error first; ``sample``: trials to judge on."""
    nominal = identify_nominal(robot, trials, base(), settings=settings)
    some = sample[:: max(1, len(sample) // LOOKED_AT)]
    parts = [x for r in some for b in blocks(r) for x in residuals(nominal, robot, b)]
    if len(parts) < 2:
        return ()
    out = []
    for a, b in pairwise(range(robot.n)):
        before, found = _held_out(parts, (a, b), None), []
        for name in usual("pair"):
            after = _held_out(parts, (a, b), get(name))
            gain = 1.0 - np.sqrt(after / np.maximum(before, 1e-300))
            if gain.max() > LOWERED and gain.min() > 0:
                k = int(gain.argmax())
                said = Gain(name, f"{robot.joints[a]}+{robot.joints[b]}", float(np.sqrt(before[k])), float(np.sqrt(after[k])))
                found.append((float(after.sum()), said))
        if found:  # laws of one pair are forms of one cause: it is the one that leaves least
            out.append(min(found, key=lambda x: x[0])[1])
    return tuple(out)


def _held_out(parts: Sequence[Residual], pair: tuple[int, int], law: Effect | None) -> Array:
    """(2,) mean square [N m] left at both joints of the parts that were left out in turn, every other one."""
    rows = [_rows(x, pair, law) for x in parts]
    squares, count = np.zeros(2), np.zeros(2)
    for half in (0, 1):
        X = np.concatenate([x for k, part in enumerate(rows) if k % 2 != half for x, _ in part])
        y = np.concatenate([y for k, part in enumerate(rows) if k % 2 != half for _, y in part])
        theta = _within_range(X, y, law)
        for part in (p for k, p in enumerate(rows) if k % 2 == half):
            for j, (x, left) in enumerate(part):
                squares[j] += float(np.sum((left - x @ theta) ** 2))
                count[j] += len(left)
    return squares / np.maximum(count, 1)


def _within_range(X: Array, y: Array, law: Effect | None) -> Array:
    """Least squares with the law's terms, the last columns, inside their ranges: a motor that drives with its friction is none."""
    from scipy.optimize import lsq_linear

    if law is None:
        return np.asarray(np.linalg.lstsq(X, y, rcond=1e-9)[0])
    Q, R = np.linalg.qr(X)
    free = [np.inf] * (X.shape[1] - len(law.terms))
    bounds = ([*(-x for x in free), *(t.lo for t in law.terms)], [*free, *(t.hi for t in law.terms)])
    return np.asarray(lsq_linear(R, Q.T @ y, bounds).x)


def _rows(x: Residual, pair: tuple[int, int], law: Effect | None) -> list[tuple[Array, Array]]:
    """Columns and leftover torque of both joints where they move: friction of their own again, and the shared motor's."""
    out = []
    for own, (i, k) in enumerate((pair, pair[::-1])):
        here = x.moving[:, i]
        mine = np.zeros((int(here.sum()), 6))
        mine[:, 3 * own : 3 * own + 3] = np.column_stack([np.sign(x.dq[here, i]), x.dq[here, i], x.ddq[here, i]])
        if law is not None:
            s = Signals(dq=x.dq[here, i], dq_other=x.dq[here, k], ddq_other=x.ddq[here, k])
            mine = np.column_stack([mine, *law.columns(s)])
        out.append((mine, x.left[here, i]))
    return out
