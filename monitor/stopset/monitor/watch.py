"""The check itself: is every new measurement where some earlier measurement said it could be?

Predictions start at past measurements and advance one step per sample; each sample is held against the tube of every
prediction at its age: all horizons at once, in the compiled core. No clock, no bus, no files here.

Source: Liu & Althoff (2018), Def. 2 and eq. (17)-(21).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stopset.artifact import Model
from stopset.artifact.taped import Pinned
from stopset.core.library import check, ffi, lib, view
from stopset.errors import NotCovered
from stopset.monitor.check import ALL_ZERO, LARGEST, Check, no_number, not_checked, outside
from stopset.monitor.config import Masses
from stopset.monitor.grid import GridMotion
from stopset.monitor.inputs import Inputs
from stopset.monitor.linear_tubes import LinearTubes
from stopset.monitor.payload import unidentified_payload
from stopset.monitor.sample import Quantum, Sample
from stopset.monitor.verdict import UNKNOWN, Verdict
from stopset.types import Array


@dataclass(slots=True)
class Watch(Check):
    """Holds an arm's samples against its model; give them one by one to `step`.

    ``quantum``: rounding of the bus, by which the tube is widened (a measured set of its own); ``payload`` [kg] if declared;
    ``warm``: between which places of the session the arm is, for models with a warm-up.
    Raises `NotCovered` at once for a model whose tube cannot be computed here.
    """

    model: Model
    quantum: Quantum | None = None
    payload: Masses | None = None
    warm: tuple[float, float] = (0.0, 1.0)
    tubes: LinearTubes = field(init=False)
    _inputs: Inputs = field(init=False)
    _here: Array = field(init=False)  # (4, n) the sample: q, dq, torque, temperature
    _state: Array = field(init=False)  # (2n,) of it, q and dq
    _u: Array = field(init=False)  # (2, n) its input and that of the sample before; `_du` how far they are unknown
    _du: Array = field(init=False)
    _x: Array = field(init=False)  # (2n,) the last state, at its cycle
    _struct: Any = field(init=False)  # the core's `StopsetCheck`
    _pinned: Pinned = field(init=False)  # what it points at
    _seen: Any = field(init=False)  # of it: the oldest age in use, and how many predictions are contradicted
    _slack: Array = field(init=False)  # (2n,) what the place in time of `_x` leaves unknown of it; stands in the tube's limits
    _loose: bool = False  # something of it does
    _motion: GridMotion = field(init=False)
    _payload_why: str = ""
    _last: Sample | None = None

    def __post_init__(self) -> None:
        m, n = self.model, self.model.n
        if self.quantum is None:
            self.quantum = Quantum.none(n)
        self._inputs = Inputs.of(m, self.quantum, self.warm)
        self.tubes = LinearTubes(m, self.quantum, self._inputs.plain)
        self._motion, self._payload_why = GridMotion.of(m), unidentified_payload(m, self.payload)
        self._here, self._u, self._du = np.zeros((4, n)), np.zeros((2, n)), np.zeros((2, n))
        self._x, self._slack, self._state = np.zeros(2 * n), np.zeros(2 * n), self._here[:2].reshape(-1)
        d, pinned, tubes = m.domain, Pinned([]), self.tubes
        boxes = [d.q, d.dq, d.u, d.q if d.temp is None else d.temp]  # the last one then is not looked at
        self._struct = ffi.new("StopsetCheck *", {
            "monitor": self._inputs.struct, "predictions": tubes.struct, "domain_lo": pinned.array([b.lo for b in boxes]),
            "domain_hi": pinned.array([b.hi for b in boxes]), "temperatures": d.temp is not None, "every": tubes.stride,
            "sliding": m.powered.windows == "sliding", "most": LARGEST, "here": pinned.shared(self._here),
            "ends": pinned.shared(self._inputs.carried.ends), "u": pinned.shared(self._u), "du": pinned.shared(self._du),
            "x": pinned.shared(self._x), "start": pinned.shared(tubes.start), "widen": not self._inputs.plain,
        })  # fmt: skip
        self._pinned, self._seen = pinned, self._struct.seen

    @property
    def ages(self) -> Array:
        """[s] at which predictions are looked at."""
        return self.tubes.ages

    @property
    def horizon(self) -> float:
        """Oldest age that is checked [s]."""
        return float(self.ages[-1])

    @property
    def inputs(self) -> tuple[Array, Array] | None:
        """``u`` and ``du`` (n,) [N m] of the sample taken last, until the next one; None where it had none."""
        return (self._u[1], self._du[1]) if self._struct.known else None

    def tube(self, sample: Sample) -> tuple[Array, Array] | None:
        """Between which values (2n,) all predictions in force put the sample taken last, see `LinearTubes.between`."""
        return self.tubes.between(np.concatenate([sample.q, sample.dq]))

    def _forget(self) -> None:
        self.tubes.forget()
        s = self._struct
        s.widen, s.known, s.since, s.place = not self._inputs.plain, 0, 0, 0
        self._inputs.forget()

    def restart(self) -> None:
        """The next sample belongs to no earlier one, whatever its number says: it is of another source."""
        self._forget()
        self._last = None

    def _step(self, s: Sample) -> Verdict:
        before, self._last = self._last, s
        reason, temp = not_checked(s), s.temp is not None
        follows = before is not None and s.k == before.k + 1 and s.off == 0.0 and not self._loose
        if not reason:
            self._put(s)
            code = lib.stopset_next(self._struct, temp) if follows else lib.stopset_readable(self._struct, temp)
            reason = (self._unreadable(code, s) if code else "") or self._payload_why
            if code and not reason:
                check(code)
        if reason:
            self.restart()
            return Verdict(UNKNOWN, reason)
        return self._said(self._state, self._outside(s)) if follows else self._uneven(s, before)

    def _unreadable(self, code: int, s: Sample) -> str:
        """In words, what the core has said of a sample; empty if it can be read."""
        if code == lib.STOPSET_NOT_A_NUMBER:
            return no_number(self.model, s)
        return ALL_ZERO if code == lib.STOPSET_ALL_ZERO else ""

    def _put(self, s: Sample) -> None:
        here, n = self._here, self._here.shape[1]
        assert s.tau is not None
        if not len(s.q) == len(s.dq) == len(s.tau) == (n if s.temp is None else len(s.temp)) == n:
            raise ValueError(f"a sample of {len(s.q)} positions, {len(s.dq)} speeds, {len(s.tau)} torques for {n} joints")
        here[0], here[1], here[2] = s.q, s.dq, s.tau
        if s.temp is not None:
            here[3] = s.temp

    def _uneven(self, s: Sample, before: Sample | None) -> Verdict:
        """The first sample, one after a gap, or one that is not in the place of its cycle."""
        c, n = self._struct, self.model.n
        gap = before is not None and s.k != before.k + 1
        even = s.off == 0.0 and not self._loose
        if before is None or (gap and not (even and self._lead_across(s.k - before.k))):
            self._forget()
        check(lib.stopset_look(c, s.temp is not None))
        x, slack = self._state, np.zeros(2 * n) if self._loose else self._slack
        known, beyond = bool(c.known) and not gap, self._outside(s)
        if s.off != 0.0:
            x, slack, more = self._motion.onto_grid(s, self._u[0], self._u[int(known)])
            self._du[0] += more
        self._loosen(slack)
        c.seen[1] = 0
        if gap and before is not None:
            verdict = Verdict(UNKNOWN, f"gap: cycle {before.k} was followed by {s.k}", outside=beyond, gap=True)
        elif not known:
            verdict = Verdict(UNKNOWN, "first sample: nothing predicted yet", outside=beyond)
        else:
            check(lib.stopset_compare(c, view(x)))
            verdict = self._said(x, beyond)
        # what is refuted itself predicts nothing; nor does what cannot be placed in its cycle
        if not verdict.deviations and (known or s.off == 0.0):
            lib.stopset_launch(c)
        lib.stopset_keep(c, view(x))
        return verdict

    def _loosen(self, slack: Array) -> None:
        """The tube for a reading that may be wrong by ``slack`` (2n,) more than the model knows."""
        if slack is self._slack:
            return
        self.tubes.widen(slack - self._slack)
        self._slack, self._loose = slack, bool(slack.any())
        self._struct.widen |= self._loose

    def _lead_across(self, steps: int) -> bool:
        """Take every prediction over ``steps`` cycles whose readings were lost; False if that is not possible."""
        if not self.tubes.bridge(steps):
            return False
        self._struct.widen = True
        self._inputs.forget()
        return True

    def _outside(self, s: Sample) -> tuple[str, ...]:
        assert self.quantum is not None
        return outside(self.model, self.quantum, s, self._u[0], self._du[0]) if self._struct.outside else ()

    def _said(self, x: Array, beyond: tuple[str, ...]) -> Verdict:
        """What the comparison of the state ``x`` (2n,) has come to, with signals ``beyond`` the domain."""
        c = self._struct
        if not (live := c.live):
            return Verdict(UNKNOWN, "nothing predicted for this sample", outside=beyond)
        (oldest, passed), tubes = self._seen, self.tubes
        deviations = tubes.deviations(x) if passed else ()
        return Verdict.of_comparison(deviations, beyond, live, tubes.seconds[oldest], tubes.room.copy())


def check_cycle(model: Model, cycle_s: float) -> None:
    """Refuse a bus whose cycle is not the step of the identification (trap P18); raises `NotCovered`."""
    dt = model.powered.dt
    whole = 1 if model.abstraction.linear else max(1, round(dt / cycle_s))  # a nonlinear model's steps may be coarser
    if abs(whole * cycle_s - dt) > 1e-3 * dt:
        raise NotCovered(
            f"the bus has a cycle of {cycle_s * 1e3:g} ms, the model was identified at {dt * 1e3:g} ms; set the bus's cycle or "
            "identify from recordings taken at the bus's cycle"
        )
