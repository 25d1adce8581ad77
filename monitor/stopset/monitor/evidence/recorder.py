"""The flight recorder beside the loop: keeps the last seconds, classes a violation, writes it down, records on if asked to.

The loop only copies a row and goes on; everything else happens in `Recorder.turn`, which a thread calls. Whatever the disk
does, the loop is not told but by a sentence.
"""

from __future__ import annotations

import contextlib
import os
import select
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from stopset.errors import StopsetError
from stopset.monitor.clock import Clock, SystemClock
from stopset.monitor.evidence import plausible
from stopset.monitor.evidence.bundle import BundleContents, Incident, span, write_bundle
from stopset.monitor.evidence.case import AFTER
from stopset.monitor.evidence.cause import UNCLASSED, Cause
from stopset.monitor.evidence.classify import classify
from stopset.monitor.evidence.dynamics import Dynamics
from stopset.monitor.evidence.running import Running
from stopset.monitor.evidence.trace import Trace, Window
from stopset.types import Array

if TYPE_CHECKING:
    from stopset.artifact import Model
    from stopset.monitor.config import Records
    from stopset.monitor.sample import Quantum, Sample
    from stopset.monitor.verdict import Deviation, Verdict

SILENCE = AFTER + 1.0  # [s] without a reading after which no more are waited for
PATIENCE = 30.0  # [s] in which the readings after a contradiction must have come, however slowly
HUNG = 10.0  # [s] without the end of a turn, which takes parts of one, then it is said
SWITCH = 5e-4  # [s] the loop waits at most for the interpreter while the recorder computes
WAITING = 8  # incidents and words that may wait; more are dropped, counted
SAID = frozenset({"event", "health", "state/json"})
PRIORITY = {"violation": 2, "fault": 3, "bundle": 4, "bus": 4, "journal": 3}  # of syslog; other events are notices


@dataclass(frozen=True, slots=True)
class Filed:
    """What came of an incident: its class, the file, its SHA-256; ``trouble``: why there is no file."""

    cause: Cause
    file: str = ""
    sha256: str = ""
    trouble: str = ""


