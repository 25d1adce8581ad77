"""The check for nonlinear models: their tube is another one along every motion, so it is computed anew, from some ages.

The same function as in identification and comparison gives it (trap P18), on the sets' own grid: for models 2 and 3 that is coarser
than the samples, and inputs are means over its steps. A friction curve on decoupled joints takes two simulations per prediction and
joint; models 2 and 3 a linearisation along the nominal motion, whose cost grows with the square of the age, so of the old ones
one is looked at per step, in turn.

Source: Liu & Althoff (2018), Sec. IV-C.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from stopset.artifact import Model, UncertaintySets
from stopset.monitor.inputs import Inputs
from stopset.monitor.watch import LARGEST, Conformance, Deviation, Quantum, Sample, Verdict, Watch
from stopset.reach.nonlinear import predicted_tube
from stopset.sets import Box
from stopset.types import Array

OLD = 24  # steps from which a linearised prediction is dear


def watch_for(model: Model, quantum: Quantum, payload: float, warm: tuple[float, float], cycle_s: float) -> Watch | WatchAlong:
    """The check that belongs to the model. Raises `NotCovered` for one whose tube cannot be computed here."""
    if model.abstraction.linear:
        return Watch(model, quantum, payload, warm)
    return WatchAlong(model, quantum, payload, warm, max(1, round(model.powered.dt / cycle_s)))


def ages_of(steps: int) -> list[int]:
    """1, 2, 3, 4, 6, 8, 12, ... up to ``steps``: near ones closely, far ones seldom."""
    out = {min(steps, a << k) for k in range(steps.bit_length()) for a in (1, 3)} | {2}
    return sorted(a for a in out if a <= steps)


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
    _steps: list[int] = field(init=False)
    _inputs: Inputs = field(init=False)
    _x: list[Array] = field(default_factory=list)  # states at the grid's steps, newest last
    _means: list[tuple[Array, Array]] = field(default_factory=list)  # u, du from each to the next
    _good: list[bool] = field(default_factory=list)  # whether a prediction may start there
    _foreign: list[bool] = field(default_factory=list)  # outside the domain there
    _since: list[tuple[Array, Array]] = field(default_factory=list)  # u, du of the samples since the last step
    _last: Sample | None = None
    _said: Verdict | None = None
    _turn: int = 0

    def __post_init__(self) -> None:
        sets = self.model.powered
        steps = round(sets.horizon / sets.dt)
        self._steps, self.ages = ages_of(steps), np.asarray(sets.dt * np.arange(steps + 1))
        self._inputs = Inputs.of(self.model, self.quantum, self.warm)

    @property
    def horizon(self) -> float:
        """Oldest age that is checked [s]."""
        return float(self.ages[-1])

    @property
    def inputs(self) -> tuple[Array, Array] | None:
        """``u`` and ``du`` (n,) [N m] of the sample taken last; None where it had none."""
        return self._since[-1] if self._since else None

    def restart(self) -> None:
        """The next sample belongs to no earlier one."""
        for kept in (self._x, self._means, self._good, self._foreign, self._since):
            kept.clear()
        self._last = self._said = None
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
        if self._x and len(self._since) < self.every:
            said = self._said or Verdict(Conformance.UNKNOWN, "first sample: nothing predicted yet")
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
        """A sample at a step of the grid: held against predictions of some earlier steps, and kept for later ones."""
        if self._since:
            us, dus = zip(*self._since, strict=True)
            self._means.append((np.mean(us, axis=0), np.max(dus, axis=0)))
            self._since.clear()
        found: dict[tuple[int, int], Deviation] = {}
        room, oldest, compared = np.full(2 * self.model.n, np.inf), 0, 0
        for age in self._due():
            lo, hi = self._tube(age)
            width = np.maximum(hi - lo, 1e-300)
            room = np.minimum(room, np.where(np.isfinite(width), 2.0 * np.minimum(x - lo, hi - x) / width, np.inf))
            oldest, compared = max(oldest, age), compared + 1
            for i in np.flatnonzero(~((x >= lo) & (x <= hi))).tolist():
                d = self._deviation(x, i, age, lo, hi)
                key = (i, int(d.side == "above"))
                if key not in found or d.fraction > found[key].fraction:
                    found[key] = d
        self._keep(x, bool(outside), not found)
        if not compared:
            return Verdict(Conformance.UNKNOWN, "first sample: nothing predicted yet", outside=outside)
        result, why = Conformance.CONFORMANT, "inside every prediction"
        if found:
            worst = max(found.values(), key=lambda d: d.fraction)
            result = Conformance.VIOLATION
            why = f"{worst.joint}: {worst.state} {worst.side} its prediction of {worst.age:.3f} s ago"
        elif outside:
            result, why = Conformance.UNKNOWN, f"outside the identified domain: {', '.join(outside)}"
        room = np.where(np.isfinite(room), room, 1.0)
        return Verdict(result, why, compared, float(self.ages[oldest]), tuple(found.values()), outside, room)

    def _due(self) -> list[int]:
        """Ages, in steps, that are looked at now."""
        passed, sets = len(self._means), self.model.powered
        if sets.windows != "sliding":  # predicted from the start only
            return [passed] if 0 < passed < len(self.ages) and self._good[0] else []
        due = [a for a in self._steps if a <= passed and self._good[-a]]
        if self.model.abstraction.decoupled:
            return due
        old = [a for a in due if a > OLD]
        self._turn += 1
        return [a for a in due if a <= OLD] + ([old[self._turn % len(old)]] if old else [])

    def _tube(self, age: int) -> tuple[Array, Array]:
        """(2n,) where a reading may be now, by the prediction of ``age`` steps ago."""
        u = np.array([m[0] for m in self._means[-age:]])
        du = np.max([m[1] for m in self._means[-age:]], axis=0)
        lo, hi = predicted_tube(self.model.abstraction, self._widened(du), self._x[-age], u)
        return lo[-1], hi[-1]

    def _widened(self, du: Array) -> UncertaintySets:
        """The sets with what the bus rounds and what is not known of the input."""
        sets, here = self.model.powered, Box.symmetric(np.concatenate([self.quantum.q, self.quantum.dq]))
        return replace(sets, X0=sets.X0 + here, V=sets.V + here, U=sets.U + Box.symmetric(du))

    def _keep(self, x: Array, foreign: bool, good: bool) -> None:
        self._x.append(x)
        self._good.append(good)
        self._foreign.append(foreign)
        if len(self._x) > len(self.ages):
            del self._x[0], self._means[0], self._good[0], self._foreign[0]
            if self.model.powered.windows != "sliding":
                self._good[0] = False  # the start has gone, and only it predicts

    def _deviation(self, x: Array, i: int, age: int, lo: Array, hi: Array) -> Deviation:
        n, above = self.model.n, bool(x[i] > hi[i])
        excess = float(x[i] - hi[i] if above else lo[i] - x[i])
        return Deviation(
            joint=self.model.joints[i % n], state="q" if i < n else "dq", side="above" if above else "below",
            age=float(self.ages[age]), excess=excess, fraction=excess / max(float(hi[i] - lo[i]), 1e-300), measured=float(x[i]),
            bound=float(hi[i] if above else lo[i]), in_domain=not any(self._foreign[-age:]),
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
