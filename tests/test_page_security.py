"""Pages and their servers among strangers: other sites in the same browser, names that point here, and text that came over a bus."""

from __future__ import annotations

import contextlib
import http.client
import io
import itertools
import json
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import patience
from state_messages import pack
from stopset.monitor.layout import State
from stopset.monitor.viewer import View, ViewerPage, terminal
from stopset.offline.workbench import Loop, Server

EVIL = "<img src=x onerror=document.body.id='ran'><script>document.body.id='ran'</script>"
ESCAPES = "\x1b]0;owned\x07\x1b[2J\x1b[31m\x9b5mseen\u202etxet\x00\r\n"


def twin(text: str, samples: Any = 3) -> dict[str, Any]:
    """A message of the daemon's with ``text`` wherever text may stand."""
    return {
        "state": "VIOLATION", "why": text, "data_id": 1, "joints": [text, "b"], "gaps": 0, "room": {text: 0.1}, "verdicts": {text: 3},
        "violations": [{"joint": text, "samples": samples, "state": text, "side": text, "unit": text, "kind": text, "excess": 0.1}],
        "margins": {"certified": True, "joint_limits_rad": {text: 0.1}, "planes_m": {text: 0.2}}, "violation_class": text,
        "violation_cause": {"says": text}, "oldest_prediction_s": 0.4, "notice": text, "model_sha256": text, "config_sha256": text, "guarantee": text,
        "stops": {text: {"time_s": None, "tcp_m": None, "why": text, "joints": {text: {"time_s": 1, "forward_rad": 1, "back_rad": 1}}}},
    }  # fmt: skip


class Alive:
    """A daemon that answers every challenge and says its ``state`` whenever it is asked to; ``view`` believes it."""

    def __init__(self, state: State) -> None:
        self.state, self.words, self._seq, self._nonce = state, b"", itertools.count(1), 0
        self.view = View(watchdog_s=60.0, ask=self.speak)

    def speak(self, nonce: bytes = b"") -> None:
        """The next state message, with the answer to the last challenge; and the words, where there are any."""
        if self.words:
            self.view.take_json("", self.words)
        self._nonce, now = int.from_bytes(nonce, "little") or self._nonce, time.time_ns()
        self.view.take_state("", pack({
            "data_id": 1, "boot_id": 3, "state": int(self.state), "valid_for_ms": 60_000, "seq": next(self._seq),
            "nonces": (self._nonce,), "t_meas_ns": now, "t_pub_ns": now}))  # fmt: skip


def heard(text: str) -> View:
    """A view that believes a living daemon, whose every word is ``text``."""
    view = Alive(State.VIOLATION).view
    view.take_json("", json.dumps(twin(text)).encode())
    view.take_event(
        "", json.dumps({"kind": text, "why": text, "t_ns": 5, "signals": [text], "name": text, "reason": text}).encode()
    )
    view.take_health("", json.dumps({"bus": {text: text}, text: text, "cycles_in_window": text}).encode())
    view.challenge()
    return view


@pytest.fixture
def watch(monkeypatch: pytest.MonkeyPatch) -> Iterator[ViewerPage]:
    # its words are told once, and a busy browser takes seconds to show them
    monkeypatch.setattr("stopset.monitor.viewer.view.SLOW", 60.0)
    page = ViewerPage(heard(EVIL), "127.0.0.1", 0)
    page.start()
    yield page
    page.shutdown()
    page.server_close()


@pytest.fixture
def workbench(planar: Any, tmp_path: Path) -> Iterator[Server]:
    s = Server(Loop(planar[0] / "m.model.json", [planar[0] / "rec.parquet"], tmp_path), "127.0.0.1", 0)
    s.start()
    yield s
    s.shutdown()
    s.server_close()
    s.loop.close()


@pytest.fixture(params=["watch", "workbench"])
def served(request: pytest.FixtureRequest) -> ViewerPage | Server:
    page: ViewerPage | Server = request.getfixturevalue(request.param)
    return page


