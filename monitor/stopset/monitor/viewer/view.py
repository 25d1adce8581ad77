"""What is heard of a running monitor, from zenoh alone, checked and cleaned before anything is shown.

The viewer is a consumer like any other: silence, a wrong checksum or an old sequence number show as NO DATA. What a bus brings is
strangers' text: control sequences are taken out of it here, once, for the terminal and the page alike.
"""

from __future__ import annotations

import secrets
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, Any, TypeVar

import msgspec
import numpy as np

from stopset.artifact import Model
from stopset.artifact.store import model_of
from stopset.errors import ModelFileError
from stopset.monitor.clock import own_ns
from stopset.monitor.consumer import MS, SAYS, Consumer, Expected, Fault
from stopset.monitor.viewer.events import Event, Grouped
from stopset.monitor.viewer.words import cleaned

REMEMBERED = 12.0  # [s] of positions within their predictions, for a page that is opened later
SLOW = 2.0  # [s] without ``state/json`` before its content is withdrawn
LARGEST = 1 << 20  # bytes of any message in words


class _JointStop(msgspec.Struct):
    time_s: float | None
    forward_rad: float | None
    back_rad: float | None


class _Stop(msgspec.Struct):
    time_s: float | None
    tcp_m: float | None
    why: str
    joints: dict[str, _JointStop]
    capsules: list[Annotated[list[float], msgspec.Meta(min_length=7, max_length=7)]] | None = None


class _Violation(msgspec.Struct):
    joint: str
    samples: int
    state: str = ""
    side: str = ""
    unit: str = ""
    kind: str = ""
    excess: float = 0.0
    age_s: float = 0.0
    in_domain: bool = True


class _Tube(msgspec.Struct):
    lo: list[float | None]
    hi: list[float | None]


class _Margins(msgspec.Struct):
    certified: bool
    why: str = ""
    joint_limits_rad: dict[str, float | None] = {}
    time_s: float | None = None
    angle_rad: float | None = None
    tcp_m: float | None = None
    planes_m: dict[str, float | None] = {}


class _Cause(msgspec.Struct):
    says: str = ""


class Twin(msgspec.Struct):
    """What the displays need of ``state/json``; a message without it is not shown, and nothing else of it reaches them."""

    state: str
    why: str
    data_id: int
    joints: list[str]
    violations: list[_Violation]
    gaps: int
    room: dict[str, float] | None
    verdicts: dict[str, int]
    oldest_prediction_s: float
    notice: str
    stops: dict[str, _Stop]
    q: list[float] | None = None
    tube: _Tube | None = None
    margins: _Margins | None = None
    violation_class: str = ""
    violation_cause: _Cause | None = None
    model_sha256: str = ""
    config_sha256: str = ""
    guarantee: str = ""


_twin = msgspec.json.Decoder(Twin).decode
_event = msgspec.json.Decoder(Event).decode
_health = msgspec.json.Decoder(dict[str, Any]).decode
T = TypeVar("T")


