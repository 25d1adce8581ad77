"""The daemon's loop: a sample in, a verdict, a message out, every cycle; and a message when there is no sample too.

Whatever goes wrong is published as FAULT before anything else happens: silence and errors never look like OK.
"""

from __future__ import annotations

import contextlib
import sys
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import msgspec

from stopset.artifact import Model
from stopset.errors import BusError, NotCovered
from stopset.monitor.along import watch_for
from stopset.monitor.authentication import Key
from stopset.monitor.certificates import Numbers
from stopset.monitor.clearing import Clearing
from stopset.monitor.clock import Clock, SystemClock
from stopset.monitor.config import Config
from stopset.monitor.evidence.recorder import Filed, Recorder
from stopset.monitor.latch import Latch
from stopset.monitor.layout import MAX_JOINTS, Flag, State
from stopset.monitor.message import CODES, StateMessage
from stopset.monitor.notify import Notifier
from stopset.monitor.operators import Operators
from stopset.monitor.orders import Orders
from stopset.monitor.pace import Pace
from stopset.monitor.process import Process, SystemProcess
from stopset.monitor.publisher import Outlet, Publisher
from stopset.monitor.realtime import Granted
from stopset.monitor.reloading import Loaded, Reloading, end_beside
from stopset.monitor.remaining import Remaining
from stopset.monitor.report import RunCounts, Turn, health, twin
from stopset.monitor.sample import Sample
from stopset.monitor.source import NoSource, SampleSource, drives_of, resumed
from stopset.monitor.spawned import Spawned
from stopset.monitor.status import OkConditions, Recovery, Situation, believable, decide
from stopset.monitor.stopdesk import StopDesk, seen_by
from stopset.monitor.verdict import FAULT, VIOLATION, Verdict
from stopset.monitor.watch import check_cycle

MAX_FAULTS = 3  # errors of the daemon's own in a row before it gives up and lets its supervisor restart it
PATIENCE = 0.01  # [s] longest wait for a sample before the heartbeat goes out without one
AGAIN = 0.5  # [s] between two tries to open a lost bus
FALLBACK_IN_FORCE = int(Flag.FALLBACK_IN_FORCE)
LATE = 3  # samples in a row that came later than they are valid for
Reopen = Callable[[], SampleSource | None]  # None: not there yet, ask again


@dataclass(frozen=True, slots=True)
class Beside:
    """What the daemon works with beside its source and outlet; what is None is made for it.

    ``load``: gives the model anew when a reload is asked for; raises `StopsetError` if that cannot be used.
    """

    latch: Latch | None = None
    key: Key | None = None
    clock: Clock | None = None
    process: Process | None = None
    desk: StopDesk | None = None
    load: Callable[[], Model] | None = None
    recorder: Recorder | None = None
    granted: Granted = Granted({})  # noqa: RUF009 - frozen
    begun: Spawned | None = None  # what will bound stops, loading already


