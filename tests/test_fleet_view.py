"""Many arms at a glance: real sessions over a real router, an arm that is killed, and strangers' text."""

from __future__ import annotations

import io
import json
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from rich.console import Console

from monitor_process import free_port
from patience import wait
from stopset.cli.main import main
from stopset.monitor.fleet import Fleet, FleetPage, terminal
from stopset.monitor.layout import State
from stopset.monitor.links.zenoh_link import ZenohLink

ARM = """
import json, sys, time
from stopset.monitor.layout import State
from stopset.monitor.links.zenoh_link import ZenohLink
name, port, state = sys.argv[1:4]
link = ZenohLink(name + "/stopset", mode="client", connect=[f"tcp/127.0.0.1:{port}"])
link.alive("alive")
while True:
    link.put("state/json", json.dumps({"state": state, "why": "said by " + name, "stops": {"0": {"time_s": 0.2, "tcp_m": 0.1}}}))
    time.sleep(0.1)
"""


@pytest.fixture
def router() -> Iterator[int]:
    port = free_port()
    link = ZenohLink(mode="router", listen=[f"tcp/127.0.0.1:{port}"])
    yield port
    link.close()


def arm(name: str, port: int, state: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen([sys.executable, "-c", ARM, name, str(port), state])


def words(fleet: Fleet) -> dict[str, str]:
    return {r["arm"]: r["word"] for r in fleet.rows()}


def texts(browser: Any, selector: str) -> list[str]:
    """What stands in each, read at once: the page draws its tiles anew all the time."""
    return list(browser.execute_script("return [...document.querySelectorAll(arguments[0])].map(e => e.innerText)", selector))


def test_every_state_that_a_monitor_publishes_has_its_place() -> None:
    fleet = Fleet()
    for state in State:
        fleet.take_json(f"hall/cell/{state.name}/stopset/state/json", json.dumps({"state": state.name, "why": ""}).encode())
    assert sorted(words(fleet).values()) == sorted({s.name for s in State} - {"NEVER_SENT"}) and fleet.garbled == 1
    assert fleet.snapshot()["counts"]["INIT"] == 1 and terminal(fleet) is not None


def test_three_arms_are_found_and_a_killed_one_goes_grey_in_time(router: int, tmp_path: Path, browser: Any) -> None:
    arms = [arm(f"hall/cell{k}/arm", router, state) for k, state in enumerate(("OK", "VIOLATION", "OK"))]
    fleet, link = Fleet(), ZenohLink(mode="client", connect=[f"tcp/127.0.0.1:{router}"])
    page: Any = FleetPage(fleet, "127.0.0.1", 0)
    page.start()
    try:
        link.watch_alive("*/*/*/stopset/alive", fleet.take_alive)
        link.subscribe("*/*/*/stopset/state/json", fleet.take_json)
        expected = {"hall/cell0/arm": "OK", "hall/cell1/arm": "VIOLATION", "hall/cell2/arm": "OK"}
        assert wait(lambda: words(fleet) == expected), words(fleet)
        assert fleet.rows()[0]["arm"] == "hall/cell1/arm", "what needs somebody stands first"
        browser.get(page.url)
        assert wait(lambda: "3 arms: 1 ✕ VIOLATION, 2 ✓ OK" in browser.find_element("id", "counts").text)
        tiles = texts(browser, "article")
        assert "hall/cell1/arm" in tiles[0] and "STOP 0: 100 mm, 200 ms" in tiles[1]
        arms[2].kill()
        assert wait(lambda: words(fleet)["hall/cell2/arm"] == "NO DATA", 2.5), "grey in time"
        assert wait(lambda: texts(browser, "article.NO-DATA"), 3.0)
        assert "mm" not in texts(browser, "article.NO-DATA")[0], "no number of an arm that is gone"
        again = arm("hall/cell2/arm", router, "OK")
        arms.append(again)
        assert wait(lambda: words(fleet) == expected)
        out = tmp_path / "fleet.json"
        asked = [
            "fleet",
            "--connect",
            f"tcp/127.0.0.1:{router}",
            "--port",
            "0",
            "--seconds",
            "1.5",
            "--json",
            str(out),
            "--arms",
            "hall/*/*",
        ]

        def seen() -> dict[str, str]:
            assert main(asked) == 0
            return {r["arm"]: r["word"] for r in json.loads(out.read_text())["rows"]}

        # a machine that stands still in the last second of it hears no arm
        assert wait(lambda: seen() == expected, 10.0), seen()
        page.fleet = SimpleNamespace(snapshot=lambda: time.sleep(4) or {})  # the viewer hangs
        assert wait(lambda: "what is shown is old" in browser.find_element("id", "counts").text, 3.0)
        assert [e for e in browser.get_log("browser") if e["level"] == "SEVERE"] == []
    finally:
        browser.get("about:blank")
        link.close()
        page.shutdown()
        page.server_close()
        for p in arms:
            p.kill()
            p.wait()


def test_silence_is_grey_even_while_the_token_stands() -> None:
    now = [0.0]
    fleet = Fleet(lambda: now[0])
    fleet.take_alive("a/b/c/stopset/alive", there=True)
    assert fleet.rows()[0]["why"] == "alive, but nothing was said yet"
    fleet.take_json("a/b/c/stopset/state/json", json.dumps({"state": "OK", "why": "w"}).encode())
    now[0] = 0.99
    assert words(fleet) == {"a/b/c": "OK"}
    now[0] = 1.01
    assert words(fleet) == {"a/b/c": "NO DATA"} and "silent for 1.0 s" in fleet.rows()[0]["why"]
    fleet.take_json("a/b/c/stopset/state/json", json.dumps({"state": "OK", "why": "w"}).encode())
    fleet.take_alive("a/b/c/stopset/alive", there=False)
    assert words(fleet) == {"a/b/c": "NO DATA"}


def test_a_look_makes_the_rows_that_it_shows_and_counts_all() -> None:
    fleet = Fleet()
    for k in range(300):
        state = ("OK", "FAULT", "UNKNOWN")[k % 3]
        fleet.take_json(f"hall/cell{k}/arm/stopset/state/json", json.dumps({"state": state, "why": "w"}).encode())
    fleet.take_alive("hall/cell0/arm/stopset/alive", there=False)
    every, few = fleet.rows(), fleet.snapshot(101)
    assert few["rows"] == every[:101] and few["rows"][100]["word"] == "NO DATA"
    assert few["arms"] == len(every) == 300 and few["counts"] == {"FAULT": 100, "NO DATA": 1, "UNKNOWN": 100, "OK": 99}
    assert [r["arm"] for r in every[:3]] == [f"hall/cell{k}/arm" for k in (1, 4, 7)]


def test_arms_that_find_no_place_are_counted_and_said() -> None:
    said: list[str] = []
    fleet, each = Fleet(notice=lambda: "; ".join(said), most=3), json.dumps({"state": "FAULT", "why": "w"}).encode()
    for k in range(3):
        fleet.take_alive(f"hall/cell{k}/arm/stopset/alive", there=True)
    assert fleet.snapshot()["beyond"] == 0 and fleet.snapshot()["notice"] == ""
    for _ in range(5):
        fleet.take_json("hall/cell3/arm/stopset/state/json", each)
        fleet.take_json("hall/cell4/arm/stopset/state/json", each)
    shot = fleet.snapshot()
    assert shot["arms"] == 3 and shot["beyond"] == 2
    assert shot["notice"].startswith("2 arms beyond the 3 that are shown were heard")
    said.append("the disk is full")
    for k in range(5, 100):
        fleet.take_alive(f"hall/cell{k}/arm/stopset/alive", there=True)
    assert fleet.snapshot()["beyond"] == 3, "strangers' names do not fill the memory"
    out = io.StringIO()
    Console(file=out, width=300).print(terminal(fleet))
    assert "3 or more arms beyond the 3" in out.getvalue() and "; the disk is full" in out.getvalue()


def test_arms_are_counted_as_people_count() -> None:
    fleet = Fleet()
    for k in (10, 2, 1):
        fleet.take_alive(f"hall/cell{k}/arm/stopset/alive", there=True)
    assert [r["arm"] for r in fleet.rows()] == [f"hall/cell{k}/arm" for k in (1, 2, 10)]


def test_text_of_strangers_is_text(browser: Any) -> None:
    evil = "<img src=x onerror=document.body.id='ran'>\x1b]0;owned\x07"
    fleet = Fleet()
    for data in (b"{", b"[]", b'{"state": 3}', b'{"state": "FINE", "why": ""}', b"[" * 100_000, b" " * (2 << 20)):
        fleet.take_json("a/b/c/stopset/state/json", data)
    assert fleet.garbled == 6 and fleet.rows() == []
    said = {"state": "VIOLATION", "why": evil, "violation_class": evil, "stops": {evil: {"time_s": 1.0, "tcp_m": None}}}
    fleet.take_json(f"a/{evil[:40]}/c/stopset/state/json", json.dumps(said).encode())
    out = io.StringIO()
    Console(file=out, width=200, color_system=None).print(terminal(fleet))
    assert "\x1b" not in out.getvalue() and "\x07" not in out.getvalue() and "VIOLATION" in out.getvalue()
    page = FleetPage(fleet, "127.0.0.1", 0)
    page.start()
    try:
        with urllib.request.urlopen(page.url + "now") as r:
            assert json.load(r)["counts"] == {"VIOLATION": 1}
        browser.get(page.url)
        assert wait(lambda: "onerror" in browser.find_element("id", "tiles").text)
        assert browser.execute_script("return document.body.id") == ""
    finally:
        browser.get("about:blank")
        page.shutdown()
        page.server_close()


@pytest.mark.parametrize("arms", ["hall", "a/b/c/d", "a/**", "", "a//c"])
def test_a_wrong_pattern_is_a_sentence(arms: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fleet", "--arms", arms, "--seconds", "0.1"]) == 2
    assert "expected SITE/CELL/ARM" in capsys.readouterr().err