@dataclass(slots=True)
class View:
    """The last thing heard; fed from zenoh's threads, read by the displays.

    ``expected``: whose messages are believed; None = the first that is heard, which is then said. ``ask`` sends a challenge.
    """

    watchdog_s: float = 0.5
    expected: Expected | None = None
    ask: Callable[[bytes], None] | None = None
    twin: dict[str, Any] | None = None
    twin_at: float = float("-inf")
    health: dict[str, Any] = field(default_factory=dict)
    events: Grouped = field(default_factory=Grouped)
    consumer: Consumer | None = None
    model: Model | None = None  # for the picture of the arm; whose numbers are believed is `expected`'s business
    past: deque[tuple[float, list[float], _Tube]] = field(default_factory=deque)  # when heard, positions, between which bounds
    garbled: int = 0  # messages in words that were none
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def _read(self, data: bytes, decode: Callable[[bytes], T]) -> T | None:
        """The message with clean words; None, and counted, where it is none."""
        try:
            if len(data) > LARGEST:
                raise ValueError("too long")
            found = decode(data)
            return msgspec.convert(cleaned(msgspec.to_builtins(found)), type(found))
        except (msgspec.MsgspecError, ValueError, RecursionError):
            self.garbled += 1
            return None

    def take_json(self, _key: str, data: bytes) -> None:
        """``state/json``."""
        twin = self._read(data, _twin)
        if twin is None:
            return
        with self._lock:
            if self.expected is not None and twin.data_id != self.expected.data_id:
                return
            self.twin, self.twin_at = msgspec.to_builtins(twin), time.monotonic()
            self._remember(twin)
            if self.consumer is None:
                expected = self.expected or Expected(twin.data_id, None, None, None)
                self.consumer = Consumer(expected, round(self.watchdog_s * 1e9))

    def _remember(self, twin: Twin) -> None:
        n = len(twin.joints)
        if twin.q is not None and twin.tube is not None and n == len(twin.q) == len(twin.tube.lo) == len(twin.tube.hi):
            self.past.append((self.twin_at, twin.q, twin.tube))
        while self.past and self.twin_at - self.past[0][0] > REMEMBERED:
            self.past.popleft()

    def traces(self) -> list[dict[str, Any]]:
        """The last seconds, oldest first: how long ago [s], positions and the bounds that were predicted for them [rad]."""
        with self._lock:
            now = time.monotonic()
            return [{"ago": round(now - at, 3), "q": q, "lo": tube.lo, "hi": tube.hi} for at, q, tube in self.past]

    def take_state(self, _key: str, data: bytes) -> None:
        """``state``."""
        with self._lock:
            if self.consumer is None and self.expected is not None:
                self.consumer = Consumer(self.expected, round(self.watchdog_s * 1e9))
            if self.consumer is not None:
                self.consumer.take(data, own_ns())

    def take_health(self, _key: str, data: bytes) -> None:
        """``health``."""
        self.health = self._read(data, _health) or self.health

    def take_event(self, _key: str, data: bytes) -> None:
        """``event``."""
        event = self._read(data, _event)
        if event is not None:
            with self._lock:
                self.events.take(event)

    @property
    def wants_model(self) -> bool:
        """Whether the model that is spoken of is not the one that is drawn."""
        with self._lock:
            reported = None if self.twin is None else self.twin["model_sha256"]
            return bool(reported) and (self.model is None or self.model.sha256 != reported)

    def take_model(self, data: bytes) -> None:
        """``model``: the answer to a query."""
        try:
            model = model_of(data, "the model that was heard")
        except ModelFileError:
            self.garbled += 1
            return
        with self._lock:
            if self.twin is not None and model.sha256 == self.twin["model_sha256"]:
                self.model = model

    def _arm(self) -> list[list[float]] | None:
        """Base, joints and flange in space [m], as they are now; None where model or pose is not known."""
        q = None if self.twin is None else self.twin["q"]
        m = self.model
        if m is None or q is None or len(q) != m.n or self.twin is None or m.sha256 != self.twin["model_sha256"]:
            return None
        points: list[list[float]] = m.robot.outline(np.array(q)).round(4).tolist()
        return points

    def challenge(self) -> None:
        """Ask for a sign of life when it is time."""
        with self._lock:
            nonce = self.consumer.challenge(own_ns(), secrets.randbits(64)) if self.consumer else None
        if nonce is not None and self.ask is not None:
            self.ask(nonce)

    def word(self) -> tuple[str, str]:
        """The state word and one sentence, as they hold now."""
        self.challenge()
        with self._lock:
            c = self.consumer
            if c is None:
                return "NO DATA", "nothing heard yet"
            now = own_ns()
            state = c.state(now)
            if c.why is Fault.SILENT:
                return "NO DATA", f"silent for {(now - c.arrived) / MS:.0f} ms"
            if c.why:
                return "NO DATA", SAYS[c.why]
            if self.twin is None or time.monotonic() - self.twin_at > SLOW:
                return state.name, "no words with it"
            why = str(self.twin["why"]) if self.twin["state"] == state.name else f"just now {state.name}"
            unverified = self.expected is None
            return state.name, why + (" (model and configuration not checked: no --config)" if unverified else "")

    def snapshot(self) -> dict[str, Any]:
        """Everything the page shows."""
        word, why = self.word()
        with self._lock:
            lost = self.consumer.lost if self.consumer else 0
            rejected = self.consumer.rejected if self.consumer else 0
            fresh = time.monotonic() - self.twin_at < SLOW
            return {
                "word": word,
                "why": why,
                "twin": self.twin,
                "fresh": fresh,
                "told": round(self.twin_at, 3) if self.twin else None,
                "health": self.health,
                "events": self.events.last(12),
                "arm": self._arm(),
                "lost": lost,
                "rejected": rejected,
            }