def raw(server: ViewerPage | Server, request: bytes) -> bytes:
    """What the server sends back to these very bytes, until it hangs up."""
    with socket.create_connection(("127.0.0.1", server.server_address[1]), timeout=5) as s:
        s.sendall(request)
        out = b""
        while part := s.recv(65536):
            out += part
            if b"\r\n\r\n" in out and b"event-stream" in out:
                break
        return out


def ask(server: ViewerPage | Server, path: str, **headers: str) -> bytes:
    lines = [f"GET {path} HTTP/1.1", *(f"{k}: {v}" for k, v in headers.items()), "Connection: close", "", ""]
    return raw(server, "\r\n".join(lines).encode("latin-1"))


def own(server: ViewerPage | Server) -> str:
    return f"127.0.0.1:{server.server_address[1]}"


def paths(server: ViewerPage | Server) -> list[str]:
    return ["/", "/now", "/stream", "/page.js"] if isinstance(server, ViewerPage) else ["/", "/state", "/page.js", "/model/0"]


def test_only_the_own_name_is_answered(served: ViewerPage | Server) -> None:
    """A foreign name that points to this machine (DNS rebinding) gets nothing, not even the state."""
    port = served.server_address[1]
    for path in paths(served):
        for host in (
            f"evil.example:{port}",
            "evil.example",
            f"127.0.0.1.evil.example:{port}",
            f"127.0.0.1:{port + 1}",
            "",
            f"10.0.0.1:{port}",
        ):
            got = ask(served, path, Host=host)
            assert b" 403 " in got.splitlines()[0] and b"answers to http://127.0.0.1" in got, (path, host, got[:80])
            assert b"VIOLATION" not in got and b"sha256" not in got
        assert b" 403 " in ask(served, path).splitlines()[0], "no name at all"
        assert b" 403 " in raw(served, f"GET {path} HTTP/1.1\r\nHost: {own(served)}\r\nHost: evil.example\r\n\r\n".encode())
        for host in (own(served), f"localhost:{port}", f"LOCALHOST:{port}"):
            assert b" 200 " in ask(served, path, Host=host).splitlines()[0]


def test_only_the_own_origin_is_answered(served: ViewerPage | Server) -> None:
    for path in paths(served):
        for origin in ("http://evil.example", "null", f"https://{own(served)}", "http://127.0.0.1", "file://"):
            got = ask(served, path, Host=own(served), Origin=origin)
            assert b" 403 " in got.splitlines()[0] and b"another site" in got, (path, origin)
        assert b" 200 " in ask(served, path, Host=own(served), Origin=f"http://{own(served)}").splitlines()[0]


def test_elements_of_other_sites_are_not_answered(served: ViewerPage | Server) -> None:
    """A script or picture element sends no origin; the browser tells all the same whose it is. A link may be followed."""
    for path in paths(served):
        for site in ("cross-site", "same-site", "odd"):
            fetch = {"Host": own(served), "Sec-Fetch-Site": site}
            assert b" 403 " in ask(served, path, **fetch, **{"Sec-Fetch-Mode": "no-cors"}).splitlines()[0]
            assert b" 403 " in ask(served, path, **fetch).splitlines()[0]
        fetch = {"Host": own(served), "Sec-Fetch-Site": "same-origin", "Sec-Fetch-Mode": "cors"}
        assert b" 200 " in ask(served, path, **fetch).splitlines()[0]
    link = {"Host": own(served), "Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate"}
    assert b" 200 " in ask(served, "/", **link).splitlines()[0]


def test_every_answer_carries_a_policy_without_inline_script(served: ViewerPage | Server) -> None:
    for path in (*paths(served), "/nothing"):
        head = ask(served, path, Host=own(served)).partition(b"\r\n\r\n")[0].decode()
        policy = next(x for x in head.splitlines() if x.startswith("Content-Security-Policy:"))
        assert "default-src 'none'" in policy and "script-src 'self'" in policy and "unsafe" not in policy
        assert "X-Content-Type-Options: nosniff" in head and "X-Frame-Options: DENY" in head and "Python" not in head
    page = ask(served, "/", Host=own(served)).decode()
    assert "<script>" not in page and "<style" not in page and " style=" not in page and "onclick" not in page


