"""The daemon's loop: a sample in, a verdict, a message out, every cycle; and a message when there is no sample too.

Whatever goes wrong is published as FAULT before anything else happens: silence and errors never look like OK.
"""

from __future__ import annotations

import math
import os
import queue
import resource
import secrets
import sys
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import msgspec
import numpy as np

from stopset.artifact import Model
from stopset.errors import BusError, NotCovered
from stopset.monitor.config import Config
from stopset.monitor.latch import Latch
from stopset.monitor.layout import CATEGORIES, MAX_JOINTS, PREFIX, Flag, State, pack
from stopset.monitor.notify import Notifier
from stopset.monitor.source import NoSource, Source
from stopset.monitor.status import Situation, believable, decide, stop_fields
from stopset.monitor.stopdesk import Numbers, StopDesk
from stopset.monitor.watch import Conformance, Sample, Verdict, Watch, check_cycle

NOTICE = "Monitoring aid, not a safety function: bounds hold only for the identified model; stop distances for the risk "
NOTICE += "assessment must be measured (ISO 10218-1, ISO 13855)."
CODES = {Conformance.UNKNOWN: 0, Conformance.CONFORMANT: 1, Conformance.VIOLATION: 2, Conformance.FAULT: 3}
MAX_FAULTS = 3  # errors of the daemon's own in a row before it gives up and lets its supervisor restart it
PATIENCE = 0.01  # [s] longest wait for a sample before the heartbeat goes out without one
MAX_NONCE = 64


class Outlet(Protocol):
    """Where messages go; `stopset.monitor.links.zenoh_link.ZenohLink` in production."""

    def fast(self, name: str) -> Callable[[bytes], None]: ...
    def put(self, name: str, data: bytes | str, *, must_arrive: bool = False) -> None: ...
    def subscribe(self, name: str, handler: Callable[[str, bytes], None]) -> None: ...
    def serve(self, name: str, answer: Callable[[], bytes]) -> None: ...
    def alive(self, name: str) -> None: ...


def finite(x: float) -> float | None:
    """JSON has no infinity: what is not a number is null."""
    return float(x) if math.isfinite(x) else None


@dataclass(slots=True)
class Tally:
    """Counts since start, and the loop's timing since the last health message [s]."""

    samples: int = 0
    verdicts: dict[str, int] = field(default_factory=lambda: {c.value: 0 for c in Conformance})
    outside_domain: int = 0
    gaps: int = 0
    faults: int = 0
    late: int = 0
    delays: list[float] = field(default_factory=list)
    busy: list[float] = field(default_factory=list)


