"""From verdict, bus and bounds to the one state byte; the worst of what is known wins, and nothing known is not OK."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stopset.monitor.layout import Flag, State
from stopset.monitor.stopdesk import Numbers
from stopset.monitor.watch import Conformance, Sample, Verdict


@dataclass(frozen=True, slots=True)
class Situation:
    """Everything the state depends on, in one place. ``fault``: words of an error, empty if none."""

    started: bool
    fault: str
    stale: bool
    late: bool
    latched: bool
    sample: Sample | None
    verdict: Verdict | None
    fresh: bool
    numbers: dict[str, Numbers]


def decide(s: Situation) -> tuple[State, Flag, str]:
    """State, flags and one sentence. Order: own fault, latched violation, no signal, no verdict, no bound, OK."""
    flags = Flag(0)
    v = s.verdict
    if s.latched:
        flags |= Flag.VIOLATION_LATCHED
    if s.stale:
        flags |= Flag.BUS_STALE
    if s.late:
        flags |= Flag.DEADLINE_MISS
    if v is not None and v.outside:
        flags |= Flag.OUT_OF_DOMAIN
    if v is not None and v.conformance is Conformance.UNKNOWN and v.why.startswith("gap"):
        flags |= Flag.BUS_GAP
    if s.sample is not None and not s.sample.powered:
        flags |= Flag.DRIVES_NOT_POWERED
    if s.sample is not None and s.sample.tau is None:
        flags |= Flag.NO_TORQUE
    unproven = [c for c, x in s.numbers.items() if not x.provable.all()]
    if unproven or not s.numbers:
        flags |= Flag.NO_STOP_PROVABLE
    if not s.fresh:
        flags |= Flag.STOP_NOT_FRESH
    failed = s.fault or (v.why if v is not None and v.conformance is Conformance.FAULT else "")
    if failed:
        return State.FAULT, flags, failed
    if s.latched:
        return State.VIOLATION, flags, "a measurement was outside its prediction; reset with a name and a reason"
    if s.stale:
        return (State.FAULT, flags, "no signal from the arm") if s.started else (State.INIT, flags, "waiting for the arm")
    if s.late:
        return State.FAULT, flags, "the monitor is later than its numbers are valid"
    if v is None:
        return State.INIT, flags, "waiting for the arm"
    if v.conformance is not Conformance.CONFORMANT:
        return State.UNKNOWN, flags, v.why
    if unproven:
        return State.DEGRADED, flags, f"STOP {unproven[0]}: {s.numbers[unproven[0]].why}"
    return State.OK, flags, v.why


def believable(state: State, flags: Flag) -> bool:
    """Whether stop numbers may be given at all: not for a refuted model, nor outside its domain, nor without a signal."""
    return state in (State.OK, State.DEGRADED, State.UNKNOWN) and not flags & (Flag.OUT_OF_DOMAIN | Flag.BUS_STALE)


def stop_fields(prefix: str, x: Numbers) -> dict[str, object]:
    """The message fields of one category."""
    bits = int(sum(1 << i for i in np.flatnonzero(x.provable)))
    return {
        f"{prefix}_provable": bits, f"{prefix}_time": x.time, f"{prefix}_angle_forward": x.forward,
        f"{prefix}_angle_back": x.back, f"{prefix}_time_max": float(np.max(x.time)), f"{prefix}_tcp": x.tcp,
        f"{prefix}_reaction": 0.0,
    }  # fmt: skip
