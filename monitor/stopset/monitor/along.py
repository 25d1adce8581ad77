"""The check for nonlinear models, whose tube is another one along every motion.

The sets' own grid counts: for models 2 and 3 it is coarser than the samples, and inputs are means over its steps. What is predicted,
and what a sample is held against, stands in `stopset.monitor.predictions`.

Source: Liu & Althoff (2018), Sec. IV-C.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from msgspec import structs

from stopset.artifact import Model
from stopset.monitor.check import ALL_ZERO, LARGEST, Check, no_number, not_checked, outside
from stopset.monitor.config import Masses
from stopset.monitor.inputs import Inputs
from stopset.monitor.payload import unidentified_payload
from stopset.monitor.predictions import Predictions
from stopset.monitor.sample import Quantum, Sample
from stopset.monitor.verdict import Conformance, Deviation, Verdict, beyond_domain
from stopset.monitor.watch import Watch
from stopset.reach.nonlinear import FAR
from stopset.types import Array


def watch_for(
    model: Model, quantum: Quantum, payload: Masses | None, warm: tuple[float, float], cycle_s: float
) -> Watch | WatchAlong:
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
    payload: Masses | None = None
    warm: tuple[float, float] = (0.0, 1.0)
    every: int = 1
    ages: Array = field(init=False)
    _inputs: Inputs = field(init=False)
    _predictions: Predictions = field(init=False)
    _input: tuple[Array, Array] | None = None  # u, du of the sample taken last
    _last: Sample | None = None
    _said: Verdict | None = None
    _between: tuple[Array, Array] | None = None  # (2n,) each, what all predictions of the last step leave

    def __post_init__(self) -> None:
        sets = self.model.powered
        steps = round(sets.horizon / sets.dt)
        if not self.model.abstraction.decoupled:
            steps = min(steps, FAR)
        self.ages = np.asarray(sets.dt * np.arange(steps + 1))
        self._predictions = Predictions(self.model, self.quantum, steps, self.every)
        self._inputs = Inputs.of(self.model, self.quantum, self.warm)

    @property
    def horizon(self) -> float:
        """Oldest age that is checked [s]."""
        return float(self.ages[-1])

    @property
    def inputs(self) -> tuple[Array, Array] | None:
        """``u`` and ``du`` (n,) [N m] of the sample taken last; None where it had none."""
        return self._input

    def tube(self, _: Sample) -> tuple[Array, Array] | None:
        """Between which states (2n,) the predictions of the last step put it; None where there were none."""
        return self._between

    def restart(self) -> None:
        """The next sample belongs to no earlier one."""
        self._predictions.forget()
        self._last = self._said = self._between = self._input = None
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
        x = np.concatenate([s.q, s.dq])
        held = self._predictions.sample(x, u, du, outside=bool(beyond))
        self._input = u, du
        if held < 0:
            assert self._said is not None
            good = not beyond and self._said.conformance is Conformance.CONFORMANT
            return self._said if good else self._doubtful(beyond)
        verdict = self._at_step(x, held, beyond)
        if broken and before is not None:
            verdict = structs.replace(verdict, why=f"gap: cycle {before.k} was followed by {s.k}", gap=True)
        self._said = verdict
        return verdict

    def _doubtful(self, outside: tuple[str, ...]) -> Verdict:
        """Between two steps, where the last one was not good or this sample is outside."""
        why = beyond_domain(outside) if outside else "not compared since the last step of the model"
        return Verdict(Conformance.UNKNOWN, why, outside=outside)

    def _at_step(self, x: Array, live: int, outside: tuple[str, ...]) -> Verdict:
        """A sample at a step of the grid, held against ``live`` predictions."""
        if not live:
            return Verdict(Conformance.UNKNOWN, "first sample: nothing predicted yet", outside=outside)
        held = self._predictions.held
        self._between = held.lo.copy(), held.hi.copy()
        found = tuple(self._deviation(x, side, i) for side, i in np.argwhere(held.age > 0).tolist())
        return Verdict.of_comparison(found, outside, live, float(self.ages[held.oldest[0]]), held.room.copy())

    def _deviation(self, x: Array, below: int, i: int) -> Deviation:
        n, held = self.model.n, self._predictions.held
        lo, hi = held.ends[below, i].tolist()
        bound = lo if below else hi
        return Deviation(
            joint=self.model.joints[i % n], state="q" if i < n else "dq", side="below" if below else "above",
            age=float(self.ages[held.age[below, i]]), excess=bound - float(x[i]) if below else float(x[i]) - bound,
            fraction=float(held.worst[below, i]), measured=float(x[i]), bound=bound, in_domain=not held.foreign[below, i],
        )  # fmt: skip

    def _no_verdict(self, s: Sample) -> str:
        if reason := not_checked(s):
            return reason
        assert s.tau is not None
        readings = (s.q, s.dq, s.tau) if s.temp is None else (s.q, s.dq, s.tau, s.temp)
        if not all(np.all(np.abs(r) <= LARGEST) for r in readings):
            return no_number(self.model, s)
        if not any(r.any() for r in readings[:3]):
            return ALL_ZERO
        return unidentified_payload(self.model, self.payload)