BODIES: dict[str, tuple[bytes, bytes]] = {
    "nested": (b"[" * 4000, b"a body that is "),  # too deep for Python 3.11's parser, cut for that of 3.13
    "no UTF-8": (b'{"effect": "\xff"}', b"no UTF-8"),
    "cut": (b'{"effect"', b"no JSON"),
    "a list": (b"[1]", b"expected an object"),
    "a number": (b"1e999", b"expected an object"),
    "too long": (b" " * 5000, b"at most 4096"),
    "odd letters": ('{"effect": "\u202e\\u0000"}'.encode(), b""),
}


@pytest.mark.parametrize("what", BODIES)
def test_bodies_that_are_none_get_a_sentence(workbench: Server, what: str, capsys: pytest.CaptureFixture[str]) -> None:
    body, says = BODIES[what]
    head = f"POST /do/add HTTP/1.1\r\nHost: {own(workbench)}\r\nX-Stopset-Token: {workbench.token}\r\nContent-Length: {len(body)}\r\n\r\n"
    got = raw(workbench, head.encode() + body[:4096])
    status = got.splitlines()[0]
    assert (b" 400 " in status and says in got) if says else b" 200 " in status
    assert b"Traceback" not in got and "Traceback" not in capsys.readouterr().err


@pytest.mark.parametrize(
    "line", ["X-Stopset-Token: \xe9\xff", "X-Stopset-Token: ", "Content-Length: \xb2", "Content-Length: -1", f"Content-Length: {'9' * 5000}",
             "Transfer-Encoding: chunked", "Origin: \xe9"],
)  # fmt: skip
def test_headers_that_are_none_get_a_sentence(workbench: Server, line: str, capsys: pytest.CaptureFixture[str]) -> None:
    name = line.partition(":")[0]
    known = {"Host": own(workbench), "X-Stopset-Token": workbench.token}
    head = "".join(f"{k}: {v}\r\n" for k, v in known.items() if k != name)
    got = raw(workbench, f"POST /do/compare HTTP/1.1\r\n{head}{line}\r\n\r\n".encode("latin-1"))
    status, words = got.splitlines()[0], got.partition(b"\r\n\r\n")[2]
    assert status.split()[1] in (b"400", b"403") and 10 < len(words) < 300 and b"<" not in words, got[:200]
    assert "Traceback" not in capsys.readouterr().err and not workbench.loop.busy


