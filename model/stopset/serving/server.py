"""What every page that stopset serves holds to: who may ask, what the browser may run, how long a request may be.

A page without a log-in is safe from other sites in the same browser only where it answers to its own name (a foreign name that
points here is DNS rebinding), to its own origin, and runs no script but its own files.
"""

from __future__ import annotations

import http.server
import ipaddress
import json
import secrets
import socket
import sys
import threading
from importlib import resources
from typing import Any
from urllib.parse import urlsplit

from stopset.errors import BusError

LONGEST = 4096  # [byte] of a request's body: an order with its options is far shorter
PATIENCE = 10.0  # [s] for a request to arrive
STRANGER = "another site asks; only the page's own origin is answered: open it in a tab of its own"
CONNECTIONS = 64  # served at once; a page takes two
# script and style from the page's own files alone: what came over a bus or stands in a file cannot become either
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
ALWAYS = (
    ("X-Content-Type-Options", "nosniff"), ("Referrer-Policy", "no-referrer"), ("X-Frame-Options", "DENY"),
    ("Cross-Origin-Resource-Policy", "same-origin"), ("Cache-Control", "no-store"),
)  # fmt: skip


class PageServer(http.server.ThreadingHTTPServer):
    """Serves ``handler`` on ``http://host:port/``; port 0 takes a free one. Raises `BusError` where it cannot listen."""

    daemon_threads = True

    def __init__(self, host: str, port: int, handler: type[Handler]) -> None:
        try:
            super().__init__((host, port), handler)
        except (OSError, OverflowError) as e:  # taken, not ours, or no port number at all
            raise BusError(f"the page cannot be served on {host}:{port} ({e}); choose another --host or --port") from e
        self.host, self.port = host, int(self.server_address[1])
        self.url = f"http://{host}:{self.port}/"
        self._room = threading.BoundedSemaphore(CONNECTIONS)

    def start(self) -> None:
        """Answer in the background from now on."""
        threading.Thread(target=self.serve_forever, daemon=True, name="page").start()

    def process_request(self, request: Any, client_address: Any) -> None:
        """As the library does it, for `CONNECTIONS` at once: more are closed unread."""
        if self._room.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._room.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """One line: a browser that went away is no news, anything else is not worth a traceback to who reads the terminal."""
        error = sys.exc_info()[1]
        if not isinstance(error, OSError):
            sys.stderr.write(f"stopset: a request to {self.url} failed inside ({type(error).__name__})\n")


