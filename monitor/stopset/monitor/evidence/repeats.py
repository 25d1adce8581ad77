"""Readings that repeat themselves while the arm moves: old messages, a frozen position or torque."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stopset.monitor.evidence.case import BACK, Case
from stopset.monitor.evidence.cause import Cause, Kind
from stopset.types import Array

REPEATS = 5  # identical readings in a row that are no coincidence where the arm moves
FEW = 3.0  # smallest steps of a position that a speed must have made for it to be called frozen
TURN = 8.0  # smallest steps that a torque which turns round makes, at most, as long before or after as it seems to stay


def _same(x: Array) -> NDArray[np.bool_]:
    """(N,) whether a row is the one before."""
    return np.concatenate([[False], np.all(x[1:] == x[:-1], axis=1)])


def _repeat_around(same: NDArray[np.bool_], at: int, least: int) -> tuple[int, int] | None:
    """First and last row of the longest repetition that touches what led to row ``at``."""
    best = None
    k = 0
    while k < len(same):
        end = k
        while end < len(same) and same[end]:
            end += 1
        if end - k >= least - 1 and k - BACK <= at <= end + BACK and (best is None or end - k > best[1] - best[0]):
            best = (k, end)
        k = end + 1
    return None if best is None else (best[0] - 1, best[1] - 1)


def repeated(c: Case) -> Cause | None:
    """Readings that stay exactly what they were while the arm cannot have stood still."""
    w, n = c.w, c.model.n
    every = _same(np.hstack([w.q, w.dq, w.tau]))
    if (found := _repeat_around(every, c.at, REPEATS)) and _moved(c, found, range(n)):
        a, b = found
        return c.cause(
            Kind.STALE, f"all readings stayed exactly the same for {b - a + 1} cycles while the arm moved: old messages sent again",
            None, a, signal="q", size=(b - a + 1) * c.model.dt, unit="s",
        )  # fmt: skip
    for j in sorted(range(n), key=lambda j: j != c.joint):
        for signal, columns, least in (("q", [w.q, w.dq], REPEATS), ("q", [w.q], REPEATS), ("tau", [w.tau], 2 * REPEATS)):
            same = _same(np.column_stack([x[:, j] for x in columns]))
            found = _repeat_around(same, c.at, least)
            if found is None or not _moved(c, found, [j]) or _usual(same, found, c.at):
                continue
            a, b = found
            if not _says_it_moves(c, found, j) if signal == "q" else _turns(c, found, j):
                continue
            what = "torque" if signal == "tau" else "position and speed" if len(columns) == 2 else "position"
            return c.cause(
                Kind.FROZEN, f"the {what} of {c.model.joints[j]} stayed exactly the same for {b - a + 1} cycles while it moved",
                j, a, signal=signal, size=(b - a + 1) * c.model.dt, unit="s",
            )  # fmt: skip
    return None


def _says_it_moves(c: Case, rows: tuple[int, int], j: int) -> bool:
    """Whether the speed that is read contradicts a position that stays: by the time it would have made some of its smallest steps."""
    a, b = rows
    steps = np.abs(np.diff(c.w.q[:, j]))
    smallest = float(steps[steps > 0].min(initial=np.inf))
    travel = float(np.abs(c.w.dq[a : b + 1, j]).min()) * (b - a) * c.model.dt
    return travel > FEW * smallest


def _turns(c: Case, rows: tuple[int, int], j: int) -> bool:
    """Whether a torque may only have turned round there, below its smallest step: it changes little as long before and after."""
    (a, b), tau = rows, c.w.tau[:, j]
    steps = np.abs(np.diff(tau))
    around = abs(tau[a] - tau[max(0, 2 * a - b)]), abs(tau[min(len(tau) - 1, 2 * b - a)] - tau[b])
    return bool(max(around) <= TURN * steps[steps > 0].min(initial=np.inf))


def _moved(c: Case, rows: tuple[int, int], joints: range | list[int]) -> bool:
    """Whether the model says that some of the joints went on moving there, by more than the tube of that age is wide."""
    a, b = rows
    ages = min(b - a, len(c.model.lo) - 1)
    if ages < 1 or a < 1:
        return False
    x = c.readings.x[a]
    for k in range(ages):
        x = x @ c.model.Ad.T + c.readings.u[a + k] @ c.model.Bd.T
    e = c.readings.x[a + ages] - x
    out = (e > c.model.hi[ages]) | (e < c.model.lo[ages])
    return any(out[j] or out[c.model.n + j] for j in joints)


def _usual(same: NDArray[np.bool_], rows: tuple[int, int], at: int) -> bool:
    """Coarse readings repeat themselves at slow speeds: as long a repetition before means nothing."""
    longest = run = 0
    for k in range(min(rows[0], at - BACK)):
        run = run + 1 if same[k] else 0
        longest = max(longest, run)
    return 2 * longest >= rows[1] - rows[0]
