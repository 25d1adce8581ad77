"""The fleet as a page: one tile per arm, static files and one stream of server-sent events."""

from __future__ import annotations

import json
import time
from typing import Any

from stopset.monitor.fleet.fleet import Fleet
from stopset.serving import Handler, PageServer, own_file

PERIOD = 0.2  # [s] between two looks that are sent
HERE = "stopset.monitor.fleet"
FILES = {
    "/": ("page.html", "text/html; charset=utf-8"), "/page.css": ("page.css", "text/css; charset=utf-8"),
    "/page.js": ("page.js", "text/javascript; charset=utf-8"),
}  # fmt: skip


class FleetPage(PageServer):
    """The fleet's page on ``http://host:port/``; raises `BusError` where it cannot be served."""

    def __init__(self, fleet: Fleet, host: str, port: int) -> None:
        self.fleet = fleet
        super().__init__(host, port, _FleetHandler)


class _FleetHandler(Handler):
    server: FleetPage

    def get(self, path: str) -> None:
        if path in FILES:
            name, kind = FILES[path]
            self.answer(kind, own_file(HERE, name))
        elif path == "/now":
            self.answer("application/json", self._shot())
        elif path == "/stream":
            self.head("text/event-stream")
            try:
                while True:
                    self.wfile.write(b"data: " + self._shot().encode() + b"\n\n")
                    time.sleep(PERIOD)
            except OSError:
                return  # the browser went away
        else:
            self.refuse(404, f"there is nothing at {path[:80]!r}; the page is at /")

    def _shot(self) -> str:
        shot: dict[str, Any] = self.server.fleet.snapshot()
        return json.dumps(shot, allow_nan=False)
