"""States of laws with memory along the samples."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numba import njit

from stopset.effects import Effect, Signals
from stopset.offline.diagnose.prepare import Array, Index, Mask


def memory(effect: Effect, s: Signals, shapes: Mapping[str, float], start: Mask, dt: float) -> tuple[Array, ...]:
    """The effect's states along the samples, zero at the start of each trial; Dahl's curve exactly in the way travelled.

    Other flows are integrated by Heun's method at the recording's rate, all trials beside each other.
    """
    if effect.name == "hysteresis":
        return (_dahl(np.asarray(s.dq) * dt / shapes["delta"], start),)
    first = np.flatnonzero(start)
    length = np.diff(np.append(first, len(start)))
    states = np.zeros((len(effect.states), len(start)))
    x = np.zeros((len(effect.states), len(first)))
    arrays = {k: np.asarray(v) for k in ("q", "dq", "way", "temp", "warm", "load") if np.ndim(v := getattr(s, k))}
    for k in range(int(length.max(initial=0)) - 1):
        live = np.flatnonzero(length > k + 1)
        at = first[live] + k

        def rate(x: Array, at: Index) -> Array:
            now: dict[str, Any] = {name: v[at] for name, v in arrays.items()}
            here = replace(s, memory=tuple(x), **now)
            return np.stack([np.broadcast_to(r, (len(at),)) for r in effect.rates(here, shapes)])

        r1 = rate(x[:, live], at)
        r2 = rate(x[:, live] + dt * r1, at + 1)
        x[:, live] += 0.5 * dt * (r1 + r2)
        states[:, at + 1] = x[:, live]
    return tuple(states)


@njit(cache=True)
def _dahl(step: Array, start: Mask) -> Array:
    z = np.zeros(step.shape[0])
    for k in range(1, step.shape[0]):
        if not start[k]:
            way = np.sign(step[k])
            z[k] = way + (z[k - 1] - way) * np.exp(-np.abs(step[k]))
    return z
