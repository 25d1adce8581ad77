"""The live page: static files and one stream of server-sent events."""

from __future__ import annotations

import json
import time
from importlib import resources

from stopset.monitor.viewer.view import View
from stopset.serving import Handler, PageServer

PERIOD = 0.05  # [s] between two looks that are sent
FILES = {
    "/": ("page.html", "text/html; charset=utf-8"), "/page.css": ("page.css", "text/css; charset=utf-8"),
    "/page.js": ("page.js", "text/javascript; charset=utf-8"), "/arm.js": ("arm.js", "text/javascript; charset=utf-8"),
}  # fmt: skip


class Page(PageServer):
    """The live page on ``http://host:port/``; raises `BusError` where it cannot be served."""

    def __init__(self, view: View, host: str, port: int) -> None:
        self.view = view
        super().__init__(host, port, _Handler)


class _Handler(Handler):
    server: Page

    def get(self, path: str) -> None:
        if path in FILES:
            name, kind = FILES[path]
            self.answer(kind, (resources.files("stopset.monitor.viewer") / name).read_bytes())
        elif path == "/now":
            self.answer("application/json", json.dumps(self.server.view.snapshot()))
        elif path == "/stream":
            self.head("text/event-stream")
            try:
                while True:
                    self.wfile.write(b"data: " + json.dumps(self.server.view.snapshot()).encode() + b"\n\n")
                    time.sleep(PERIOD)
            except OSError:
                return  # the browser went away
        else:
            self.refuse(404, f"there is nothing at {path[:80]!r}; the page is at /")
