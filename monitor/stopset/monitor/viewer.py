"""What a person sees of a running monitor, from zenoh alone: a terminal view, and a page with the same content.

The viewer is a consumer like any other: silence, a wrong checksum or an old sequence number show as NO DATA.
"""

from __future__ import annotations

import http.server
import json
import threading
import time
from dataclasses import dataclass, field
from importlib import resources
from typing import Any

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from stopset.monitor.consumer import Consumer

COLOURS = {"OK": "green", "DEGRADED": "yellow", "VIOLATION": "red", "UNKNOWN": "magenta", "FAULT": "red", "NO DATA": "red"}
SLOW = 2.0  # [s] without ``state/json`` before its content is withdrawn


@dataclass(slots=True)
class View:
    """The last thing heard; fed from zenoh's threads, read by the displays."""

    watchdog_s: float = 0.5
    twin: dict[str, Any] | None = None
    twin_at: float = float("-inf")
    health: dict[str, Any] = field(default_factory=dict)
    events: list[dict[str, Any]] = field(default_factory=list)
    consumer: Consumer | None = None
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def take_json(self, _key: str, data: bytes) -> None:
        twin = json.loads(data)
        with self._lock:
            self.twin, self.twin_at = twin, time.monotonic()
            if self.consumer is None or self.consumer.data_id != twin["data_id"]:
                self.consumer = Consumer(int(twin["data_id"]), self.watchdog_s)

    def take_state(self, _key: str, data: bytes) -> None:
        with self._lock:
            if self.consumer is not None:
                self.consumer.take(data, time.monotonic())

    def take_health(self, _key: str, data: bytes) -> None:
        self.health = json.loads(data)

    def take_event(self, _key: str, data: bytes) -> None:
        event = json.loads(data)
        event.pop("evidence", None)
        with self._lock:
            self.events = [*self.events[-49:], event]

    def word(self) -> tuple[str, str]:
        """The state word and one sentence, as they hold now."""
        now = time.monotonic()
        with self._lock:
            if self.consumer is None or self.twin is None:
                return "NO DATA", "nothing heard yet"
            state = self.consumer.state(now)
            if now - self.consumer.arrived > self.consumer.watchdog_s:
                return "NO DATA", self.consumer.why
            if now - self.twin_at > SLOW:
                return state.name, "no words with it"
            return state.name, str(self.twin["why"]) if self.twin["state"] == state.name else f"just now {state.name}"

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
