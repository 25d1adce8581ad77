"""What every check of samples against a model has in common: its error path, and what it refuses to look at."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from stopset.artifact import Model
from stopset.monitor.sample import Quantum, Sample
from stopset.monitor.verdict import Conformance, Verdict
from stopset.types import Array

LARGEST = 1e6  # of any reading [SI]; beyond it arithmetic would end in what is not a number
ALL_ZERO = "every reading is exactly zero, torques too: no sensors tell that of an arm; look at the drives and the mapping"


class Check(ABC):
    """Holds an arm's samples against a model; give them one by one to `step`."""

    __slots__ = ()

    def step(self, sample: Sample) -> Verdict:
        """Take the next sample; an error inside is the verdict FAULT, with its words, and no prediction survives it."""
        try:
            return self._step(sample)
        except Exception as e:  # noqa: BLE001 - whatever went wrong, the answer must say so and never read as conformant
            self.restart()
            return Verdict(Conformance.FAULT, f"the check failed: {type(e).__name__}: {e}")

    @abstractmethod
    def _step(self, s: Sample) -> Verdict: ...

    @abstractmethod
    def restart(self) -> None:
        """The next sample belongs to no earlier one, whatever its number says: it is of another source."""


def not_checked(s: Sample) -> str:
    """Why no verdict is possible on a sample, before its numbers are looked at; empty if one is."""
    if not s.powered:
        return "the drives are not in powered operation"
    return "no torque in the signals" if s.tau is None else ""


def no_number(model: Model, s: Sample) -> str:
    """Which readings cannot be computed with."""
    rows = (("q", s.q), ("dq", s.dq), ("tau", s.tau), ("temp", s.temp))
    which = [
        f"{name}_{model.joints[j]}"
        for name, row in rows if row is not None for j in np.flatnonzero(~(np.abs(row) <= LARGEST))
    ]  # fmt: skip
    return f"a reading is not a number, or beyond {LARGEST:g}: {', '.join(which)}; look at the sensor and its mapping"


def outside(model: Model, quantum: Quantum, s: Sample, u: Array, du: Array) -> tuple[str, ...]:
    """Signals beyond the domain of validity, by name (trap P25); bus rounding is given the benefit."""
    d, q = model.domain, quantum
    rows = [("q", s.q, d.q, q.q), ("dq", s.dq, d.dq, q.dq), ("u", u, d.u, du + 1e-12)]
    if s.temp is not None and d.temp is not None:
        rows.append(("temp", s.temp, d.temp, np.zeros(model.n)))
    return tuple(
        f"{name}_{model.joints[j]}"
        for name, value, box, h in rows for j in np.flatnonzero((value < box.lo - h) | (value > box.hi + h))
    )  # fmt: skip
