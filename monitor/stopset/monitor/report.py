"""The state in words, for people: what ``state/json`` and ``health`` say."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from typing import Any, Protocol

import msgspec
import numpy as np

from stopset.artifact import Model
from stopset.monitor.along import WatchAlong
from stopset.monitor.certificates import Numbers
from stopset.monitor.clock import Clock
from stopset.monitor.config import Config
from stopset.monitor.durations import Durations
from stopset.monitor.evidence.recorder import Recorder
from stopset.monitor.latch import Latch
from stopset.monitor.layout import Flag, State
from stopset.monitor.orders import Orders
from stopset.monitor.payload import assumed, published
from stopset.monitor.process import Process
from stopset.monitor.publisher import Publisher
from stopset.monitor.realtime import Granted
from stopset.monitor.remaining import Remaining
from stopset.monitor.sample import Sample
from stopset.monitor.source import SampleSource
from stopset.monitor.stopdesk import StopDesk
from stopset.monitor.verdict import Conformance, Verdict
from stopset.monitor.watch import Watch

NOTICE = "Monitoring aid, not a safety function: bounds hold only for the identified model; stop distances for the risk "
NOTICE += "assessment must be measured (ISO 10218-1, ISO 13855)."


class Turn(msgspec.Struct):  # as `stopset.monitor.sample.Sample`
    """What one turn of the loop has come to; ``made_ns`` [ns since the epoch]: the instant it was judged for."""

    state: State
    flags: int
    why: str
    numbers: dict[str, Numbers]
    made_ns: int


@dataclass(slots=True)
class RunCounts:
    """Counts since start, and the loop's timing since the last health message [s]."""

    samples: int = 0
    verdicts: dict[Conformance, int] = field(default_factory=lambda: dict.fromkeys(Conformance, 0))
    states: dict[State, int] = field(default_factory=lambda: dict.fromkeys(State, 0))  # told of samples
    outside_domain: int = 0
    gaps: int = 0
    faults: int = 0
    late: int = 0
    delays: Durations = field(default_factory=Durations)
    busy: Durations = field(default_factory=Durations)


class Monitored(Protocol):
    """What is reported of: the parts of a `stopset.monitor.daemon.Daemon`, and where they have got to."""

    config: Config
    model: Model
    watch: Watch | WatchAlong
    source: SampleSource
    desk: StopDesk
    latch: Latch
    orders: Orders
    publisher: Publisher
    recorder: Recorder | None
    clock: Clock
    granted: Granted
    process: Process
    cycle_s: float
    tally: RunCounts
    sample: Sample | None
    verdict: Verdict | None
    remaining: Remaining


def finite(x: float) -> float | None:
    """JSON has no infinity: what is not a number is null."""
    return float(x) if math.isfinite(x) else None


def _stops(turn: Turn, joints: tuple[str, ...]) -> dict[str, Any]:
    return {
        c: {
            "time_s": finite(float(np.max(x.time))), "tcp_m": finite(x.tcp),
            "certified": x.proven, "why": x.why or ("" if x.proven else turn.why), "capsules": _capsules(x),
            "end_stops": list(x.end_stops),
            "joints": {
                j: {"time_s": finite(x.time[i]), "forward_rad": finite(x.forward[i]), "back_rad": finite(x.back[i])}
                for i, j in enumerate(joints)
            },
        }
        for c, x in turn.numbers.items()
    }  # fmt: skip


def _capsules(x: Numbers) -> list[list[float]] | None:
    """What the links' axes sweep, for pictures: to a tenth of a millimetre, the radius taking up what rounding moves."""
    if x.capsules is None:
        return None
    out = np.round(x.capsules, 4)
    out[:, 6] = np.round(x.capsules[:, 6] + 2e-4, 4)
    rows: list[list[float]] = out.tolist()
    return rows