@pytest.mark.parametrize(
    "request_",
    [b"\x16\x03\x01\x02\x00\x01\r\n\r\n", b"GET\r\n\r\n", b"BREW / HTTP/1.1\r\nHost: x\r\n\r\n", b"GET / HTTP/9.9\r\n\r\n"],
)
def test_what_is_no_request_gets_a_sentence(
    served: ViewerPage | Server, request_: bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    got = raw(served, request_)
    assert b"cannot be read" in got and b"<" not in got
    assert "Traceback" not in capsys.readouterr().err


def test_a_crowd_does_not_take_the_machine(watch: ViewerPage) -> None:
    """Connections that say nothing are counted and end; the page answers again when they have gone."""
    from stopset.serving import CONNECTIONS

    crowd = [socket.create_connection(("127.0.0.1", watch.server_address[1])) for _ in range(CONNECTIONS + 20)]
    closed = set()

    def refused() -> bool:
        for s in crowd:
            s.settimeout(0.02)
            try:
                if s.recv(1) == b"":
                    closed.add(s)
            except (TimeoutError, ConnectionResetError) as e:
                if isinstance(e, ConnectionResetError):
                    closed.add(s)
        return len(closed) >= 15

    assert patience.wait(refused, 5.0)
    for s in crowd:
        s.close()

    def answers() -> bool:
        with contextlib.suppress(OSError):
            return b" 200 " in ask(watch, "/now", Host=own(watch))
        return False

    assert patience.wait(answers), "never answered again"


def wait(browser: Any, holds: Callable[[], bool]) -> None:
    assert patience.wait(holds), browser.execute_script("return document.body.innerText")[:400]


def test_what_came_over_a_bus_runs_nothing_in_the_live_page(watch: ViewerPage, browser: Any) -> None:
    """Every text of the messages is markup with a script; in the page it is words."""
    browser.get_log("browser")
    browser.get(watch.url)
    wait(browser, lambda: browser.find_element("id", "word").text == "VIOLATION")
    wait(browser, lambda: "onerror" in browser.find_element("id", "joints").text)
    time.sleep(0.3)
    assert browser.execute_script("return document.body.id") == ""
    assert browser.execute_script("return document.querySelectorAll('img, main script, iframe').length") == 0
    for part in ("why", "stops", "margins", "joints", "cause", "violations", "events", "counts", "notice"):
        assert "<img src=x" in browser.find_element("id", part).text.replace("\u00a0", " "), part
    assert [e for e in browser.get_log("browser") if e["level"] == "SEVERE"] == []
    browser.get("about:blank")


def test_were_a_script_ever_in_the_page_it_would_not_run(served: ViewerPage | Server, browser: Any) -> None:
    """The second wall: the policy, where escaping is forgotten."""
    browser.get(served.url)
    browser.execute_script(
        "const s = document.createElement('script'); s.textContent = \"document.body.id = 'ran'\"; document.body.append(s);"
        "const d = document.createElement('div'); d.innerHTML = '<img src=x onerror=\"document.body.id=1\">'; document.body.append(d);"
    )
    time.sleep(0.3)
    assert browser.execute_script("return document.body.id") == ""
    browser.get("about:blank")
    browser.get_log("browser")


def test_another_site_in_the_browser_learns_nothing(watch: ViewerPage, browser: Any) -> None:
    """A page of another origin asks for the state and the stream, as a script of a site somebody has open would."""
    other = ViewerPage(View(), "127.0.0.1", 0)
    other.start()
    try:
        browser.get(other.url)  # same machine, another port: another origin; its policy is taken off to let it try
        browser.execute_cdp_cmd("Page.setBypassCSP", {"enabled": True})
        browser.get(other.url)
        browser.set_script_timeout(10)
        got = browser.execute_async_script(
            "const done = arguments[1]; fetch(arguments[0] + 'now').then(r => r.text()).then(t => done(t), e => done('refused'))",
            watch.url,
        )
        assert got == "refused"
        got = browser.execute_async_script(
            "const done = arguments[1], e = new EventSource(arguments[0] + 'stream');"
            "e.onmessage = m => done(m.data); e.onerror = () => done('refused')",
            watch.url,
        )
        assert got == "refused"
    finally:
        browser.execute_cdp_cmd("Page.setBypassCSP", {"enabled": False})
        browser.get("about:blank")
        browser.get_log("browser")
        other.shutdown()
        other.server_close()


def test_what_is_no_number_is_not_shown_as_one() -> None:
    view = heard("fine")
    before = view.garbled
    for samples in (EVIL, None, [1], 1.5, {"a": 1}):
        view.take_json("", json.dumps(twin("other", samples)).encode())
    assert view.garbled == before + 5 and view.twin is not None and view.twin["why"] == "fine"
    reported = json.dumps(twin("more") | {"unknown": EVIL}).encode()
    view.take_json("", reported)
    assert "unknown" not in view.twin, "what the displays do not need does not reach them"


def test_control_sequences_stop_at_the_terminals_door() -> None:
    """Titles, colours, cleared screens, reversed text: none of it leaves the view, on a terminal or off it."""
    from rich.console import Console

    view = heard(ESCAPES)
    out = io.StringIO()
    Console(file=out, width=200, color_system=None).print(terminal(view))
    shown = out.getvalue() + "  ".join(view.word())
    assert "seen" in shown and "txet" in shown
    assert not [c for c in shown if c != "\n" and (ord(c) < 32 or 0x7F <= ord(c) < 0xA0 or c == "\u202e")]


def test_the_same_event_again_is_counted_not_told_again() -> None:
    view = View()
    for k in range(212):
        view.take_event("", json.dumps({"kind": "outside_domain", "signals": ["q_a"], "t_ns": k}).encode())
        view.take_event("", json.dumps({"kind": "gap", "why": f"gap of {k}.5 ms"}).encode())
    reported = view.snapshot()["events"]
    assert [(e["kind"], e["count"]) for e in reported] == [("outside_domain", 212), ("gap", 212)]
    assert reported[0]["t_ns"] == 211 and reported[0]["told"] == "outside domain: q_a"


def test_a_report_runs_its_own_script_only(browser: Any, tmp_path: Path) -> None:
    import plotly.graph_objects as go

    from stopset.offline.report.page import Page as Report

    page = Report(EVIL)
    for put in (page.heading, page.text, page.verdict, page.next):
        put(EVIL)
    page.table((EVIL, "n"), [(EVIL, 1.0)], EVIL)
    page.figure(go.Figure(go.Scatter(x=[1.0, 2.0], y=[1.0, 2.0], name="</script><script>document.body.id='ran'</script>")), EVIL)
    page.save(tmp_path / "r.html")
    browser.get_log("browser")
    browser.get((tmp_path / "r.html").as_uri())
    wait(browser, lambda: browser.execute_script("return document.querySelectorAll('.js-plotly-plot .main-svg').length") > 0)
    assert browser.execute_script("return document.body.id") == ""
    assert [e for e in browser.get_log("browser") if e["level"] == "SEVERE"] == []
    browser.execute_script(
        "const s = document.createElement('script'); s.textContent = \"document.body.id = 'ran'\"; document.body.append(s)"
    )
    assert browser.execute_script("return document.body.id") == ""
    browser.get("about:blank")
    browser.get_log("browser")


def test_a_connection_of_http_client_still_works(watch: ViewerPage) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", watch.server_address[1], timeout=5)
    connection.request("GET", "/now")
    assert json.load(connection.getresponse())["word"] == "VIOLATION"
    connection.request("POST", "/now", b"{}")
    assert connection.getresponse().status == 405


def test_only_the_page_itself_clears_a_violation_and_only_where_it_may(browser: Any) -> None:
    """By the form in the browser: once with a reason; never with a foreign token, and not at all without a name."""
    from stopset.monitor.orders import Reset

    sent: list[str] = []
    page = ViewerPage(
        heard("fine"),
        "127.0.0.1",
        0,
        lambda reason: sent.append(Reset.of("A. Turner", reason).reason),
        "in the name of <A> Turner",
    )
    page.start()

    def post(token: str, body: bytes) -> bytes:
        head = f"POST /reset HTTP/1.1\r\nHost: {own(page)}\r\nX-Stopset-Token: {token}\r\nContent-Length: {len(body)}\r\n\r\n"
        return raw(page, head.encode("latin-1") + body)

    try:
        good = b'{"reason": "hose refitted"}'
        for token in ("", "guess", "\xe9", page.token[:-1]):
            assert b" 403 " in post(token, good).splitlines()[0]
        for body in (
            b"{}",
            b'{"reason": 3}',
            b'{"reason": "x", "name": "somebody else"}',
            b'{"reason": "  "}',
            b'{"reason": "%s"}' % (b"x" * 300),
        ):
            assert b" 400 " in post(page.token, body).splitlines()[0], body
        assert sent == []
        browser.get(page.url)
        wait(browser, lambda: browser.find_element("id", "reset").is_displayed())
        assert "in the name of <A> Turner" in browser.find_element("id", "reset").text
        browser.find_element("id", "reason").send_keys("hose refitted")
        browser.find_element("css selector", "#reset button").click()
        wait(browser, lambda: "sent" in browser.find_element("id", "resetsays").text)
        assert sent == ["hose refitted"]
    finally:
        browser.get("about:blank")
        page.shutdown()
        page.server_close()


def test_a_page_without_a_name_orders_nothing(watch: ViewerPage, browser: Any) -> None:
    for token in ("", "x"):
        head = f"POST /reset HTTP/1.1\r\nHost: {own(watch)}\r\nX-Stopset-Token: {token}\r\nContent-Length: 15\r\n\r\n"
        assert b" 405 " in raw(watch, head.encode() + b'{"reason": "x"}').splitlines()[0]
    browser.get(watch.url)
    wait(browser, lambda: browser.find_element("id", "word").text == "VIOLATION")
    assert not browser.find_element("id", "reset").is_displayed()
    browser.get("about:blank")
