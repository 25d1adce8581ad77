"""What a person sees of a running monitor, from zenoh alone: a terminal view, and a page with the same content.

The viewer is a consumer like any other: silence, a wrong checksum or an old sequence number show as NO DATA.
"""

from __future__ import annotations

import http.server
import json
import secrets
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import resources
from typing import Any

import msgspec
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from stopset.monitor.consumer import MS, SAYS, Consumer, Doubt, Expected

COLOURS = {"OK": "green", "DEGRADED": "yellow", "VIOLATION": "red", "UNKNOWN": "magenta", "FAULT": "red", "NO DATA": "red"}
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


class _Violation(msgspec.Struct):
    joint: str
    samples: int


class Twin(msgspec.Struct):
    """What the displays need of ``state/json``; a message without it is not shown."""

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


class _Event(msgspec.Struct):
    kind: str
    why: str = ""


_is_twin = msgspec.json.Decoder(Twin).decode
_is_event = msgspec.json.Decoder(_Event).decode


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
    events: list[dict[str, Any]] = field(default_factory=list)
    consumer: Consumer | None = None
    garbled: int = 0  # messages in words that were none
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def _read(self, data: bytes, check: Callable[[bytes], Any]) -> dict[str, Any] | None:
        try:
            if len(data) > LARGEST:
                raise ValueError("too long")
            check(data)
            read: dict[str, Any] = msgspec.json.decode(data, type=dict[str, Any])
            return read
        except (msgspec.MsgspecError, ValueError, RecursionError):
            self.garbled += 1
            return None

    def take_json(self, _key: str, data: bytes) -> None:
        """``state/json``."""
        twin = self._read(data, _is_twin)
        if twin is None:
            return
        with self._lock:
            if self.expected is not None and twin["data_id"] != self.expected.data_id:
                return
            self.twin, self.twin_at = twin, time.monotonic()
            if self.consumer is None:
                expected = self.expected or Expected(twin["data_id"], None, None, None)
                self.consumer = Consumer(expected, round(self.watchdog_s * 1e9))

    def take_state(self, _key: str, data: bytes) -> None:
        """``state``."""
        with self._lock:
            if self.consumer is None and self.expected is not None:
                self.consumer = Consumer(self.expected, round(self.watchdog_s * 1e9))
            if self.consumer is not None:
                self.consumer.take(data, time.monotonic_ns())

    def take_health(self, _key: str, data: bytes) -> None:
        """``health``."""
        self.health = self._read(data, len) or self.health

    def take_event(self, _key: str, data: bytes) -> None:
        """``event``."""
        event = self._read(data, _is_event)
        if event is None:
            return
        event.pop("evidence", None)
        with self._lock:
            self.events = [*self.events[-49:], event]

    def challenge(self) -> None:
        """Ask for a sign of life when it is time."""
        with self._lock:
            nonce = self.consumer.challenge(time.monotonic_ns(), secrets.randbits(64)) if self.consumer else None
        if nonce is not None and self.ask is not None:
            self.ask(nonce)

    def word(self) -> tuple[str, str]:
        """The state word and one sentence, as they hold now."""
        self.challenge()
        with self._lock:
            c = self.consumer
            if c is None:
                return "NO DATA", "nothing heard yet"
            now = time.monotonic_ns()
            state = c.state(now)
            if c.why is Doubt.SILENT:
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
                "health": self.health,
                "events": self.events[-12:],
                "lost": lost,
                "rejected": rejected,
            }


def _number(x: float | None, unit: str, factor: float = 1.0, digits: int = 0) -> str:
    return "not provable" if x is None else f"{x * factor:.{digits}f} {unit}"


def terminal(view: View) -> RenderableType:
    """The terminal view: state word, stop distances, one row per joint, last events."""
    word, why = view.word()
    shot = view.snapshot()
    twin = shot["twin"]
    head = Text(f" {word} ", style=f"bold white on {COLOURS.get(word, 'blue')}")
    rows: list[RenderableType] = [head, Text(why)]
    if twin is None:
        return Group(*rows)
    stops = twin["stops"] if shot["fresh"] and word != "NO DATA" else {}
    for category, s in stops.items():
        rows.append(
            Text(
                f"STOP {category:<13} {_number(s['time_s'], 'ms', 1e3):>14} {_number(s['tcp_m'], 'mm', 1e3):>14}  {s['why'][:90]}"
            )
        )
    table = Table(box=None, pad_edge=False)
    for title in ("joint", "room", "STOP 0 time", "STOP 0 angle", "violations"):
        table.add_column(title)
    bad = {j: sum(v["samples"] for v in twin["violations"] if v["joint"] == j) for j in twin["joints"]}
    for j in twin["joints"]:
        room = (twin["room"] or {}).get(j)
        here = stops.get("0", {}).get("joints", {}).get(j, {})
        angle = max((x for x in (here.get("forward_rad"), here.get("back_rad")) if x is not None), default=None)
        filled = 0 if room is None else max(0, min(20, round(20 * room)))
        table.add_row(
            j,
            "" if room is None else f"{'█' * filled:<20} {room:5.2f}",
            _number(here.get("time_s"), "ms", 1e3),
            _number(angle, "deg", 57.29577951308232, 2),
            Text(str(bad[j]), style="bold red" if bad[j] else ""),
        )
    rows.append(table)
    counts = ", ".join(f"{v} {k.lower()}" for k, v in twin["verdicts"].items() if v)
    rows.append(
        Text(
            f"{counts}; {twin['gaps']} gaps; oldest prediction {twin['oldest_prediction_s']:.2f} s; {shot['lost']} messages lost"
        )
    )
    rows += [Text(f"{e['kind']}: {e.get('why', '')}"[:110], style="dim") for e in shot["events"][-4:]]
    rows.append(Text(twin["notice"], style="dim italic"))
    return Group(*rows)


class Page(http.server.ThreadingHTTPServer):
    """The live page on ``http://host:port/``: static HTML and one stream of server-sent events."""

    daemon_threads = True

    def __init__(self, view: View, host: str, port: int) -> None:
        self.view = view
        super().__init__((host, port), _Handler)

    def start(self) -> None:
        threading.Thread(target=self.serve_forever, daemon=True, name="page").start()


class _Handler(http.server.BaseHTTPRequestHandler):
    server: Page

    def do_GET(self) -> None:
        if self.path == "/":
            self._answer("text/html; charset=utf-8", (resources.files("stopset.monitor") / "page.html").read_bytes())
        elif self.path == "/now":
            self._answer("application/json", json.dumps(self.server.view.snapshot()).encode())
        elif self.path == "/stream":
            self.send_response(200)
            self.send_header("Content-Type", "text/event-stream")
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            try:
                while True:
                    self.wfile.write(b"data: " + json.dumps(self.server.view.snapshot()).encode() + b"\n\n")
                    time.sleep(0.2)
            except OSError:
                return  # the browser went away
        else:
            self.send_error(404)

    def _answer(self, kind: str, body: bytes) -> None:
        self.send_response(200)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        """Quiet: the terminal belongs to the view."""