def _tube(d: Monitored) -> dict[str, list[float | None]] | None:
    """Between which joint positions [rad] the predictions in force put the last sample."""
    found = None if d.sample is None or d.verdict is None or d.verdict.room is None else d.watch.tube(d.sample)
    n = d.model.n
    return None if found is None else {k: [finite(v) for v in x[:n]] for k, x in zip(("lo", "hi"), found, strict=True)}


def twin(d: Monitored, turn: Turn) -> dict[str, Any]:
    """The binary message in words, with names."""
    v, s, joints, n = d.verdict, d.sample, d.model.joints, d.model.n
    room = None if v is None or v.room is None else {j: float(min(v.room[i], v.room[n + i])) for i, j in enumerate(joints)}
    return {
        "state": turn.state.name, "why": turn.why, "flags": [f.name for f in Flag if f & turn.flags],
        "conformance": v.conformance.value if v else "UNKNOWN", "conformance_why": v.why if v else "",
        "violation_latched": d.latch.latched, "violation_count": d.latch.count, "violation_why": d.latch.record.why,
        "violation_class": d.latch.kind.value, "violation_cause": d.latch.record.cause or None,
        "violating_joints": list(d.latch.joints), "violations": [e.plain() for e in d.latch.entries.values()],
        "outside_domain": list(v.outside) if v else [],
        "samples": d.tally.samples, "verdicts": {c.value: count for c, count in d.tally.verdicts.items()},
        "states": {s.name: count for s, count in d.tally.states.items()}, "gaps": d.tally.gaps,
        "predictions": v.compared if v else 0, "oldest_prediction_s": v.oldest if v else 0.0, "room": room,
        "tube": _tube(d),
        "q": s.q.tolist() if s else None, "dq": s.dq.tolist() if s else None,
        "tau": s.tau.tolist() if s is not None and s.tau is not None else None,
        "margins": d.remaining.margins, "override": d.remaining.override, "payload_kg": published(d.model, d.config.payload_kg),
        "joints": list(joints), "stops": _stops(turn, joints), "t_ns": round(s.t * 1e9) if s else None,
        "seq": d.publisher.seq, "data_id": d.config.data_id, "model_sha256": d.model.sha256, "config_sha256": d.config.sha256,
        "guarantee": d.model.guarantee.text, "notice": NOTICE,
    }  # fmt: skip


def health(d: Monitored) -> dict[str, Any]:
    """The loop, the bus, the process. Resets the timing window."""
    t = d.tally
    out = {
        "t_ns": d.clock.time_ns(), "samples": t.samples, "gaps": t.gaps, "late": t.late, "faults": t.faults,
        "outside_domain": t.outside_domain, "cycles_in_window": len(t.busy),
        "sync_to_publish_ms": t.delays.middle_and_most(), "loop_busy_ms": t.busy.middle_and_most(),
        "bus": d.source.counters(), "stop_bound_ms": None if d.desk.slowest is None else 1e3 * d.desk.slowest,
        "stop_restarts": d.desk.restarts, "stop_cost": d.desk.spending,
        "realtime": d.granted.said, **d.process.said(),
        "orders_dropped": d.orders.dropped, "send_errors": d.publisher.errors, "send_error": d.publisher.error,
        "recorder": None if d.recorder is None else {
            "trouble": d.recorder.trouble, "dropped": d.recorder.dropped, "violations_written": d.recorder.files,
        },
    }  # fmt: skip
    t.delays.clear()
    t.busy.clear()
    return out


def about(d: Monitored) -> dict[str, str]:
    """Whose words a file holds: arm, model, configuration, life."""
    c, m = d.config, d.model
    return {
        "schema": "1", "key": c.prefix, "data_id": str(c.data_id), "boot_id": f"{d.publisher.boot:016x}",
        "model_sha256": m.sha256, "config_sha256": c.sha256, "joints": ",".join(m.joints), "effort": m.effort,
        "robot": m.robot.name, "cycle_s": repr(d.cycle_s), "payload_kg": json.dumps(assumed(m, c.payload_kg)),
        "payload_declared": json.dumps(c.payload_kg is not None), "notice": NOTICE,
    }  # fmt: skip
