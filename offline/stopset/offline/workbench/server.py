"""The workbench on http: one page, its state as JSON, the reports, and one way to start an action.

It has no log-in, so it listens on this machine only unless told otherwise, answers only to the name it was opened under, and
starts an action only for its own page: another site in the same browser knows neither the token nor may it send the header.
"""

from __future__ import annotations

import http.server
import json
import secrets
import threading
from importlib import resources
from typing import Any
from urllib.parse import urlsplit

from stopset.errors import BusError
from stopset.offline.workbench.loop import ACTIONS, Loop

LONGEST = 4096  # [byte] of a request's body: an action with its options is far shorter
OPTIONS = {"compare": {}, "diagnose": {}, "add": {"effect": str, "joint": str | None, "force": bool}}


class Server(http.server.ThreadingHTTPServer):
    """Serves a `Loop` on ``http://host:port/``; port 0 takes a free one. Raises `BusError` where it cannot listen."""

    daemon_threads = True

    def __init__(self, loop: Loop, host: str, port: int) -> None:
        self.loop, self.token = loop, secrets.token_urlsafe(16)
        try:
            super().__init__((host, port), _Handler)
        except (OSError, OverflowError) as e:  # taken, not ours, or no port number at all
            raise BusError(f"the page cannot be served on {host}:{port} ({e}); choose another --host or --port") from e
        here = int(self.server_address[1])
        self.url = f"http://{host}:{here}/"
        self.names = {f"{name}:{here}" for name in {host, "localhost", "127.0.0.1"}}

    def start(self) -> None:
        threading.Thread(target=self.serve_forever, daemon=True, name="workbench").start()


class _Handler(http.server.BaseHTTPRequestHandler):
    server: Server

    def do_GET(self) -> None:
        path = urlsplit(self.path).path
        if self.headers.get("Host") not in self.server.names:
            self._refuse(403, f"this page answers to {self.server.url} only")
        elif path == "/":
            page = (resources.files("stopset.offline.workbench") / "page.html").read_text(encoding="utf-8")
            self._answer("text/html; charset=utf-8", page.replace("@TOKEN@", self.server.token).encode())
        elif path == "/state":
            self._answer("application/json", json.dumps(self.server.loop.snapshot(), allow_nan=False).encode())
        elif path.startswith("/report/") and (html := self.server.loop.report(path.removeprefix("/report/"))) is not None:
            self._answer("text/html; charset=utf-8", html.encode())
        else:
            self._refuse(404, f"there is nothing at {path}")

    def do_POST(self) -> None:
        if self.headers.get("Host") not in self.server.names or not secrets.compare_digest(
            self.headers.get("X-Workbench", ""), self.server.token
        ):
            self._refuse(403, "only the workbench's own page may start an action; reload it")
            return
        try:
            action, options = self._request()
        except ValueError as e:
            self._refuse(400, str(e))
            return
        if self.server.loop.start(action, **options):
            self._answer("application/json", b"{}")
        else:
            self._refuse(409, "another action is running; wait for its end")

    def _request(self) -> tuple[str, dict[str, Any]]:
        """The action and its options; raises `ValueError` with the sentence to send back."""
        action = urlsplit(self.path).path.removeprefix("/do/")
        if action not in ACTIONS:
            raise ValueError(f"no action {action!r}; expected one of {', '.join(ACTIONS)}")
        length = self.headers.get("Content-Length", "0")
        if not length.isdecimal() or int(length) > LONGEST:
            raise ValueError(f"a body of {length} bytes; expected at most {LONGEST}")
        options = json.loads(self.rfile.read(int(length)) or b"{}")
        known = OPTIONS[action]
        if not isinstance(options, dict) or any(k not in known or not isinstance(v, known[k]) for k, v in options.items()):
            raise ValueError(f"options {options!r}; {action} takes {', '.join(known) or 'none'}")
        return action, options

    def _answer(self, kind: str, body: bytes, code: int = 200) -> None:
        self.send_response(code)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(body)

    def _refuse(self, code: int, why: str) -> None:
        self._answer("text/plain; charset=utf-8", why.encode(), code)

    def log_message(self, format: str, *args: Any) -> None:
        """Quiet: the terminal tells what the actions do."""