class Handler(http.server.BaseHTTPRequestHandler):
    """Answers whom it may; a subclass gives `get` and `post`. Every refusal is one sentence of plain text."""

    timeout = PATIENCE
    server: PageServer
    server_version, sys_version = "stopset", ""

    def get(self, path: str) -> None:
        """Answer a question at ``path``."""
        raise NotImplementedError

    def post(self, path: str, body: dict[str, Any]) -> None:
        """Carry out an order with its options."""
        self.refuse(405, f"nothing can be ordered at {path}; this page only shows")

    def do_GET(self) -> None:
        if self._welcome():
            self.get(urlsplit(self.path).path)

    def do_POST(self) -> None:
        if not self._welcome():
            return
        try:
            body = self._body()
        except ValueError as e:
            self.refuse(400, str(e))
            return
        self.post(urlsplit(self.path).path, body)

    def _welcome(self) -> bool:
        """Whether the request names this server and comes from its own page, or from none; refused otherwise."""
        hosts, origins = self.headers.get_all("Host", []), self.headers.get_all("Origin", [])
        if len(hosts) != 1 or hosts[0].lower() not in self._names():
            self.refuse(403, f"this page answers to {self.server.url} only; open it under that name")
            return False
        if any(o.lower() != f"http://{hosts[0].lower()}" for o in origins):
            self.refuse(403, STRANGER)
            return False
        # a picture or script element of another site sends no origin, but browsers tell where it stands; a link may be followed
        site, mode = self.headers.get("Sec-Fetch-Site", "none"), self.headers.get("Sec-Fetch-Mode", "")
        if site not in ("none", "same-origin") and not (mode == "navigate" and self.command == "GET"):
            self.refuse(403, STRANGER)
            return False
        return True

    def _names(self) -> set[str]:
        """The names this connection may be asked under: the one given, the address it came to, this machine's own for loopback."""
        here = str(self.connection.getsockname()[0])
        names = {self.server.host.lower(), f"[{here}]" if ":" in here else here}
        if ipaddress.ip_address(here.partition("%")[0]).is_loopback:
            names.add("localhost")
        return {f"{name}:{self.server.port}" for name in names} | (names if self.server.port == 80 else set())

    def proves(self, token: str) -> bool:
        """Whether an order carries the token that the page was given; a token of odd letters is wrong, not an error."""
        given = self.headers.get("X-Stopset-Token", "").encode("latin-1", "replace")
        return bool(token) and secrets.compare_digest(given, token.encode())

    def _body(self) -> dict[str, Any]:
        """The options of an order; raises `ValueError` with the sentence to send back."""
        length = self.headers.get("Content-Length", "0")
        if not (length.isascii() and length.isdecimal() and len(length) < 10 and int(length) <= LONGEST):
            raise ValueError(f"a body of {length[:20]!r} bytes; expected at most {LONGEST}: send a shorter one")
        if self.headers.get("Transfer-Encoding"):
            raise ValueError("a body in pieces; expected one with its length: send Content-Length")
        try:
            text = self.rfile.read(int(length)).decode("utf-8")
        except UnicodeDecodeError as e:
            raise ValueError(f"a body that is no UTF-8 at byte {e.start}; expected JSON: send text") from e
        try:
            options = json.loads(text or "{}")
        except json.JSONDecodeError as e:
            raise ValueError(f"a body that is no JSON ({e.msg} at letter {e.pos}); expected an object of options: mend it") from e
        except RecursionError as e:
            raise ValueError("a body that is nested without end; expected a flat object of options: mend it") from e
        if not isinstance(options, dict):
            raise ValueError(f"a body that is {type(options).__name__}; expected an object of options: mend it")
        return options

    def answer(self, kind: str, body: bytes | str, code: int = 200, policy: str = POLICY) -> None:
        """Send ``body`` whole."""
        data = body.encode() if isinstance(body, str) else body
        self.head(kind, code, policy, len(data))
        self.wfile.write(data)

    def head(self, kind: str, code: int = 200, policy: str = POLICY, length: int | None = None) -> None:
        """Status and headers; without ``length`` the answer goes on until someone hangs up."""
        self.send_response(code)
        for name, value in (("Content-Type", kind), ("Content-Security-Policy", policy), *ALWAYS):
            self.send_header(name, value)
        if length is not None:
            self.send_header("Content-Length", str(length))
        self.end_headers()

    def refuse(self, code: int, why: str) -> None:
        """A sentence instead of an answer; what was not read of the request is not taken for the next one."""
        self.close_connection = True
        self.answer("text/plain; charset=utf-8", why.encode("utf-8", "replace"), code)

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """What the library finds wrong with a request (its line, its headers, its method), in the same way."""
        if getattr(self, "request_version", "HTTP/0.9") == "HTTP/0.9":  # it understood nothing: answer in a version with headers
            self.request_version = "HTTP/1.0"
        self.refuse(code, f"this request cannot be read ({message or code}); expected GET or POST over HTTP/1.1: ask again")

    def log_message(self, format: str, *args: Any) -> None:
        """Quiet: the terminal belongs to the command."""


def own_file(package: str, name: str) -> str:
    """A text file that lies beside the modules of ``package``."""
    return (resources.files(package) / name).read_text(encoding="utf-8")


def loopback(host: str) -> bool:
    """Whether ``host`` is this machine alone; a name that cannot be looked up is not."""
    try:
        found = socket.getaddrinfo(host, None)
    except (OSError, UnicodeError):
        return False
    return all(ipaddress.ip_address(str(address[0]).partition("%")[0]).is_loopback for *_, address in found)