class Daemon:
    """One arm's monitor. ``source`` gives samples, ``outlet`` takes messages; `cycle` does one turn, `run` all of them."""

    def __init__(
        self, config: Config, model: Model, source: SampleSource, outlet: Outlet, cycle_s: float, beside: Beside = Beside()
    ) -> None:
        self.config, self.source, self.cycle_s, self.recorder = config, source, cycle_s, beside.recorder
        self.granted, self.process = beside.granted, beside.process or SystemProcess()
        self.clock: Clock = beside.clock or SystemClock()
        self.reloading = Reloading(beside.load, self._prepare)
        self._use(self._prepare(model, beside.desk, beside.begun))
        self.recovery = Recovery(self.limits)
        self.latch, self.tally, self.orders = beside.latch or Latch(), RunCounts(), Orders()
        self._remind()
        self.stopping = False
        self._patience, self._stale_s = max(PATIENCE, 2 * cycle_s), config.publish.stale_ms * 1e-3
        self.pace = Pace(cycle_s / (config.bus.time_scale if config.bus else 1.0))
        self.sample: Sample | None = None
        self.verdict: Verdict | None = None
        self._arrived = float("-inf")
        self._late_in_a_row = 0
        self._dropped = 0  # by the sources before this one
        self._fault = self._last_words = self._disk = ""
        self._evidence: deque[Sample] = deque(maxlen=max(1, round(config.publish.evidence_s / cycle_s)))
        self._next_json = self._next_health = 0.0
        self.publisher = Publisher(outlet, self.clock, self._identity(), beside.key, self.process.boot())
        self.clearing = Clearing(Operators.of(config.operators), self.latch, self.publisher, config.data_id, self.clock)
        self._message = StateMessage(config.fallback, model.joints)
        for name in ("challenge", "reset"):
            outlet.subscribe(name, self.orders.take)
        outlet.serve("model", lambda: self._loaded.text)
        outlet.serve("event", lambda: msgspec.json.encode(list(self.publisher.events)))
        outlet.alive("alive")
        self._notify = Notifier()

    # ---- the model --------------------------------------------------------------------------------------------------

    def _prepare(self, model: Model, desk: StopDesk | None = None, begun: Spawned | None = None) -> Loaded:
        c, quantum = self.config, self.source.quantum
        if model.n > MAX_JOINTS:
            raise NotCovered(f"the arm has {model.n} joints, the state message carries {MAX_JOINTS}; a wider layout is needed")
        check_cycle(model, self.cycle_s)
        text = Path(c.model).read_bytes()  # for those who ask for the model
        if model.sha256.encode() not in text:
            raise NotCovered(f"{c.model} became another file while it was read; ask for it again")
        watch = watch_for(model, quantum, c.payload_kg, (c.warm[0], c.warm[-1]), self.cycle_s)
        if desk is None:
            about = seen_by(model), c.stops, c.payload_kg, quantum
            desk = StopDesk(c.model, *about, clock=self.clock, sha256=model.sha256, begun=begun)
        return Loaded(model, text, watch, desk, Remaining.of(c, model))

    def _use(self, loaded: Loaded) -> None:
        self._loaded, self.model, self.watch, self.desk = loaded, loaded.model, loaded.watch, loaded.desk
        self.remaining = loaded.remaining
        p = self.config.publish
        valid = p.valid_for_ms * 1e-3
        self.limits = OkConditions(valid, min(valid, self.cycle_s), min(p.evidence_min_s, 0.5 * self.watch.horizon), p.recover_s)
        if self.recorder is not None:
            self.recorder.watching(loaded.model, self.source.quantum)

    def _identity(self) -> dict[str, int]:
        c = self.config
        return {
            "data_id": c.data_id, "model_hash": int(self.model.sha256[:16] or "0", 16),
            "config_hash": int(c.sha256[:16] or "0", 16), "valid_for_ms": c.publish.valid_for_ms,
            "cycle_us": round(self.cycle_s * 1e6), "joints": self.model.n,
        }  # fmt: skip

    def _take_reloaded(self) -> None:
        answer = self.reloading.turn(self.model.joints)
        if answer is None:
            return
        if isinstance(answer, str):
            self.publisher.event("reload_refused", why=answer, model_sha256=self.model.sha256)
            return
        desk, remaining, before = self.desk, self.remaining, self.model.sha256
        self._use(answer)
        self.verdict = None
        self.publisher.identity = self._identity()
        self.publisher.event("reloaded", model_sha256=self.model.sha256, before=before)
        end_beside(desk, remaining)

    # ---- one turn -----------------------------------------------------------------------------------------------

    def cycle(self) -> None:
        """Wait for a sample (not longer than a heartbeat), judge it, publish."""
        sample = self.source.next(self._patience)
        self._heed()
        begin = self.clock.monotonic()
        if sample is not None:
            self._take(sample, begin)
        self._obey(begin)
        turn = self._situation()
        self._send(turn)
        if self.recorder is not None and sample is not None:
            self.recorder.trace.state(int(turn.state))
        if sample is not None:
            self.tally.states[turn.state] += 1
            self.tally.busy.add(self.clock.monotonic() - begin)
        self._slow_messages(begin, turn)
        self._fault = ""

    def _heed(self) -> None:
        """What drives say once is kept before anything else happens."""
        if (drives := drives_of(self.source)) is not None:
            heard = drives.in_force
            if heard and heard.items() - self.latch.record.emergencies.items():  # another of the same drive is one too
                self.clearing.emergency()
            self.latch.hear(heard)

    def _remind(self) -> None:
        """A source that was just opened has not heard what drives said before."""
        if (drives := drives_of(self.source)) is not None:
            drives.recall(self.latch.record.emergencies)

    def _take(self, s: Sample, now: float) -> None:
        first = self.sample is None
        self.sample, self._arrived = s, now
        self._evidence.append(s)
        self.pace.take(s.t)
        v = self.verdict = self.watch.step(s)
        new = self.latch.take(s, v, now)  # before anything else, for nothing that fails below may lose it
        if v.conformance is VIOLATION:
            self.clearing.violation()
        t = self.tally
        t.samples += 1
        t.verdicts[v.conformance] += 1
        t.outside_domain += bool(v.outside)
        delay = self.clock.time_ns() * 1e-9 - s.t
        t.delays.add(delay)
        self._late_in_a_row = self._late_in_a_row + 1 if delay > self.limits.valid_for else 0
        t.late += self._late_in_a_row > 0
        self.desk.offer(s.t, s.q, s.dq)
        if first:
            self._notify.say("READY=1", "STATUS=listening")
            self.publisher.event("started", model_sha256=self.model.sha256, config_sha256=self.config.sha256)
            if self.granted.lacking:
                self.publisher.event("realtime", why=self.granted.lacking)
        if self.recorder is not None:
            self.recorder.take(s, v, CODES[v.conformance], self.watch.inputs)
        if new:
            if self.recorder is not None:
                self.recorder.incident(new[0].first, s.t)
            rows = [[x.k, x.t, x.q.tolist(), x.dq.tolist(), None if x.tau is None else x.tau.tolist()] for x in self._evidence]
            self.publisher.event(
                "violation", why=v.why, violations=[e.plain() for e in new], evidence_columns="k t q dq tau", evidence=rows
            )
        if v.conformance is FAULT:
            t.faults += 1
            self.publisher.seldom("fault", why=v.why)
        if self.pace.why:
            self.publisher.seldom("pace", why=self.pace.why)
        if v.gap:
            t.gaps += 1
            self.publisher.seldom("gap", why=v.why)
        if v.outside:
            self.publisher.seldom("outside_domain", signals=list(v.outside))

    def _situation(self) -> Turn:
        s, now = self.sample, self.clock.monotonic()
        numbers, fresh = self.desk.now(s.q, s.dq) if s is not None else ({}, False)
        since = now - self._arrived
        made = self.clock.time_ns()
        stamped = made * 1e-9
        ahead = stamped - self.clock.monotonic(), stamped - now
        age = stamped - s.t if s is not None else float("inf")
        stale = since > self._stale_s
        situation = Situation(
            s is not None, self._fault, stale, self._late_in_a_row >= LATE, self.latch.record.why, age, since, s, self.verdict,
            fresh, numbers, self.pace.fault,
        )  # fmt: skip
        state, flags, why = decide(situation, self.limits)
        state, held, why = self.recovery.hold(state, why, now, ahead)
        flags |= held
        if not believable(state, flags):
            flags |= FALLBACK_IN_FORCE
            numbers = self._message.withdrawn(numbers)
        return Turn(state, flags, why, numbers, made)

    def _send(self, turn: Turn) -> None:
        message, publisher = self._message, self.publisher
        dropped = self._dropped + self.source.dropped + self.orders.dropped
        now = message.changing(turn, self.sample, self.verdict, self.latch, dropped)
        publisher.state(now, message.block(turn.numbers, publisher.identity), turn.made_ns)
        self._notify.say("WATCHDOG=1")

    def _obey(self, now: float) -> None:
        for nonce in self.orders.challenges():
            self.publisher.echo(nonce)
        if (order := self.orders.reset()) is not None:
            self.clearing.take(order[0], now, self.source)
        self._take_reloaded()
        self._say_recorded(now)

    def _say_recorded(self, now: float) -> None:
        """What the recorder has found since the last turn."""
        while self.recorder is not None and self.recorder.answers:
            self._classed(self.recorder.answers.popleft(), now)
        while self.recorder is not None and self.recorder.notes:
            self.publisher.event("plausibility", why=self.recorder.notes.popleft())

    def _classed(self, answer: Filed, now: float) -> None:
        """The recorder has looked at a violation: it is on the disk, and told."""
        self.latch.classed(answer.cause, now)
        self.publisher.event(
            "bundle", cause=answer.cause.plain(), file=answer.file, sha256=answer.sha256, why=answer.trouble,
            model_sha256=self.model.sha256, config_sha256=self.config.sha256,
        )  # fmt: skip

    def _slow_messages(self, now: float, turn: Turn) -> None:
        if now >= self._next_json:
            if self.sample is not None and (over := self.remaining.measure(now, self.sample, turn.numbers, self.source.quantum)):
                self.publisher.seldom(
                    "margin", why=f"a stop now would not keep: {', '.join(over)}", margins=self.remaining.margins
                )
            self._next_json = now + 1.0 / self.config.publish.json_hz
            self.publisher.words("state/json", twin(self, turn))
        if now >= self._next_health:
            self._next_health = now + 1.0
            for words in self.source.complaints():
                self.publisher.event("bus", why=words)
            disk = self.latch.keep(now)
            if disk and disk != self._disk:
                self.publisher.event("journal", why=disk)
            self._disk = disk
            self.publisher.words("health", health(self))
            self._notify.say(f"STATUS={turn.state.name}: {turn.why}"[:200])

    # ---- life ---------------------------------------------------------------------------------------------------

    def fail(self, words: str) -> None:
        """Publish FAULT with these words now; nothing in here can raise."""
        self._fault = words
        self.tally.faults += 1
        if words != self._last_words:
            self.publisher.event("fault", why=words)
        self._last_words = words
        try:
            turn = self._situation()
        except Exception as e:  # noqa: BLE001 - this is the error path: there is no other behind it
            turn = Turn(State.FAULT, FALLBACK_IN_FORCE, f"{words}; {type(e).__name__}: {e}", {}, self.clock.time_ns())
        try:
            self._send(turn)
            self.publisher.words("state/json", twin(self, turn))
        except Exception:  # noqa: BLE001 - as above; the bare message needs nothing of what has failed
            self.publisher.nothing()

    def run(self, reopen: Reopen) -> int:
        """Until stopped; returns the exit code. A lost bus is FAULT until ``reopen`` succeeds."""
        faults = 0
        while not self.stopping:
            try:
                try:
                    self.cycle()
                    faults, self._last_words = 0, ""
                except BusError as e:
                    self._lost_bus(str(e), reopen)
            except BusError:
                raise  # it never was there
            except Exception as e:  # noqa: BLE001 - the consumers must hear of it before anyone handles it
                faults += 1
                self.fail(f"{type(e).__name__}: {e}")
                if faults >= MAX_FAULTS:
                    with contextlib.suppress(OSError):  # nobody takes it; the event `fault` says it too
                        sys.stderr.write(f"stopset monitor: gives up after {faults} errors in a row: {type(e).__name__}: {e}\n")
                    return 3
        return 0

    def _lost_bus(self, words: str, reopen: Reopen) -> None:
        self._heed()
        with contextlib.suppress(Exception):  # it is lost anyway
            self.source.close()
        self._arrived = float("-inf")
        while not self.stopping:
            self.fail(words)
            until = self.clock.monotonic() + AGAIN
            while self.clock.monotonic() < until and not self.stopping:
                self._say_lost(words)
            try:
                while (source := reopen()) is None:
                    if self._say_lost(words):
                        return
                self._dropped += self.source.dropped
                self.source = resumed(source, self.source)
                self._remind()
                self.watch.restart()  # a new source counts its cycles anew
                return
            except BusError as e:
                words = str(e)
                if isinstance(self.source, NoSource) and self.clock.monotonic() > self.source.until:
                    raise  # it never was there: a wrong name more likely than a late bus
            except Exception as e:  # noqa: BLE001 - whatever a driver raises, the next try may do better
                words = f"the bus cannot be opened ({type(e).__name__}: {e})"

    def _say_lost(self, words: str) -> bool:
        """One turn without a bus; whether it was the last."""
        self._fault, now = words, self.clock.monotonic()
        self._obey(now)
        turn = self._situation()
        self._send(turn)
        self._slow_messages(now, turn)
        self.clock.sleep(PATIENCE)
        return self.stopping

    def close(self) -> None:
        """Say SHUTDOWN, release everything."""
        self._notify.say("STOPPING=1")
        turn = self._situation()
        none = {c: Numbers.none(self.model.n, "shut down") for c in turn.numbers}
        turn = Turn(State.SHUTDOWN, turn.flags | FALLBACK_IN_FORCE, "the monitor was stopped", none, turn.made_ns)
        self._send(turn)
        self.publisher.words("state/json", twin(self, turn), must_arrive=True)
        if self.recorder is not None:
            self.recorder.close()  # what it has found in the last moment is written and told too
            self._say_recorded(self.clock.monotonic())
        self.publisher.event("stopped")
        self.latch.close()
        self.remaining.close()
        self.desk.close()
        self.source.close()
