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
from stopset.monitor.check import ALL_ZERO, LARGEST, NOT_A_NUMBER, Check, not_checked, outside, unidentified_payload
from stopset.monitor.inputs import Inputs
from stopset.monitor.predictions import Corners, Paths
from stopset.monitor.sample import Quantum, Sample
from stopset.monitor.verdict import Conformance, Deviation, Verdict
from stopset.monitor.watch import Watch
from stopset.reach.nonlinear import FAR
from stopset.types import Array, Index


def watch_for(model: Model, quantum: Quantum, payload: float, warm: tuple[float, float], cycle_s: float) -> Watch | WatchAlong:
    """The check that belongs to the model. Raises `NotCovered` for one whose tube cannot be computed here."""
    if model.abstraction.linear:
        return Watch(model, quantum, payload, warm)
    return WatchAlong(model, quantum, payload, warm, max(1, round(model.powered.dt / cycle_s)))


@dataclass(slots=True)
class WatchAlong(Check):
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
        beyond = outside(self.model, self.quantum, s, u, du)
        if self._said is not None and len(self._since) < self.every:
            said = self._said
            self._since.append((u, du))
            return said if not beyond and said.conformance is Conformance.CONFORMANT else self._doubtful(beyond)
        verdict = self._at_step(np.concatenate([s.q, s.dq]), beyond)
        self._since.append((u, du))
        if broken and before is not None:
            verdict = replace(verdict, why=f"gap: cycle {before.k} was followed by {s.k}", gap=True)
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
            self._predictions.advance(np.mean(us, axis=0), np.max(dus, axis=0), foreign=bool(outside))
            self._since.clear()
        ages, foreign, lo, hi = self._predictions.tubes()
        verdict = self._held(x, ages, foreign, lo, hi, outside)
        self._predictions.launch(x, foreign=bool(outside), good=not verdict.deviations)  # what is refuted itself predicts nothing
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
                d = self._deviation(x, i, above=above, age=int(ages[row]), bounds=(float(lo[row, i]), float(hi[row, i])))
                found.append(replace(d, in_domain=not foreign[row]))
        result, why = Conformance.CONFORMANT, "inside every prediction"
        if found:
            worst = max(found, key=lambda d: d.fraction)
            result = Conformance.VIOLATION
            why = f"{worst.joint}: {worst.state} {worst.side} its prediction of {worst.age:.3f} s ago"
        elif outside:
            result, why = Conformance.UNKNOWN, f"outside the identified domain: {', '.join(outside)}"
        return Verdict(result, why, len(ages), float(self.ages[ages.max()]), tuple(found), outside, room)

    def _deviation(self, x: Array, i: int, *, above: bool, age: int, bounds: tuple[float, float]) -> Deviation:
        n, bound = self.model.n, bounds[above]
        excess = float(x[i]) - bound if above else bound - float(x[i])
        return Deviation(
            joint=self.model.joints[i % n], state="q" if i < n else "dq", side="above" if above else "below",
            age=float(self.ages[age]), excess=excess, fraction=excess / max(bounds[1] - bounds[0], 1e-300),
            measured=float(x[i]), bound=bound, in_domain=True,
        )  # fmt: skip

    def _no_verdict(self, s: Sample) -> str:
        if reason := not_checked(s):
            return reason
        assert s.tau is not None
        readings = (s.q, s.dq, s.tau) if s.temp is None else (s.q, s.dq, s.tau, s.temp)
        if not all(np.all(np.abs(r) <= LARGEST) for r in readings):
            return NOT_A_NUMBER
        if not any(r.any() for r in readings[:3]):
            return ALL_ZERO
        return unidentified_payload(self.model, self.payload)
