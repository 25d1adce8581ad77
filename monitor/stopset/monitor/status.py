"""From verdict, bus and bounds to the one state byte; the worst of what is known wins, and nothing known is not OK."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np

from stopset.monitor.certificates import Numbers
from stopset.monitor.layout import Flag, State
from stopset.monitor.sample import Sample
from stopset.monitor.verdict import CONFORMANT, FAULT, UNKNOWN, Verdict

# whole numbers: combining flags in a loop of microseconds costs tens of them
_LATCHED, _OUTSIDE, _GAP, _STALE, _NO_STOP, _LATE, _NOT_POWERED, _NO_TORQUE, _NOT_FRESH, _NODE, _YOUNG, _RECOVERING, _END_STOP = (
    int(f)
    for f in (
        Flag.VIOLATION_LATCHED, Flag.OUT_OF_DOMAIN, Flag.BUS_GAP, Flag.BUS_STALE, Flag.NO_STOP_PROVABLE, Flag.DEADLINE_MISS,
        Flag.DRIVES_NOT_POWERED, Flag.NO_TORQUE, Flag.STOP_NOT_FRESH, Flag.NODE_NOT_GOOD, Flag.EVIDENCE_YOUNG, Flag.RECOVERING,
        Flag.END_STOP,
    )
)  # fmt: skip
_DOUBTFUL = _OUTSIDE | _STALE | _NODE
_OK, _DEGRADED, _UNKNOWN = (
    State.OK,
    State.DEGRADED,
    State.UNKNOWN,
)  # Python 3.11 calls a function for every look into an enumeration
SLEWED = 1e-3  # [s] from one turn to the next: more was set, not brought nearer


@dataclass(frozen=True, slots=True)
class OkConditions:
    """``valid_for``: oldest data [s] that OK is said for; ``ahead``: how far [s] a stamp may lie in the future;
    ``evidence``: OK needs a prediction at least this old [s]; ``recover``: and unbroken good cycles for this long [s]."""

    valid_for: float
    ahead: float
    evidence: float
    recover: float


class Situation(msgspec.Struct):  # as `stopset.monitor.sample.Sample`
    """Everything the state depends on, in one place. ``fault``: words of an error, empty if none; ``age``: of the last
    sample by its stamp, ``since``: since it arrived, both [s] at this moment; ``latched``: why, empty if not."""

    started: bool
    fault: str
    stale: bool
    late: bool
    latched: str
    age: float
    since: float
    sample: Sample | None
    verdict: Verdict | None
    fresh: bool
    numbers: dict[str, Numbers]
    pace: str = ""


def flags_of(s: Situation) -> int:
    """What is seen, whatever follows from it: bits of `Flag`."""
    v, x, bits = s.verdict, s.sample, 0 if s.numbers else _NO_STOP
    if s.latched:
        bits |= _LATCHED
    if s.stale:
        bits |= _STALE
    if s.late:
        bits |= _LATE
    if not s.fresh:
        bits |= _NOT_FRESH
    for n in s.numbers.values():
        if not n.proven:
            bits |= _NO_STOP
        elif n.end_stops:
            bits |= _END_STOP
    if v is not None:
        if v.outside:
            bits |= _OUTSIDE
        if v.gap and v.conformance is UNKNOWN:
            bits |= _GAP
    if x is not None:
        if not x.powered:
            bits |= _NOT_POWERED
        if x.tau is None:
            bits |= _NO_TORQUE
        if x.fault:
            bits |= _NODE
    return bits


def decide(s: Situation, limits: OkConditions) -> tuple[State, int, str]:
    """State, flags and one sentence. Order: own fault, latched violation, no signal, old data, drives, another cycle, no
    verdict, little evidence, no bound, OK."""
    flags, v = flags_of(s), s.verdict
    failed = s.fault or (v.why if v is not None and v.conformance is FAULT else "")
    if failed:
        return State.FAULT, flags, failed
    if s.latched:
        return State.VIOLATION, flags, f"{s.latched}; reset with a name and a reason"
    if s.stale:
        return (State.FAULT, flags, "no signal from the arm") if s.started else (State.INIT, flags, "waiting for the arm")
    if s.late:
        why = f"samples are {s.age * 1e3:.0f} ms old when they are looked at, their numbers valid for {limits.valid_for * 1e3:.0f} ms: "
        return State.FAULT, flags, why + "the monitor has too little of its machine, or the clock that stamps them lags"
    if v is None or s.sample is None:
        return State.INIT, flags, "waiting for the arm"
    old = max(s.age, s.since)
    if not old <= limits.valid_for:
        why = f"the last sample is {old * 1e3:.0f} ms old, its numbers are valid for {limits.valid_for * 1e3:.0f} ms"
        return State.UNKNOWN, flags | _STALE, why
    if not s.age >= -limits.ahead:
        why = f"samples are stamped {-s.age * 1e3:.0f} ms in the future: how old they are is not known; synchronise the clocks"
        return State.UNKNOWN, flags | _STALE, why
    if s.sample.fault:
        return State.UNKNOWN, flags, s.sample.fault
    if s.pace:
        return State.UNKNOWN, flags, s.pace
    if v.conformance is not CONFORMANT:
        return State.UNKNOWN, flags, v.why
    if v.oldest < limits.evidence:
        why = f"held against predictions of the last {v.oldest * 1e3:.0f} ms only; OK needs {limits.evidence * 1e3:.0f} ms"
        return State.UNKNOWN, flags | _YOUNG, why
    if flags & _NO_STOP:
        unproven = next((c for c, x in s.numbers.items() if not x.proven), None)
        if unproven is None:
            return State.DEGRADED, flags, "no stop is bounded"
        return State.DEGRADED, flags, f"STOP {unproven}: {s.numbers[unproven].why}"
    return _OK, flags, v.why


@dataclass(slots=True)
class Recovery:
    """Better news must last before it is told, worse news is told at once: OK and DEGRADED come back only after good cycles
    without a break for ``limits.recover``, so that a state on the edge does not flicker.

    A turn of the loop later than ``limits.valid_for`` after the one before is a break: nobody watched meanwhile. So is a clock that
    was set: a consumer takes data for as old as their stamps say, until a message that came in time shows it that they lie.
    """

    limits: OkConditions
    _turn: float = float("-inf")
    _ahead: tuple[float, float] = (float("-inf"), float("inf"))
    _bad: float = float("-inf")  # when the state was last neither OK nor DEGRADED
    _degraded: float = float("-inf")
    _why_bad: str = "the start"
    _why_degraded: str = ""

    def hold(self, state: State, why: str, now: float, ahead: tuple[float, float]) -> tuple[State, int, str]:
        """The state to tell at ``now`` [s], the flag that it is held back, and the sentence.

        ``ahead``: by how much [s] the clock that stamps is ahead of the one of ``now``, at least and at most.
        """
        if now - self._turn > self.limits.valid_for:
            self._bad = now
            if self._turn > float("-inf"):
                self._why_bad = f"the monitor itself stood still for {(now - self._turn) * 1e3:.0f} ms"
        moved = max(ahead[0] - self._ahead[1], self._ahead[0] - ahead[1])
        if moved > SLEWED:
            self._bad, self._why_bad = now, f"the clock was set by {moved * 1e3:.0f} ms or more"
        self._turn, self._ahead = now, ahead
        if state is not _OK and state is not _DEGRADED:
            self._bad, self._why_bad = now, why
            return state, 0, why
        if state is _DEGRADED:
            self._degraded, self._why_degraded = now, why
        need = self.limits.recover
        if now - self._bad < need or self._bad == now:  # a break is told once at least: consumers rely on it
            return _UNKNOWN, _RECOVERING, self._wait(now - self._bad, self._why_bad)
        if state is _OK and now - self._degraded < need:
            return _DEGRADED, _RECOVERING, self._wait(now - self._degraded, self._why_degraded)
        return state, 0, why

    def _wait(self, passed: float, why: str) -> str:
        return f"good again for {passed:.2f} s of {self.limits.recover:.2f} s that must pass unbroken; before: {why}"


def believable(state: State, flags: int) -> bool:
    """Whether stop numbers may be given at all: not for a refuted model, nor outside its domain, without a signal, or
    against what the drives say."""
    return not flags & _DOUBTFUL and (state is _OK or state is _DEGRADED or state is _UNKNOWN)


def stop_fields(prefix: str, x: Numbers) -> dict[str, object]:
    """The message fields of one category."""
    bits = int(sum(1 << i for i in np.flatnonzero(x.provable)))
    return {
        f"{prefix}_provable": bits, f"{prefix}_time": x.time, f"{prefix}_angle_forward": x.forward,
        f"{prefix}_angle_back": x.back, f"{prefix}_time_max": float(np.max(x.time)), f"{prefix}_tcp": x.tcp,
        f"{prefix}_reaction": 0.0,
    }  # fmt: skip