@dataclass(slots=True)
class Recorder:
    """``settings``: what is kept and where (``folder``); ``about``: identity of arm, model and configuration for the files;
    ``heard``: gives the frames of the bus between two times as (time, identifier, bytes). ``answers``, and ``notes`` on what
    looks strange, are for the loop to take."""

    trace: Trace
    settings: Records
    folder: Path
    cycle_s: float
    about: Callable[[], Mapping[str, str]] = dict
    heard: Callable[[float, float], list[tuple[float, int, bytes]]] = lambda first, last: []
    clock: Clock = field(default_factory=SystemClock)
    pause: Callable[[], None] = lambda: time.sleep(2e-4)  # lets the loop have the interpreter
    answers: deque[Filed] = field(default_factory=lambda: deque(maxlen=WAITING))
    notes: deque[str] = field(default_factory=lambda: deque(maxlen=WAITING))
    trouble: str = ""
    dropped: int = 0
    files: int = 0
    _model: tuple[Model, Quantum] | None = None
    _dynamics: Dynamics | None = None
    _incidents: deque[Incident] = field(default_factory=deque)
    _words: deque[tuple[str, int, bytes]] = field(default_factory=deque)
    _running: Running | None = None
    _thread: threading.Thread | None = None
    _closing: bool = False
    _turned: float = float("inf")  # [s] when its thread had nothing to do last
    _next_look: float = float("-inf")
    _position: Array | None = None  # as it is kept
    _late_said: bool = False

    # ---- the loop's side: nothing here waits

    def watching(self, model: Model, quantum: Quantum) -> None:
        """The model that is watched with from now on."""
        self._model, self._dynamics = (model, quantum), None

    def take(self, s: Sample, v: Verdict, code: int, inputs: Any) -> None:
        self.trace.take(s, v, code, inputs)

    def incident(self, first: Deviation, t: float) -> None:
        """The sample taken last was outside its prediction; while one waits for what comes after it, its file holds this too."""
        if not self._incidents:
            self._incidents.append(Incident(self.trace.head - 1, first, t, self.clock.monotonic()))

    def overhear(self, name: str, data: bytes) -> None:
        """What is said on the slow keys."""
        if name in SAID:
            if self.clock.monotonic() - self._turned > HUNG:
                self.trouble = (
                    f"the recorder has been busy for over {HUNG:g} s: the disk of {self.folder} may not answer; look at it"
                )
            if len(self._words) >= 64 * WAITING:
                self.dropped += 1
                return
            self._words.append((name.removesuffix("/json"), self.clock.time_ns(), data))

    # ---- its own side

    def start(self) -> Recorder:
        """Its thread; without one somebody else calls `turn`."""
        sys.setswitchinterval(SWITCH)
        self._thread = threading.Thread(target=self._work, daemon=True, name="recorder")
        self._thread.start()
        return self

    def _work(self) -> None:
        while not self._closing:
            self._turned = self.clock.monotonic()
            try:
                self.turn()
            except Exception as e:  # noqa: BLE001 - the recorder's errors are its own: the loop lives on
                self.trouble = f"the recorder failed: {type(e).__name__}: {e}"
            time.sleep(0.05)

    def turn(self, *, last: bool = False) -> None:
        """Do what is due; ``last``: with what there is, because nothing more will come."""
        words = [self._words.popleft() for _ in range(len(self._words))]
        for name, _, data in words:
            if name == "event":
                self.dropped += not _to_journal(data)
        if self.settings.continuous and self._model is not None:
            if self._running is None:
                self._running = Running(self.folder, self.settings, self.trace.n, self.about)
            self.trouble = self._running.turn(self.trace, words, self._looking_back(), self._model[0].joints, self.pause)
        if self.trace.head and (last or self.clock.monotonic() >= self._next_look):
            self._look()
        while self._incidents:
            incident = self._incidents[0]
            due = last or self._whole(incident)
            if due or not incident.tried:
                self._write(incident, whole=due)
            if not due:
                break
            self._incidents.popleft()

    def _whole(self, incident: Incident) -> bool:
        """Whether all readings that its class needs are there, or no more are to be expected.

        A machine that has no time for us gives them late: as long as they come they are waited for.
        """
        now, head = self.clock.monotonic(), self.trace.head
        if head != incident.head:
            incident.head, incident.came = head, now
        enough = head - incident.row > round(AFTER / self.cycle_s)
        return enough or now - incident.came > SILENCE or now - incident.noticed > PATIENCE

    def _look(self) -> None:
        """Whether what was read of late is plausible, and where the arm is."""
        begun, self._next_look = self._next_look > float("-inf"), self.clock.monotonic() + plausible.EVERY
        w, model = (
            self.trace.window(self.trace.head - round(plausible.SPAN / self.cycle_s), self.trace.head),
            self._looking_back(),
        )
        if not len(w) or self._model is None:
            return
        if self.settings.violations:  # else nothing is written, and the next life knows of none before
            self._place(w.q[-1], self._model[0].joints, begun=begun)
        if model is not None and not self._late_said and (late := plausible.late_torque(w, model, self.pause)) is not None:
            self._late_said = True
            self.notes.append(plausible.late_words(late))

    def _place(self, q: Array, joints: tuple[str, ...], *, begun: bool) -> None:
        """Where the arm is, against where it was left; kept for the next life."""
        if not begun and (before := plausible.stored_position(self.folder)) is not None:
            self._position = before
            if words := plausible.moved_words(before, q, joints):
                self.notes.append(words)
        if self._position is None or len(self._position) != len(q) or np.any(np.abs(q - self._position) > plausible.MOVED / 5):
            plausible.keep_position(self.folder, q)
            self._position = q

    def _write(self, incident: Incident, *, whole: bool) -> None:
        """The bundle: at once with what there is, and once more with what came after."""
        assert self._model is not None
        model, back = self._looking_back(), max(self.settings.before_s, incident.first.age + 0.1)
        w = self.trace.window(incident.row - round(back / self.cycle_s), incident.row + 1 + round(AFTER / self.cycle_s))
        at = len(w) - 1 - max(0, min(self.trace.head, incident.row + 1 + round(AFTER / self.cycle_s)) - 1 - incident.row)
        cause = self._cause(w, at, incident.first, model) if whole else UNCLASSED
        incident.tried, digest = True, ""
        try:
            if self.settings.violations:
                contents = BundleContents(incident, cause, w, model, self._model[0].joints, self.heard(*span(w)))
                incident.written, digest = write_bundle(self.folder, self.settings.keep_mb, contents, self.about(), self.pause)
                self.files += whole
            answer = Filed(cause, str(incident.written or ""), digest)
            self.trouble = ""
        except (OSError, StopsetError) as e:
            self.trouble = f"the violation could not be written to {self.folder} ({e}); what was published of it is all there is"
            answer = Filed(cause, trouble=self.trouble)
        if whole:
            self.answers.append(answer)

    def _cause(self, w: Window, at: int, first: Deviation, model: Dynamics | None) -> Cause:
        if model is None or not 0 <= at < len(w):
            return UNCLASSED
        try:
            return classify(w, at, model.joints.index(first.joint), first.state, model, self.pause)
        except (ArithmeticError, ValueError, IndexError) as e:  # of strange readings: the violation stays what it is
            self.trouble = f"the violation could not be classed ({type(e).__name__}: {e})"
            return UNCLASSED

    def _looking_back(self) -> Dynamics | None:
        """None for a model that is not linear: then there is no tube that fits every start."""
        if self._dynamics is None and self._model is not None:
            w = self.trace.window(self.trace.head - self.trace.capacity, self.trace.head)
            known = w.du[np.isfinite(w.du).all(axis=1)]
            du = known.max(axis=0) if len(known) else np.zeros(self.trace.n)
            with contextlib.suppress(StopsetError):
                self._dynamics = Dynamics.of(*self._model, du)
        return self._dynamics

    def close(self) -> None:
        """Write what waits."""
        self._closing = True
        if self._thread is not None:
            self._thread.join(timeout=5.0)
            if self._thread.is_alive():  # held by a disk that hangs, which would hold whoever turns to it too
                return
        with contextlib.suppress(Exception):  # nobody is left to be told
            self.turn(last=True)
            if self._running is not None:
                self._running.close()


def _to_journal(data: bytes) -> bool:
    """One line to the system's journal, which reads standard error; under systemd the number in front is its priority.

    False if it was left out, because nobody has read the lines before: the recorder waits for no reader.
    """
    try:
        if not select.select([], [sys.stderr], [], 0.0)[1]:
            return False
    except (OSError, ValueError, TypeError):  # no file of the system's
        pass
    try:
        event = msgspec.json.decode(data)
        kind = str(event.get("kind"))
        said = {k: v for k, v in event.items() if k not in ("kind", "evidence", "evidence_columns", "t_ns", "seq")}
        mark = f"<{PRIORITY.get(kind, 5)}>" if "JOURNAL_STREAM" in os.environ else ""
        line = f"{mark}stopset {kind} {msgspec.json.encode(said).decode()[:2000]}\n"
        sys.stderr.write(line)  # shorter than what a pipe that takes anything takes at once
        sys.stderr.flush()
    except (OSError, ValueError, msgspec.MsgspecError):
        pass  # nobody reads it
    return True
