"""The workbench on http: one page, its state as JSON, the reports, and one way to start an action.

It has no log-in, so it listens on this machine only unless told otherwise, answers only to the name it was opened under, and
starts an action only for its own page: another site in the same browser knows neither the token nor may it send the header.
"""

from __future__ import annotations

import json
import secrets
from typing import Any
from urllib.parse import unquote

from stopset.errors import StopsetError
from stopset.offline.workbench.loop import Loop
from stopset.serving import Handler, PageServer, own_file

OPTIONS: dict[str, dict[str, Any]] = {
    "compare": {}, "diagnose": {}, "undo": {}, "stop": {}, "fmu": {}, "plan": {"decides": str},
    "add": {"effect": str, "joint": str | None, "force": bool}, "choose": {"files": list, "conditions": list},
}  # fmt: skip
HERE, SHARED = "stopset.offline.workbench", "stopset.serving"
FILES = {
    "/page.css": (HERE, "text/css; charset=utf-8"), "/page.js": (HERE, "text/javascript; charset=utf-8"),
    "/draw.js": (HERE, "text/javascript; charset=utf-8"), "/arm.js": (SHARED, "text/javascript; charset=utf-8"),
}  # fmt: skip
# a report is one file with its own script and policy inside; it may be looked at, not framed
REPORT = "frame-ancestors 'none'; connect-src 'none'; form-action 'none'"


class Server(PageServer):
    """Serves a `Loop` on ``http://host:port/``; port 0 takes a free one. Raises `BusError` where it cannot listen."""

    def __init__(self, loop: Loop, host: str, port: int) -> None:
        self.loop, self.token = loop, secrets.token_urlsafe(16)
        super().__init__(host, port, _WorkbenchHandler)


class _WorkbenchHandler(Handler):
    server: Server

    def get(self, path: str) -> None:
        loop = self.server.loop
        kind, _, name = path.removeprefix("/").partition("/")
        if path == "/":
            self.answer("text/html; charset=utf-8", own_file(HERE, "page.html").replace("@TOKEN@", self.server.token))
        elif path in FILES:
            package, what = FILES[path]
            self.answer(what, own_file(package, path[1:]))
        elif path == "/job":
            self.answer("application/json", json.dumps(loop.job(), allow_nan=False))
        elif path == "/state":
            self.answer("application/json", json.dumps(loop.snapshot(), allow_nan=False))
        elif kind == "report" and (html := loop.report(name)) is not None:
            self.answer("text/html; charset=utf-8", html, policy=REPORT)
        elif kind == "model" and (text := loop.model_text(name)) is not None:
            self.answer("application/json", text)
        elif kind == "fmu" and (data := loop.fmu(name)) is not None:
            self.answer("application/octet-stream", data)
        elif (kind == "partial" and (found := loop.partial(*unquote(name).partition("/")[::2])) is not None) or (
            kind == "scene" and (found := self._scene(name)) is not None
        ):
            self.answer("application/json", json.dumps(found, allow_nan=False))
        else:
            self.refuse(404, f"there is nothing at {path[:80]!r}; the page is at /")

    def _scene(self, name: str) -> dict[str, Any] | None:
        """``<label>``, or ``<label>/<from>/<to>/<other model or ->`` with times in s."""
        label, _, rest = name.partition("/")
        try:
            begin, end, beside = rest.split("/") if rest else ("0", "inf", "-")
            return self.server.loop.scene(unquote(label), float(begin), float(end), None if beside == "-" else int(beside))
        except ValueError:  # no numbers
            return None

    def post(self, path: str, body: dict[str, Any]) -> None:
        if not self.proves(self.server.token):
            self.refuse(403, "only the workbench's own page may start an action; reload it")
            return
        action = path.removeprefix("/do/")
        known = OPTIONS.get(action)
        if known is None:
            self.refuse(400, f"no action {action[:80]!r}; expected one of {', '.join(OPTIONS)}")
        elif any(k not in known or not isinstance(v, known[k]) for k, v in body.items()):
            self.refuse(400, f"options {str(body)[:200]}; {action} takes {', '.join(known) or 'none'}")
        elif action == "choose":
            self._choose(body)
        elif self.server.loop.start(action, **body):
            self.answer("application/json", b"{}")
        else:
            self.refuse(409, "another action is running; wait for its end")

    def _choose(self, body: dict[str, Any]) -> None:
        files, conditions = body.get("files", []), body.get("conditions", [])
        if not all(isinstance(k, int) for k in files) or not all(isinstance(c, str) for c in conditions):
            self.refuse(400, "files by number and conditions by text were expected; reload the page")
            return
        try:
            self.server.loop.choose(files, conditions)
        except StopsetError as e:
            self.refuse(400, str(e))
            return
        self.answer("application/json", b"{}")
