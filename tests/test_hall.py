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


def routed(file: Path) -> subprocess.Popen[str]:
    process = subprocess.Popen([sys.executable, "-c", HALL, str(file)], env=environment(), stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None and wait(lambda: process.stdout.readline().strip() == "listens")
    return process


@OPENSSL
def test_a_cells_words_pass_two_routers_and_its_consumers_need_neither_hall(tmp_path: Path) -> None:
    """Daemon, cell's router, hall's router, each as shipped; the hall's comes late, is killed, and is begun anew."""
    pki, cell, hall_port = tmp_path / "pki", free_port(), free_port()
    people = ["stopset-daemon", "stopset-plc", "stopset-operator"]
    subprocess.run([ZENOH / "pki/make-certs.sh", pki, "localhost", *people], check=True, capture_output=True)
    for name in ("hall", "router", "daemon", "plc"):
        text = (ZENOH / f"{name}.json5").read_text().replace("/etc/stopset/zenoh/pki", str(pki))
        port = hall_port if name == "hall" else cell
        text = text.replace("0.0.0.0:7447", f"127.0.0.1:{port}").replace("router.cell.local:7447", f"localhost:{cell}")
        # the site's router is not there: that holds nothing up; all of this is one interface, so its rules are tried above
        text = text.replace("router.site.local:7447", f"localhost:{free_port()}").replace("uplink0", "none0")
        text = text.replace("connect: { endpoints: [],", f'connect: {{ endpoints: ["tls/localhost:{hall_port}"],')
        (tmp_path / f"{name}.json5").write_text(text)
    # who looks at the hall: with a certificate of the cell's authority, at the hall's router
    viewer = (tmp_path / "plc.json5").read_text().replace("stopset-plc", "stopset-operator")
    (tmp_path / "viewer.json5").write_text(viewer.replace(f"localhost:{cell}", f"localhost:{hall_port}"))
    processes, links, over = [routed(tmp_path / "router.json5")], [], threading.Event()
    fleet, near, orders = Fleet(), [0], []

    def looks() -> ZenohLink:
        link = ZenohLink(file=tmp_path / "viewer.json5")
        link.subscribe("*/*/*/stopset/state/json", fleet.take_json)
        link.watch_alive("*/*/*/stopset/alive", fleet.take_alive)
        return link

    try:
        daemon = ZenohLink("site/cell/arm/stopset", file=tmp_path / "daemon.json5")
        plc = ZenohLink("site/cell/arm/stopset", file=tmp_path / "plc.json5")
        links += [daemon, plc]
        daemon.alive("alive")
        daemon.subscribe("reset", lambda _, data: orders.append(data))
        plc.subscribe("state", lambda *_: near.__setitem__(0, near[0] + 1))

        def live() -> None:
            send = daemon.fast("state")
            while not over.wait(0.05):
                send(b"every cycle")
                daemon.put("state/json", '{"state": "OK", "why": "w"}')

        thread = threading.Thread(target=live)
        thread.start()
        assert wait(lambda: near[0] > 10), "without a hall"
        for _ in range(2):
            processes.append(routed(tmp_path / "hall.json5"))
            links.append(looks())
            assert wait(lambda: [r["word"] for r in fleet.rows()] == ["OK"]), "the cell's router finds it by itself"
            for _ in range(4):
                links[-1].put("site/cell/arm/stopset/reset", "from the hall")
                rest(0.25)
            links.pop().close()
            processes[-1].kill()
            near[0] = 0
            assert wait(lambda: [r["word"] for r in fleet.rows()] == ["NO DATA"]) and wait(lambda: near[0] > 10)
        assert not orders, "an operator's order through the hall does not come down: the cell's router lets the hall read only"
    finally:
        over.set()
        for link in reversed(links):
            link.close()
        for process in processes:
            process.kill()
            process.communicate()
