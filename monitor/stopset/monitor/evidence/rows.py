"""Rows of a trace as messages: joint states, the tube they were held against, the verdict with its margins."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from stopset.monitor.evidence.dynamics import Dynamics, Readings
from stopset.monitor.evidence.mcap_file import stamp
from stopset.monitor.evidence.trace import Window
from stopset.monitor.layout import State
from stopset.types import Array

VERDICTS = ("UNKNOWN", "CONFORMANT", "VIOLATION", "FAULT")  # by code, as in the state message


def nanoseconds(t: float) -> int:
    """Of a stamp [s]; 0 for what is none."""
    return round(t * 1e9) if 0.0 <= t < 1.8e10 else 0


def _listed(x: Array) -> list[float | None]:
    return [v if np.isfinite(v) else None for v in x.tolist()]


def messages(w: Window, lo: int, model: Dynamics | None, joints: tuple[str, ...], age: int) -> Iterator[tuple[str, int, Any]]:
    """Topic, time and content of the rows from ``lo`` on; the rows before only serve predictions of ``age`` cycles."""
    n, tubes = len(joints), {} if model is None else tube(w, model, age)
    names = {s.value: s.name for s in State}
    for i in range(lo, len(w)):
        t = nanoseconds(float(w.t[i]))
        at = stamp(t)
        reading: dict[str, Any] = {
            "timestamp": at, "k": int(w.k[i]), "name": joints, "position": _listed(w.q[i]), "velocity": _listed(w.dq[i]),
            "effort": _listed(w.tau[i]), "input": _listed(w.u[i]),
        }  # fmt: skip
        if np.isfinite(w.temp[i]).any():
            reading["temperature"] = _listed(w.temp[i])
        yield "joint_states", t, reading
        if i in tubes:
            low, high = tubes[i]
            assert model is not None
            yield "tube", t, {
                "timestamp": at, "age_s": age * model.dt, "q_lo": _listed(low[:n]), "q_hi": _listed(high[:n]),
                "dq_lo": _listed(low[n:]), "dq_hi": _listed(high[n:]),
            }  # fmt: skip
        verdict: dict[str, Any] = {
            "timestamp": at, "conformance": VERDICTS[w.conformance[i]], "state": names.get(int(w.state[i]), "NEVER_SENT"),
        }  # fmt: skip
        if np.isfinite(w.room[i]).any():
            verdict |= {"room_q": _listed(w.room[i, :n]), "room_dq": _listed(w.room[i, n:])}
        yield "verdict", t, verdict


def tube(w: Window, model: Dynamics, age: int) -> dict[int, tuple[Array, Array]]:
    """By row: where the prediction of ``age`` cycles before says that it may be. Rows with a gap on the way have none."""
    N = len(w) - age
    if not 0 < age < len(model.lo) or N < 1:
        return {}
    r = Readings.of(w)
    whole = (w.k[age:] - w.k[:N]) == age
    predicted = r.x[:N]
    push = r.u @ model.Bd.T
    for j in range(age):
        predicted = predicted @ model.Ad.T + push[j : j + N]
    whole &= np.isfinite(predicted).all(axis=1)
    low, high = predicted + model.lo[age], predicted + model.hi[age]
    return {i + age: (low[i], high[i]) for i in np.flatnonzero(whole).tolist()}
