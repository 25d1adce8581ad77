"""What no tube sees because the torque set is wide enough for it, looked for at leisure in what was read of late.

Nothing here refutes a model; it is said, and somebody should look.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from stopset.errors import OutputError
from stopset.files import write_text
from stopset.monitor.evidence.dynamics import Dynamics, Readings
from stopset.monitor.evidence.trace import Window
from stopset.types import Array

EVERY = 10.0  # [s] between two looks
SPAN = 4.0  # [s] of readings that are looked at
LATEST = 15  # cycles that torque is tried late by
LESS = 0.6  # of the unexplained torque's square may be left by the right delay, for it to be told
FEWEST = 250  # rows without a gap, below which nothing is told
MOVED = 0.005  # [rad] between two lives of the monitor that are worth a word
POSITION = "last-position.json"


def late_torque(w: Window, model: Dynamics, pause: Callable[[], None]) -> float | None:
    """By how much [s] the torque of all joints seems to be told late; None if its stamps explain the motion best as they are.

    ``pause`` is called between looks that take some tenths of a millisecond.
    """
    lo, hi = w.run(len(w) - 1)
    w = w.part(lo, hi)
    if len(w) < FEWEST or not np.isfinite(w.tau).all():
        return None
    r = Readings.of(w)
    y = model.pushes(r)
    rows = len(y) - LATEST
    if float(np.ptp(w.dq, axis=0).max()) < 0.05:  # of an arm that stands nothing is told
        return None
    weight = 1.0 / (model.U_hi - model.U_lo)

    def left(late: int) -> float:
        pause()
        moved = np.zeros_like(w.tau)
        moved[: len(moved) - late] = w.tau[late:] - w.tau[: len(w.tau) - late]
        rest = (y - model.averaged(moved))[:rows]
        return float(np.square((rest - rest.mean(axis=0)) * weight).sum())

    sizes = [left(d) for d in range(LATEST + 1)]
    best = int(np.argmin(sizes))
    return best * model.dt if best and sizes[best] < LESS * sizes[0] else None


def late_words(seconds: float) -> str:
    return (
        f"the motion of the last seconds is explained best if the torque acted {1e3 * seconds:.0f} ms before it was told; expected "
        "torque and position of one instant: look at the drives' filters and at who stamps the messages"
    )


def stored_position(folder: Path) -> Array | None:
    """Where the arm was when the monitor was last at work [rad]; None if that is not known."""
    try:
        return np.array([float(x) for x in json.loads((folder / POSITION).read_text())["q"]])
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError):
        return None


def keep_position(folder: Path, q: Array) -> None:
    """For the next life of the monitor; a disk that refuses is met elsewhere."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_text(folder / POSITION, json.dumps({"q": q.tolist()}))
    except (OSError, OutputError):
        return


def moved_words(before: Array, q: Array, joints: tuple[str, ...]) -> str:
    """What is worth saying of an arm that is not where it was left; empty if it is."""
    if len(before) != len(q):
        return ""
    far = [(abs(d), j, d) for d, j in zip(q - before, joints, strict=True) if abs(d) > MOVED]
    if not far:
        return ""
    said = ", ".join(f"{j} by {d:+.4f} rad" for _, j, d in sorted(far, reverse=True)[:3])
    return (
        f"the arm is not where it was when last watched: {said}; expected if it was moved meanwhile, else an encoder has lost its "
        "home: check the marks"
    )
