"""The live page: static files and one stream of server-sent events."""

from __future__ import annotations

import html
import json
import secrets
import time
from collections.abc import Callable
from typing import Any

from stopset.errors import StopsetError
from stopset.monitor.viewer.view import View
from stopset.monitor.viewer.words import plain
from stopset.serving import Handler, PageServer, own_file

PERIOD = 0.05  # [s] between two looks that are sent
HERE, SHARED = "stopset.monitor.viewer", "stopset.serving"
FILES = {
    "/": (HERE, "page.html", "text/html; charset=utf-8"), "/page.css": (HERE, "page.css", "text/css; charset=utf-8"),
    "/page.js": (HERE, "page.js", "text/javascript; charset=utf-8"), "/arm.js": (SHARED, "arm.js", "text/javascript; charset=utf-8"),
}  # fmt: skip


class ViewerPage(PageServer):
    """The live page on ``http://host:port/``; raises `BusError` where it cannot be served.

    ``order``: sends an order to clear the latch, given the reason; None: the page only shows. ``who``: in whose name, as said beside it.
    """

    def __init__(self, view: View, host: str, port: int, order: Callable[[str], None] | None = None, who: str = "") -> None:
        self.view, self.order, self.who, self.token = view, order, plain(who), secrets.token_urlsafe(16) if order else ""
        super().__init__(host, port, _ViewerHandler)


class _ViewerHandler(Handler):
    server: ViewerPage

    def get(self, path: str) -> None:
        if path in FILES:
            package, name, kind = FILES[path]
            text = own_file(package, name)
            if path == "/":
                text = text.replace("@TOKEN@", self.server.token).replace("@WHO@", html.escape(self.server.who))
            self.answer(kind, text)
        elif path == "/now":
            view = self.server.view
            self.answer("application/json", json.dumps(view.snapshot() | {"past": view.traces()}))
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

    def post(self, path: str, body: dict[str, Any]) -> None:
        server, reason = self.server, body.get("reason")
        if path != "/reset" or server.order is None:
            self.refuse(
                405,
                "this page only shows; start `stopset watch` with --reset-as NAME or --reset-key FILE, or use `stopset reset`",
            )
        elif not self.proves(server.token):
            self.refuse(403, "only the page itself may give an order; reload it")
        elif set(body) != {"reason"} or not isinstance(reason, str):
            self.refuse(400, "expected the reason alone: say why it may be cleared")
        else:
            try:
                server.order(reason)
            except StopsetError as e:
                self.refuse(400, str(e))
                return
            self.answer("application/json", b"{}")
