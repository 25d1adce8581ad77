"""The check for nonlinear models, whose tube is another one along every motion.

The sets' own grid counts: for models 2 and 3 it is coarser than the samples, and inputs are means over its steps. What is predicted,
and how, stands in `stopset.monitor.predictions`.

Source: Liu & Althoff (2018), Sec. IV-C.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from stopset.artifact import Model
from stopset.monitor.inputs import Inputs
from stopset.monitor.predictions import FAR, Corners, Index, Paths
from stopset.monitor.watch import LARGEST, Conformance, Deviation, Quantum, Sample, Verdict, Watch
from stopset.types import Array


def watch_for(model: Model, quantum: Quantum, payload: float, warm: tuple[float, float], cycle_s: float) -> Watch | WatchAlong:
    """The check that belongs to the model. Raises `NotCovered` for one whose tube cannot be computed here."""
    if model.abstraction.linear:
        return Watch(model, quantum, payload, warm)
    return WatchAlong(model, quantum, payload, warm, max(1, round(model.powered.dt / cycle_s)))


@dataclass(slots=True)
class WatchAlong:
    """As `Watch`, for a nonlinear model; ``every``: samples per step of the sets' grid.

    A verdict between two steps of the grid is that of the last step. Lost samples and jitter begin anew.
    """

    model: Model
    quantum: Quantum
    payload: float = 0.0
    warm: tuple[float, float] = (0.0, 1.0)
    every: int = 1
    ages: Array = field(init=False)
    _inputs: Inputs = field(init=False)
    _predictions: Corners | Paths = field(init=False)
    _since: list[tuple[Array, Array]] = field(default_factory=list)  # u, du of the samples since the last step
    _last: Sample | None = None
    _said: Verdict | None = None
    _between: tuple[Array, Array] | None = None  # (2n,) each, what all predictions of the last step leave

    def __post_init__(self) -> None:
        sets = self.model.powered
        steps = round(sets.horizon / sets.dt)
        if not self.model.abstraction.decoupled:
            steps = min(steps, FAR)
        self.ages = np.asarray(sets.dt * np.arange(steps + 1))
        self._predictions = (Corners if self.model.abstraction.decoupled else Paths)(self.model, self.quantum, steps)
        self._inputs = Inputs.of(self.model, self.quantum, self.warm)

    @property
    def horizon(self) -> float:
        """Oldest age that is checked [s]."""
        return float(self.ages[-1])

    @property
    def inputs(self) -> tuple[Array, Array] | None:
        """``u`` and ``du`` (n,) [N m] of the sample taken last; None where it had none."""
        return self._since[-1] if self._since else None

    def tube(self, _: Sample) -> tuple[Array, Array] | None:
        """Between which states (2n,) the predictions of the last step put it; None where there were none."""
        return self._between

    def restart(self) -> None:
        """The next sample belongs to no earlier one."""
        self._predictions.forget()
        self._since.clear()
        self._last = self._said = self._between = None
        self._inputs.forget()

    def step(self, sample: Sample) -> Verdict:
        """Take the next sample; an error inside is the verdict FAULT, with its words, and no prediction survives it."""
        try:
            return self._step(sample)
        except Exception as e:  # noqa: BLE001 - whatever went wrong, the answer must say so and never read as conformant
            self.restart()
            return Verdict(Conformance.FAULT, f"the check failed: {type(e).__name__}: {e}")

    def _step(self, s: Sample) -> Verdict:
        if reason := self._no_verdict(s):
            self.restart()
            return Verdict(Conformance.UNKNOWN, reason)
        assert s.tau is not None
        before = self._last
        broken = before is not None and (s.k != before.k + 1 or s.off != 0.0)
        if broken:
            self.restart()
        self._last = s
        u, du = self._inputs(s.q, s.dq, s.tau, s.temp)
        outside = self._outside(s, u, du)
        if self._said is not None and len(self._since) < self.every:
            said = self._said
            self._since.append((u, du))
            return said if not outside and said.conformance is Conformance.CONFORMANT else self._doubtful(outside)
        verdict = self._at_step(np.concatenate([s.q, s.dq]), outside)
        self._since.append((u, du))
        if broken and before is not None:
            verdict = replace(verdict, why=f"gap: cycle {before.k} was followed by {s.k}")
        self._said = verdict
        return verdict

    def _doubtful(self, outside: tuple[str, ...]) -> Verdict:
        """Between two steps, where the last one was not good or this sample is outside."""
        why = (
            f"outside the identified domain: {', '.join(outside)}" if outside else "not compared since the last step of the model"
        )
        return Verdict(Conformance.UNKNOWN, why, outside=outside)

    def _at_step(self, x: Array, outside: tuple[str, ...]) -> Verdict:
        """A sample at a step of the grid: held against predictions of earlier steps, and kept for later ones."""
        if self._since:
            us, dus = zip(*self._since, strict=True)
            self._predictions.advance(np.mean(us, axis=0), np.max(dus, axis=0), bool(outside))
            self._since.clear()
        ages, foreign, lo, hi = self._predictions.tubes()
        verdict = self._held(x, ages, foreign, lo, hi, outside)
        self._predictions.launch(x, bool(outside), not verdict.deviations)  # what is refuted itself predicts nothing
        return verdict

    def _held(self, x: Array, ages: Index, foreign: NDArray[np.bool_], lo: Array, hi: Array, outside: tuple[str, ...]) -> Verdict:
        if not len(ages):
            return Verdict(Conformance.UNKNOWN, "first sample: nothing predicted yet", outside=outside)
        self._between = lo.max(axis=0), hi.min(axis=0)
        width = np.maximum(hi - lo, 1e-300)
        bounded = np.isfinite(width)
        room = np.where(bounded, 2.0 * np.minimum(x - lo, hi - x) / np.where(bounded, width, 1.0), 1.0).min(axis=0)
        found = []
        for above, out in ((True, (x - hi) / width), (False, (lo - x) / width)):
            # written so that what is not a number is outside
            bad = ~(x <= hi) if above else ~(x >= lo)
            for i in np.flatnonzero(bad.any(axis=0)).tolist():
                row = int(np.argmax(np.where(bad[:, i], out[:, i], -np.inf)))
                d = self._deviation(x, i, above, int(ages[row]), (float(lo[row, i]), float(hi[row, i])))
                found.append(replace(d, in_domain=not foreign[row]))
        result, why = Conformance.CONFORMANT, "inside every prediction"
        if found:
            worst = max(found, key=lambda d: d.fraction)
            result = Conformance.VIOLATION
            why = f"{worst.joint}: {worst.state} {worst.side} its prediction of {worst.age:.3f} s ago"
        elif outside:
            result, why = Conformance.UNKNOWN, f"outside the identified domain: {', '.join(outside)}"
        return Verdict(result, why, len(ages), float(self.ages[ages.max()]), tuple(found), outside, room)

    def _deviation(self, x: Array, i: int, above: bool, age: int, bounds: tuple[float, float]) -> Deviation:
        n, bound = self.model.n, bounds[above]
        excess = float(x[i]) - bound if above else bound - float(x[i])
        return Deviation(
            joint=self.model.joints[i % n], state="q" if i < n else "dq", side="above" if above else "below",
            age=float(self.ages[age]), excess=excess, fraction=excess / max(bounds[1] - bounds[0], 1e-300),
            measured=float(x[i]), bound=bound, in_domain=True,
        )  # fmt: skip

    def _no_verdict(self, s: Sample) -> str:
        if not s.powered:
            return "the drives are not in powered operation"
        if s.tau is None:
            return "no torque in the signals"
        readings = (s.q, s.dq, s.tau) if s.temp is None else (s.q, s.dq, s.tau, s.temp)
        if not all(np.all(np.abs(r) <= LARGEST) for r in readings):
            return "a reading is not a number"
        if not any(r.any() for r in readings[:3]):
            return (
                "every reading is exactly zero, torques too: no sensors tell that of an arm; look at the drives and the mapping"
            )
        lo, hi = self.model.domain.payload
        if not lo <= self.payload <= hi:
            return f"payload {self.payload} kg is outside the identified [{lo}, {hi}] kg"
        return ""

    def _outside(self, s: Sample, u: Array, du: Array) -> tuple[str, ...]:
        """Signals beyond the domain of validity, by name (trap P25); bus rounding is given the benefit."""
        d, q = self.model.domain, self.quantum
        rows = [("q", s.q, d.q, q.q), ("dq", s.dq, d.dq, q.dq), ("u", u, d.u, du + 1e-12)]
        if s.temp is not None and d.temp is not None:
            rows.append(("temp", s.temp, d.temp, np.zeros(self.model.n)))
        return tuple(
            f"{name}_{self.model.joints[j]}"
            for name, value, box, h in rows for j in np.flatnonzero((value < box.lo - h) | (value > box.hi + h))
        )  # fmt: skip
