"""The check itself: is every new measurement where some earlier measurement said it could be?

Predictions start at past measurements and advance one step per sample; each sample is held against the tube of every
prediction at its age: all horizons at once are one matrix product and one comparison. No clock, no bus, no files here.

Source: Liu & Althoff (2018), Def. 2 and eq. (17)-(21), with the tube of `stopset.reach.flowpipe` (same as the identification).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stopset.artifact import Model
from stopset.artifact.taped import Kept
from stopset.core.library import ffi, lib, view
from stopset.errors import NotCovered
from stopset.monitor.grid import Motion
from stopset.monitor.inputs import Inputs
from stopset.reach.flowpipe import deviation_tube, discretise
from stopset.types import Array

MAX_PREDICTIONS = 1500  # rows of the comparison; longer horizons start fewer predictions
BRIDGE = 5  # cycles from one sample to the next that predictions are led across; after more they start anew
LARGEST = 1e6  # of any reading [SI]; beyond it arithmetic would end in what is not a number


class Conformance(StrEnum):
    """What one sample says of the model."""

    CONFORMANT = "CONFORMANT"
    VIOLATION = "VIOLATION"
    UNKNOWN = "UNKNOWN"
    FAULT = "FAULT"


@dataclass(frozen=True, slots=True)
class Sample:
    """One reading of the arm: ``q, dq`` (n,) [rad, rad/s], ``tau`` (n,) [N m] or None, ``temp`` (n,) [degC] or None.

    ``k``: cycle number; two samples belong together when their numbers differ by one, anything else is a gap.
    ``t``: sampling instant [s], ``off``: how far behind the place of its cycle that stamp lies [s]; ``powered``: the drives
    hold torque (else no verdict: another regime); ``doubt``: what the drives themselves say against it, empty if nothing,
    and ``bad_nodes``: bit i set = joint i's.
    """

    k: int
    t: float
    q: Array
    dq: Array
    tau: Array | None = None
    temp: Array | None = None
    powered: bool = True
    doubt: str = ""
    bad_nodes: int = 0
    off: float = 0.0


@dataclass(frozen=True, slots=True)
class Quantum:
    """Greatest error the bus itself adds to ``q, dq, tau`` (n,): half a count [rad, rad/s, N m]; zero where it adds none."""

    q: Array
    dq: Array
    tau: Array

    @classmethod
    def none(cls, n: int) -> Quantum:
        return cls(np.zeros(n), np.zeros(n), np.zeros(n))


@dataclass(frozen=True, slots=True)
class Deviation:
    """One measurement outside its prediction: ``excess`` beyond the bound [rad or rad/s], also as a part of the tube's width.

    ``age``: of the prediction that is contradicted worst [s]; ``in_domain``: whether the model ever claimed to hold here.
    """

    joint: str
    state: str  # "q" or "dq"
    side: str  # "above" or "below"
    age: float
    excess: float
    fraction: float
    measured: float
    bound: float
    in_domain: bool


@dataclass(frozen=True, slots=True)
class Verdict:
    """What one sample says. ``compared``: predictions it was held against; ``room``: (2n,) distance to the nearest bound
    over the tube's half width (1 centre, 0 on the bound, negative outside); ``outside``: signals beyond the domain."""

    conformance: Conformance
    why: str
    compared: int = 0
    oldest: float = 0.0
    deviations: tuple[Deviation, ...] = ()
    outside: tuple[str, ...] = ()
    room: Array | None = None