class Daemon:
    """One arm's monitor. ``source`` gives samples, ``outlet`` takes messages; `cycle` does one turn, `run` all of them."""

    def __init__(self, config: Config, model: Model, source: Source, outlet: Outlet, cycle_s: float) -> None:
        if model.n > MAX_JOINTS:
            raise NotCovered(f"the arm has {model.n} joints, the state message carries {MAX_JOINTS}; a wider layout is needed")
        check_cycle(model, cycle_s)
        self.config, self.model, self.source, self.outlet = config, model, source, outlet
        self.cycle_s = cycle_s
        self.watch = Watch(model, source.quantum, config.payload_kg, (config.warm[0], config.warm[-1]))
        self.latch, self.tally = Latch(), Tally()
        self.desk = StopDesk(config.model, model.n, config.stops, config.payload_kg, source.quantum)
        self.stopping = False
        self._boot, self._seq = secrets.randbits(64), 0
        self._sample: Sample | None = None
        self._verdict: Verdict | None = None
        self._arrived = float("-inf")
        self._late_in_a_row = 0
        self._fault = self._last_words = ""
        self._evidence: deque[Sample] = deque(maxlen=max(1, round(config.publish.evidence_s / cycle_s)))
        self._orders: queue.SimpleQueue[tuple[str, bytes]] = queue.SimpleQueue()
        self._events: deque[dict[str, Any]] = deque(maxlen=100)
        self._next_json = self._next_health = 0.0
        self._said: dict[str, float] = {}
        self._publish = outlet.fast("state")
        for name in ("challenge", "reset"):
            outlet.subscribe(name, lambda key, data: self._orders.put((key.rsplit("/", 1)[-1], data)))
        text = Path(config.model).read_bytes()
        outlet.serve("model", lambda: text)
        outlet.serve("event", lambda: msgspec.json.encode(list(self._events)))
        outlet.alive("alive")
        self._notify = Notifier()

    # ---- one turn -----------------------------------------------------------------------------------------------

    def cycle(self) -> None:
        """Wait for a sample (not longer than a heartbeat), judge it, publish."""
        sample = self.source.next(max(PATIENCE, 2 * self.cycle_s))
        begin = time.monotonic()
        if sample is not None:
            self._take(sample, begin)
        self._obey()
        state, flags, why, numbers = self._situation(begin)
        self._send(state, flags, numbers)
        if sample is not None:
            self.tally.busy.append(time.monotonic() - begin)
        self._slow_messages(begin, state, flags, why, numbers)
        self._fault = ""

    def _take(self, s: Sample, now: float) -> None:
        first = self._sample is None
        self._sample, self._arrived = s, now
        self._evidence.append(s)
        v = self._verdict = self.watch.step(s)
        t = self.tally
        t.samples += 1
        t.verdicts[v.conformance.value] += 1
        t.outside_domain += bool(v.outside)
        delay = time.time() - s.t
        t.delays.append(delay)
        self._late_in_a_row = self._late_in_a_row + 1 if delay > self.config.publish.valid_for_ms * 1e-3 else 0
        t.late += self._late_in_a_row > 0
        self.desk.offer(s.t, s.q, s.dq)
        if first:
            self._notify.say("READY=1", "STATUS=listening")
            self._event("started", model_sha256=self.model.sha256, config_sha256=self.config.sha256)
        new = self.latch.take(s, v)
        if new:
            rows = [[x.k, x.t, x.q.tolist(), x.dq.tolist(), None if x.tau is None else x.tau.tolist()] for x in self._evidence]
            self._event(
                "violation", why=v.why, violations=[e.plain() for e in new], evidence_columns="k t q dq tau", evidence=rows
            )
        if v.conformance is Conformance.FAULT:
            t.faults += 1
            self._event("fault", why=v.why)
        if v.why.startswith("gap"):
            t.gaps += 1
            self._seldom("gap", why=v.why)
        if v.outside:
            self._seldom("outside_domain", signals=list(v.outside))

    def _situation(self, now: float) -> tuple[State, Flag, str, dict[str, Numbers]]:
        s = self._sample
        numbers, fresh = self.desk.now(s.q, s.dq) if s is not None else ({}, False)
        stale = now - self._arrived > self.config.publish.stale_ms * 1e-3
        state, flags, why = decide(
            Situation(
                s is not None, self._fault, stale, self._late_in_a_row >= 3, self.latch.latched, s, self._verdict, fresh, numbers
            )
        )
        if not believable(state, flags):
            f = self.config.fallback
            flags |= Flag.FALLBACK_IN_FORCE
            n = self.model.n
            numbers = {c: Numbers.fallback(n, f.time_s, f.angle_rad, f.tcp_m, why) for c in numbers}
        return state, flags, why, numbers

    def _send(self, state: State, flags: Flag, numbers: dict[str, Numbers]) -> None:
        c, s, v = self.config, self._sample, self._verdict
        n = self.model.n
        values: dict[str, Any] = {
            "data_id": c.data_id, "seq": self._seq & 0xFFFFFFFF, "boot_id": self._boot,
            "t_meas_ns": max(0, round(s.t * 1e9)) if s else 0, "t_pub_ns": time.time_ns(),
            "model_hash": int(self.model.sha256[:16] or "0", 16), "config_hash": int(c.sha256[:16] or "0", 16),
            "valid_for_ms": c.publish.valid_for_ms, "cycle_us": round(self.cycle_s * 1e6), "joints": n,
            "state": int(state), "conformance": CODES[v.conformance] if v else 0, "flags": int(flags),
            "violation_count": self.latch.count, "oldest_age": v.oldest if v else 0.0,
            "first_joint": self.model.joints.index(self.latch.first.first.joint) + 1 if self.latch.first else 0,
            "room_min": float(v.room.min()) if v and v.room is not None else -np.inf,
            "holding_margin_min": min((x.margin for x in numbers.values()), default=-np.inf),
        }  # fmt: skip
        for category in CATEGORIES:
            x = numbers.get(category) or Numbers.none(n, "not asked for")
            values |= stop_fields(PREFIX[category], x)
        self._publish(pack(values))
        self._seq += 1
        self._notify.say("WATCHDOG=1")

    def _obey(self) -> None:
        while not self._orders.empty():
            name, data = self._orders.get_nowait()
            if name == "challenge":
                echo = {
                    "nonce": data[:MAX_NONCE].hex(),
                    "seq": self._seq,
                    "boot_id": f"{self._boot:016x}",
                    "t_pub_ns": time.time_ns(),
                }
                self.outlet.put("echo", msgspec.json.encode(echo))
            elif name == "reset":
                self._reset(data)

    def _reset(self, data: bytes) -> None:
        try:
            order = msgspec.json.decode(data, type=dict[str, str])
            who, why = order["name"].strip(), order["reason"].strip()
        except (msgspec.MsgspecError, KeyError, AttributeError):
            who = why = ""
        if not who or not why:
            self._event("reset_refused", why='expected {"name": who, "reason": why}')
            return
        self._event("reset", name=who, reason=why, cleared=self.latch.count, joints=list(self.latch.joints))
        self.latch.reset()

    # ---- for people ---------------------------------------------------------------------------------------------

    def _event(self, kind: str, **more: Any) -> None:
        event = {"kind": kind, "t_ns": time.time_ns(), "seq": self._seq, **more}
        self._events.append({k: v for k, v in event.items() if k != "evidence"})
        self.outlet.put("event", msgspec.json.encode(event))

    def _seldom(self, kind: str, **more: Any) -> None:
        """An event at most once a second; the counts in ``health`` are complete."""
        now = time.monotonic()
        if now - self._said.get(kind, float("-inf")) > 1.0:
            self._said[kind] = now
            self._event(kind, **more)

    def _slow_messages(self, now: float, state: State, flags: Flag, why: str, numbers: dict[str, Numbers]) -> None:
        if now >= self._next_json:
            self._next_json = now + 1.0 / self.config.publish.json_hz
            self.outlet.put("state/json", msgspec.json.encode(self.twin(state, flags, why, numbers)))
        if now >= self._next_health:
            self._next_health = now + 1.0
            for words in self.source.complaints():
                self._event("bus", why=words)
            self.outlet.put("health", msgspec.json.encode(self.health()))
            self._notify.say(f"STATUS={state.name}: {why}"[:200])

    def twin(self, state: State, flags: Flag, why: str, numbers: dict[str, Numbers]) -> dict[str, Any]:
        """What ``state/json`` says: the binary message in words, with names."""
        v, s, joints = self._verdict, self._sample, self.model.joints
        stops: dict[str, Any] = {}
        for c, x in numbers.items():
            stops[c] = {
                "time_s": finite(float(np.max(x.time))), "tcp_m": finite(x.tcp),
                "certified": bool(x.provable.all()), "why": x.why,
                "joints": {
                    j: {"time_s": finite(x.time[i]), "forward_rad": finite(x.forward[i]), "back_rad": finite(x.back[i])}
                    for i, j in enumerate(joints)
                },
            }  # fmt: skip
        n = self.model.n
        room = None if v is None or v.room is None else {j: float(min(v.room[i], v.room[n + i])) for i, j in enumerate(joints)}
        return {
            "state": state.name, "why": why, "flags": [f.name for f in Flag if f in flags],
            "conformance": v.conformance.value if v else "UNKNOWN", "conformance_why": v.why if v else "",
            "violation_latched": self.latch.latched, "violation_count": self.latch.count,
            "violating_joints": list(self.latch.joints),
            "violations": [e.plain() for e in self.latch.entries.values()],
            "outside_domain": list(v.outside) if v else [],
            "samples": self.tally.samples, "verdicts": dict(self.tally.verdicts), "gaps": self.tally.gaps,
            "predictions": v.compared if v else 0, "oldest_prediction_s": v.oldest if v else 0.0, "room": room,
            "q": s.q.tolist() if s else None, "dq": s.dq.tolist() if s else None,
            "tau": s.tau.tolist() if s is not None and s.tau is not None else None,
            "joints": list(joints), "stops": stops, "t_ns": round(s.t * 1e9) if s else None, "seq": self._seq,
            "data_id": self.config.data_id, "model_sha256": self.model.sha256, "config_sha256": self.config.sha256,
            "guarantee": self.model.guarantee.text, "notice": NOTICE,
        }  # fmt: skip

    def health(self) -> dict[str, Any]:
        """What ``health`` says: the loop, the bus, the process. Resets the timing window."""
        t = self.tally
        delays, busy = np.array(t.delays or [0.0]), np.array(t.busy or [0.0])
        out = {
            "t_ns": time.time_ns(), "samples": t.samples, "gaps": t.gaps, "late": t.late, "faults": t.faults,
            "outside_domain": t.outside_domain, "cycles_in_window": len(t.busy),
            "sync_to_publish_ms": {"median": 1e3 * float(np.median(delays)), "max": 1e3 * float(delays.max())},
            "loop_busy_ms": {"median": 1e3 * float(np.median(busy)), "max": 1e3 * float(busy.max())},
            "bus": self.source.counters(), "stop_bound_ms": 1e3 * self.desk.answer.took if self.desk.answer else None,
            "memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, "pid": os.getpid(),
        }  # fmt: skip
        t.delays.clear()
        t.busy.clear()
        return out

    # ---- life ---------------------------------------------------------------------------------------------------

    def fail(self, words: str) -> None:
        """Publish FAULT with these words now."""
        self._fault = words
        self.tally.faults += 1
        if words != self._last_words:
            self._event("fault", why=words)
        self._last_words = words
        state, flags, why, numbers = self._situation(time.monotonic())
        self._send(state, flags, numbers)
        self.outlet.put("state/json", msgspec.json.encode(self.twin(state, flags, why, numbers)))

    def run(self, reopen: Callable[[], Source]) -> int:
        """Until stopped; returns the exit code. A lost bus is FAULT until ``reopen`` succeeds."""
        faults = 0
        while not self.stopping:
            try:
                self.cycle()
                faults, self._last_words = 0, ""
            except BusError as e:
                self._lost_bus(str(e), reopen)
            except Exception as e:  # noqa: BLE001 - the consumers must hear of it before anyone handles it
                faults += 1
                self.fail(f"{type(e).__name__}: {e}")
                if faults >= MAX_FAULTS:
                    sys.stderr.write(f"stopset monitor: gives up after {faults} errors in a row: {type(e).__name__}: {e}\n")
                    return 3
        return 0

    def _lost_bus(self, words: str, reopen: Callable[[], Source]) -> None:
        self.source.close()
        self._arrived = float("-inf")
        while not self.stopping:
            self.fail(words)
            until = time.monotonic() + 0.5
            while time.monotonic() < until and not self.stopping:
                self._fault = words
                state, flags, _, numbers = self._situation(time.monotonic())
                self._send(state, flags, numbers)
                self._obey()
                time.sleep(PATIENCE)
            try:
                self.source = reopen()
                return
            except BusError as e:
                words = str(e)
                if isinstance(self.source, NoSource) and time.monotonic() > self.source.until:
                    raise  # it never was there: a wrong name more likely than a late bus

    def close(self) -> None:
        """Say SHUTDOWN, release everything."""
        self._notify.say("STOPPING=1")
        state, flags, why, numbers = self._situation(time.monotonic())
        twin = self.twin(state, flags, why, numbers) | {"state": State.SHUTDOWN.name, "why": "the monitor was stopped"}
        self._send(State.SHUTDOWN, flags | Flag.FALLBACK_IN_FORCE, {c: Numbers.none(self.model.n, "shut down") for c in numbers})
        self.outlet.put("state/json", msgspec.json.encode(twin), must_arrive=True)
        self._event("stopped")
        self.desk.close()
        self.source.close()
