"""A hall's router as shipped, between two real sessions: words go up twice a second, the message of every cycle and orders do not pass."""

from __future__ import annotations

import contextlib
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from monitor_process import environment, free_port
from patience import rest, wait
from stopset.monitor.fleet import Fleet
from stopset.monitor.links.zenoh_link import ZenohLink

ZENOH = Path(__file__).resolve().parents[1] / "deploy/zenoh"
HALL = """
import sys, time
from stopset.monitor.links.zenoh_link import ZenohLink
link = ZenohLink(file=sys.argv[1])
print("listens", flush=True)
time.sleep(120)
"""
OPENSSL = pytest.mark.skipif(shutil.which("openssl") is None, reason="no openssl to make certificates with")


@contextlib.contextmanager
def hall(tmp_path: Path, rules: str) -> Iterator[tuple[ZenohLink, ZenohLink]]:
    """A session at the site's router and one of an arm, the hall's router between them a process of its own.

    Here both sides are on one interface, so the rules for what goes up and for what comes down are tried one at a time.
    """
    pki, up, down = tmp_path / "pki", free_port(), free_port()
    subprocess.run([ZENOH / "pki/make-certs.sh", pki, "localhost", "stopset-daemon"], check=True, capture_output=True)
    for name in ("hall", "router", "daemon"):
        text = (ZENOH / f"{name}.json5").read_text().replace("/etc/stopset/zenoh/pki", str(pki)).replace("uplink0", "lo")
        if name == "router":  # the site's: sessions as the cell's, without the cell's rules
            text = text[: text.index("// what asks more often")].replace("0.0.0.0:7447", f"127.0.0.1:{up}") + "}"
        text = text.replace("0.0.0.0:7447", f"127.0.0.1:{down}").replace("router.site.local:7447", f"localhost:{up}")
        assert name != "hall" or 'rules: ["stays", "below"]' in text
        text = text.replace('rules: ["stays", "below"]', f"rules: [{rules}]").replace(
            "router.cell.local:7447", f"localhost:{down}"
        )
        (tmp_path / f"{name}.json5").write_text(text)
    links = [ZenohLink(file=tmp_path / "router.json5")]
    words = [sys.executable, "-c", HALL, str(tmp_path / "hall.json5")]
    process = subprocess.Popen(words, env=environment(), stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None and wait(lambda: process.stdout.readline().strip() == "listens")
        links.append(ZenohLink("a/b/c/stopset", file=tmp_path / "daemon.json5"))
        yield links[0], links[1]
    finally:
        for link in reversed(links):
            link.close()
        process.kill()
        process.communicate()


@OPENSSL
@pytest.mark.parametrize(("rules", "passes"), [('"stays"', True), ('"below"', False)])
def test_no_order_comes_down(tmp_path: Path, rules: str, passes: bool) -> None:
    heard: list[bytes] = []
    with hall(tmp_path, rules) as (above, arm):
        arm.subscribe("reset", lambda _, data: heard.append(data))
        for _ in range(8):
            rest(0.25)
            above.put("a/b/c/stopset/reset", "from far away")
        assert bool(heard) is passes, "without the rule it would arrive"


@OPENSSL
def test_words_go_up_and_nothing_else(tmp_path: Path) -> None:
    heard: dict[str, list[float]] = {}
    fleet, over = Fleet(), threading.Event()
    with hall(tmp_path, '"stays"') as (above, arm):
        above.subscribe("a/b/c/**", lambda k, _: heard.setdefault(k, []).append(time.monotonic()))
        above.subscribe("*/*/*/stopset/state/json", fleet.take_json)
        rest(0.5)

        def live() -> None:
            send, k = arm.fast("state"), 0
            while not over.wait(0.01):
                send(b"every cycle")
                if k % 20 == 0:
                    arm.put("state/json", '{"state": "OK", "why": "w"}')
                k += 1
            arm.put("event", "{}", must_arrive=True)

        thread = threading.Thread(target=live)
        thread.start()
        assert wait(lambda: len(heard.get("a/b/c/stopset/state/json", [])) >= 10)
        worst = {r["word"] for _ in range(100) if not time.sleep(0.02) for r in fleet.rows()}
        over.set()
        thread.join()
        assert wait(lambda: "a/b/c/stopset/event" in heard, 5.0), "what happened is told"
        assert set(heard) == {"a/b/c/stopset/state/json", "a/b/c/stopset/event"}
        words = heard["a/b/c/stopset/state/json"]
        assert (len(words) - 1) / (words[-1] - words[0]) < 2.3, "of five a second two go up"
        assert worst == {"OK"}, "and two keep the overview fresh"
