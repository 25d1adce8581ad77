"""Readings that are off: a few samples (a spike), or all from some row on (an encoder that jumped)."""

from __future__ import annotations

import numpy as np

from stopset.monitor.evidence.case import BACK, Case
from stopset.monitor.evidence.cause import Cause, Kind
from stopset.monitor.evidence.dynamics import Readings

SPIKE = 3  # rows that a spike lasts at most


def spike(c: Case) -> Cause | None:
    """A few bad samples: without them everything agrees."""
    before = c.readings.x[c.at - 1]
    for length in range(1, SPIKE + 1):
        for start in (c.at, c.at - 1, c.at - 2):
            rows = slice(start, start + length)
            if start < 1 or start + length >= len(c.w) or not c.holds(c.readings.without(rows)):
                continue
            torque = Readings(c.readings.x, c.readings.without(rows).u, c.readings.good)
            if c.holds(torque):
                size = c.w.tau[rows] - 0.5 * (c.w.tau[start - 1] + c.w.tau[start + length])
                j = int(np.argmax(np.abs(size).max(axis=0) / (c.model.U_hi - c.model.U_lo)))
                value, signal, unit = float(size[np.argmax(np.abs(size[:, j])), j]), "tau", "N m"
            else:
                j, signal, unit = c.joint, c.signal, c.unit
                away = (c.w.q if signal == "q" else c.w.dq)[rows, j] - before[j if signal == "q" else c.model.n + j]
                value = float(away[np.argmax(np.abs(away))])
            words = {"q": "position", "dq": "speed", "tau": "torque"}[signal]
            many = "one sample" if length == 1 else f"{length} samples"
            return c.cause(
                Kind.SPIKE, f"{many} of the {words} of {c.model.joints[j]} off by {value:.3g} {unit}; all others agree with the model",
                j, start, signal=signal, size=value, unit=unit,
            )  # fmt: skip
    return None


def jump(c: Case) -> Cause | None:
    """A reading that is off by the same amount from some row on."""
    n, i = c.model.n, c.joint + (0 if c.signal == "q" else c.model.n)
    lo = max(0, c.at - BACK)
    e = c.model.innovations(c.readings)[lo : c.at, :]
    for signal, column in ((c.signal, i), ("q", c.joint), ("dq", n + c.joint)):
        k = lo + int(np.argmax(np.abs(e[:, column])))
        step = _step(c, k, column)
        if step is None:
            continue
        shift = np.zeros_like(c.readings.x)
        shift[k + 1 :, column] = -step
        if not c.holds(c.readings.plus(x=shift)):
            continue
        what, unit = ("position", "rad") if signal == "q" else ("speed", "rad/s")
        return c.cause(
            Kind.ENCODER_JUMP, f"the {what} of {c.model.joints[c.joint]} jumped by {step:.3g} {unit} and stayed there, without motion",
            c.joint, k + 1, signal=signal, size=step, unit=unit,
        )  # fmt: skip
    return None


def _step(c: Case, k: int, column: int) -> float | None:
    """The middle of what a state can have jumped by after row ``k``, by the rows around; None if no jump explains them."""
    least, most, x = -np.inf, np.inf, c.readings.x
    for start in range(max(0, k - BACK), k + 1):
        predicted = x[start]
        for row in range(start + 1, min(k + 1 + BACK, len(x))):
            predicted = predicted @ c.model.Ad.T + c.readings.u[row - 1] @ c.model.Bd.T
            age = row - start
            if row > k and age < len(c.model.lo):
                away = x[row, column] - predicted[column]
                least, most = max(least, away - c.model.hi[age, column]), min(most, away - c.model.lo[age, column])
    return 0.5 * float(least + most) if least <= most else None