@dataclass(slots=True)
class Watch:
    """Holds an arm's samples against its model; give them one by one to `step`.

    ``quantum``: rounding of the bus, by which the tube is widened (a measured set of its own); ``payload`` [kg] declared;
    ``warm``: between which places of the session the arm is, for models with a warm-up.
    Raises `NotCovered` at once for a model whose tube cannot be computed here.
    """

    model: Model
    quantum: Quantum | None = None
    payload: float = 0.0
    warm: tuple[float, float] = (0.0, 1.0)
    stride: int = field(init=False)
    ages: Array = field(init=False)
    _inputs: Inputs = field(init=False)
    _Ad: Array = field(init=False)
    _Bd: Array = field(init=False)
    _lo: Array = field(init=False)
    _hi: Array = field(init=False)
    _e: Array = field(init=False)  # (m, 2n) measured minus predicted, one row per prediction, newest overwrites oldest
    _w: Array = field(init=False)  # (m, 2n) what bus rounding can have added to that along the way
    _age: NDArray[np.int64] = field(init=False)  # (m,) in steps, -1 where no prediction is
    _foreign: NDArray[np.bool_] = field(init=False)  # the prediction passed samples outside the domain
    _room: Array = field(init=False)
    _row: NDArray[np.int64] = field(init=False)
    _none: Array = field(init=False)  # (n,) zeros
    _widen: bool = False  # the widths ``_w`` change from step to step
    _predictions: Any = field(init=False)  # the C struct of the above
    _held: Any = field(init=False)  # what it points at
    _seen: Any = field(init=False)  # (2,) of the comparison: greatest age in steps, bounds passed
    _limits: Array = field(init=False)  # (4, 4n): signals, domain lo and hi, rounding, of q, dq, u (or torque), temperature
    _rows: Any = field(init=False)  # where these lie, for the core
    _next: int = 0
    _last: Sample | None = None
    _u: tuple[Array, Array] | None = None
    _x: Array = field(init=False)  # (2n,) the last state, at its cycle
    _slack: Array = field(init=False)  # (2n,) what its place in time leaves unknown of it; stands in the tube's limits
    _loose: bool = False  # something of it does
    _motion: Motion = field(init=False)
    _since: int = 0

    def __post_init__(self) -> None:
        m, sets = self.model, self.model.powered
        n = m.n
        self._x, self._slack, self._motion = np.zeros(2 * n), np.zeros(2 * n), Motion.of(m)
        if self.quantum is None:
            self.quantum = Quantum.none(n)
        self._inputs = Inputs.of(m, self.quantum, self.warm)
        self._Ad, self._Bd = discretise(m.abstraction, sets.dt)
        tube = deviation_tube(m.abstraction, sets)
        self.ages = tube.ages
        # H products of 2n + n terms each round by 2^-53 relative to states within a few turns
        rounding = len(tube.ages) * 3 * n * 2.0**-53 * 32.0
        here = np.concatenate([self.quantum.q, self.quantum.dq])
        self._lo, self._hi = tube.lo - here - rounding, tube.hi + here + rounding
        steps = len(tube.ages) - 1
        if self._inputs.plain:  # what rounding adds along the way then depends on the age alone
            added = here
            for k in range(steps + 1):
                self._lo[k] -= added
                self._hi[k] += added
                added = np.abs(self._Ad) @ added + np.abs(self._Bd) @ self.quantum.tau
        self.stride = max(1, -(-steps // MAX_PREDICTIONS))
        rows = steps // self.stride + 1
        self._e, self._w = np.zeros((rows, 2 * n)), np.zeros((rows, 2 * n))
        self._age, self._foreign = np.full(rows, -1), np.zeros(rows, bool)
        self._none = np.zeros(n)
        self._room, self._row = np.empty(2 * n), np.empty((2, 2 * n), np.int64)
        self._widen = not self._inputs.plain
        kept = Kept([])
        self._predictions = ffi.new("StopsetPredictions *", (
            2 * n, rows, len(tube.ages), view(self._e), view(self._w), kept.shared(self._age),
            kept.shared(self._foreign), kept.array(self._Ad), kept.array(self._Bd), view(self._lo),
            view(self._hi), view(self._room), kept.shared(self._row),
        ))  # fmt: skip
        d = m.domain
        boxes, h = [d.q, d.dq, d.u, *([] if d.temp is None else [d.temp])], [self.quantum.q, self.quantum.dq]
        self._limits = np.zeros((4, 4 * n))
        for row, end in ((1, "lo"), (2, "hi")):
            self._limits[row, : n * len(boxes)] = np.concatenate([getattr(b, end) for b in boxes])
        self._limits[3, : 2 * n] = np.concatenate(h)
        self._rows = [view(x) for x in self._limits]
        self._held, self._seen = kept, ffi.new("int64_t[2]")
        self._forget()

    @property
    def horizon(self) -> float:
        """Oldest age that is checked [s]."""
        return float(self.ages[-1])

    @property
    def inputs(self) -> tuple[Array, Array] | None:
        """``u`` and ``du`` (n,) [N m] of the sample taken last; None where it had none."""
        return self._u

    def _forget(self) -> None:
        self._age[:] = -1
        self._widen = not self._inputs.plain
        self._u = None
        self._since = self._next = 0
        self._inputs.forget()

    def restart(self) -> None:
        """The next sample belongs to no earlier one, whatever its number says: it is of another source."""
        self._forget()
        self._last = None

    def step(self, sample: Sample) -> Verdict:
        """Take the next sample; an error inside is the verdict FAULT, with its words, and no prediction survives it."""
        try:
            return self._step(sample)
        except Exception as e:  # noqa: BLE001 - whatever went wrong, the answer must say so and never read as conformant
            self.restart()
            return Verdict(Conformance.FAULT, f"the check failed: {type(e).__name__}: {e}")

    def _step(self, s: Sample) -> Verdict:
        x = np.concatenate([s.q, s.dq])
        reason = self._no_verdict(s, x)
        gap = self._last is not None and s.k != self._last.k + 1
        before, self._last = self._last, s
        even = s.off == 0.0 and not self._loose
        led = gap and even and not reason and self._lead_across(s.k - before.k)  # type: ignore[union-attr]
        if reason or before is None or (gap and not led):
            self._forget()
        if reason:
            self._last = None
            return Verdict(Conformance.UNKNOWN, reason)
        assert s.tau is not None
        u, du = self._inputs(s.q, s.dq, s.tau, s.temp)
        outside = self._outside(s, u, du)
        known = self._u is not None and not gap
        slack = np.zeros_like(x) if self._loose else self._slack
        if s.off != 0.0:
            x, slack, more = self._motion.onto_grid(s.q, s.dq, u, self._u[0] if known else u, s.off)  # type: ignore[index]
            du = du + more
        self._loosen(slack)
        if gap and before is not None:
            verdict = Verdict(Conformance.UNKNOWN, f"gap: cycle {before.k} was followed by {s.k}", outside=outside)
        else:
            verdict = self._compare(x, before, outside)
        # what is refuted itself predicts nothing: one bad sample counts once; nor does what cannot be placed in its cycle
        if not verdict.deviations and (known or s.off == 0.0):
            self._launch(bool(outside))
        self._u, self._x = (u, du), x
        return verdict

    def _loosen(self, slack: Array) -> None:
        """The tube for a reading that may be wrong by ``slack`` (2n,) more than the model knows."""
        if slack is self._slack:
            return
        change = slack - self._slack
        self._lo -= change
        self._hi += change
        self._slack, self._loose = slack, bool(slack.any())
        self._widen |= self._loose

    def _lead_across(self, steps: int) -> bool:
        """Take every prediction over ``steps`` cycles whose readings were lost; False if that is not possible.

        Whatever torque acted then, it took the arm from the reading before to the reading after, both true to within ``X0``
        and the reading's noise. So what a prediction has gathered before goes on, as if the disturbance had been in the middle
        of ``U`` meanwhile, and it is wider by what both readings may be wrong by: nothing that was seen before is forgotten.
        """
        sets = self.model.powered
        if not 1 < steps <= BRIDGE or sets.conform != "all" or sets.windows != "sliding":
            return False
        power, shift = np.eye(len(self._Ad)), np.zeros(len(self._Ad))
        middle = sets.U.centre if sets.zonotope is None else sets.zonotope.centre
        for _ in range(steps):
            shift = self._Ad @ shift + self._Bd @ middle
            power = self._Ad @ power
        q = self.quantum
        assert q is not None
        ends = (sets.X0.lo, sets.X0.hi, sets.V.lo, sets.V.hi)
        wrong = np.max(np.abs(ends), axis=0) + np.concatenate([q.q, q.dq])
        alive = self._age >= 0
        self._age[alive] += steps
        self._age[self._age >= len(self.ages)] = -1
        self._e[alive] = self._e[alive] @ power.T + shift
        self._w[alive] = (self._w[alive] + wrong) @ np.abs(power).T + wrong
        self._widen = True
        self._inputs.forget()
        return True

    def _no_verdict(self, s: Sample, x: Array) -> str:
        if not s.powered:
            return "the drives are not in powered operation"
        if s.tau is None:
            return "no torque in the signals"
        here, n = self._limits[0], self.model.n
        signals = 3 * n
        here[: 2 * n], here[2 * n : 3 * n] = x, s.tau
        if s.temp is not None:
            here[3 * n :], signals = s.temp, 4 * n
        if not lib.stopset_sound(signals, self._rows[0], LARGEST):
            return "a reading is not a number"
        if x[0] == 0.0 and not x.any() and not s.tau.any():
            return (
                "every reading is exactly zero, torques too: no sensors tell that of an arm; look at the drives and the mapping"
            )
        lo, hi = self.model.domain.payload
        if not lo <= self.payload <= hi:
            return f"payload {self.payload} kg is outside the identified [{lo}, {hi}] kg"
        return ""

    def _outside(self, s: Sample, u: Array, du: Array) -> tuple[str, ...]:
        """Signals beyond the domain of validity, by name (trap P25); bus rounding is given the benefit."""
        d, q, n = self.model.domain, self.quantum, self.model.n
        assert q is not None
        # positions, speeds and temperatures stand there since they were looked at as numbers
        self._limits[0, 2 * n : 3 * n] = u
        np.add(du, 1e-12, out=self._limits[3, 2 * n : 3 * n])
        if not lib.stopset_beyond((4 if s.temp is not None and d.temp is not None else 3) * n, *self._rows):
            return ()
        rows = [("q", s.q, d.q, q.q), ("dq", s.dq, d.dq, q.dq), ("u", u, d.u, du + 1e-12)]
        if s.temp is not None and d.temp is not None:
            rows.append(("temp", s.temp, d.temp, np.zeros(self.model.n)))
        out: list[str] = []
        for name, value, box, h in rows:
            bad = (value < box.lo - h) | (value > box.hi + h)
            out += [f"{name}_{self.model.joints[j]}" for j in np.flatnonzero(bad)]
        return tuple(out)

    def _compare(self, x: Array, before: Sample | None, outside: tuple[str, ...]) -> Verdict:
        if self._u is None or before is None:
            return Verdict(Conformance.UNKNOWN, "first sample: nothing predicted yet", outside=outside)
        u, du = self._u
        n2, quantum = len(x), self.quantum
        assert quantum is not None
        # what rounding of the torque adds stands in the tube's limits already where inputs are plain
        added = du - quantum.tau if self._inputs.plain and self._widen else self._none if self._inputs.plain else du
        live = lib.stopset_advance(
            self._predictions, view(x), view(self._x), view(u), view(added), bool(outside),
            self._widen, self._seen,
        )  # fmt: skip
        oldest, passed = self._seen
        if not live:
            return Verdict(Conformance.UNKNOWN, "nothing predicted for this sample", outside=outside)
        found = [(side, i) for side in (0, 1) for i in range(n2) if self._row[side, i] >= 0] if passed else []
        deviations = tuple(self._deviation(x, i, side) for side, i in found)
        room = np.where(np.isfinite(self._room), self._room, 1.0)
        result, why = Conformance.CONFORMANT, "inside every prediction"
        if deviations:
            worst = max(deviations, key=lambda d: d.fraction)
            result = Conformance.VIOLATION
            why = f"{worst.joint}: {worst.state} {worst.side} its prediction of {worst.age:.3f} s ago"
        elif outside:
            result, why = Conformance.UNKNOWN, f"outside the identified domain: {', '.join(outside)}"
        return Verdict(result, why, live, float(self.ages[oldest]), deviations, outside, room)

    def tube(self, sample: Sample) -> tuple[Array, Array] | None:
        """Between which values (2n,) all predictions in force put the sample last taken; None where nothing is predicted.

        Where they contradict each other the lower end is above the upper one.
        """
        rows = np.flatnonzero(self._age > 0)
        if not len(rows):
            return None
        age = self._age[rows]
        nominal = np.concatenate([sample.q, sample.dq]) - self._e[rows]
        lo, hi = nominal + self._lo[age] - self._w[rows], nominal + self._hi[age] + self._w[rows]
        return lo.max(axis=0), hi.min(axis=0)

    def _deviation(self, x: Array, i: int, side: int) -> Deviation:
        """State ``i`` against the prediction that it contradicts worst, above (0) or below (1)."""
        n, row = self.model.n, int(self._row[side, i])
        age = int(self._age[row])
        lo, hi = self._lo[age, i] - self._w[row, i], self._hi[age, i] + self._w[row, i]
        excess = float(self._e[row, i] - hi if side == 0 else lo - self._e[row, i])
        return Deviation(
            joint=self.model.joints[i % n],
            state="q" if i < n else "dq",
            side="above" if side == 0 else "below",
            age=float(self.ages[age]),
            excess=excess,
            fraction=excess / max(float(hi - lo), 1e-300),
            measured=float(x[i]),
            bound=float(x[i]) - excess if side == 0 else float(x[i]) + excess,
            in_domain=not bool(self._foreign[row]),
        )

    def _launch(self, foreign: bool) -> None:
        """Start a prediction at this sample: every ``stride`` samples, or (sets conform from the start only) after a gap."""
        first = self._u is None
        self._since += 1
        if not first and (self._since < self.stride or self.model.powered.windows != "sliding"):
            return
        self._since = 0
        q = self.quantum
        assert q is not None
        row, self._next = self._next, (self._next + 1) % len(self._age)
        self._e[row] = 0.0
        self._w[row] = self._slack if self._inputs.plain else np.concatenate([q.q, q.dq]) + self._slack
        self._age[row] = 0
        self._foreign[row] = foreign


def check_cycle(model: Model, cycle_s: float) -> None:
    """Refuse a bus whose cycle is not the step of the identification (trap P18); raises `NotCovered`."""
    dt = model.powered.dt
    whole = 1 if model.abstraction.linear else max(1, round(dt / cycle_s))  # a nonlinear model's steps may be coarser
    if abs(whole * cycle_s - dt) > 1e-3 * dt:
        raise NotCovered(
            f"the bus has a cycle of {cycle_s * 1e3:g} ms, the model was identified at {dt * 1e3:g} ms; set the bus's cycle or "
            "identify from recordings taken at the bus's cycle"
        )
