"""Pages for everybody: axe-core finds nothing serious on any of them, and what is stale is grey in time."""

from __future__ import annotations

import io
import json
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
import pytest
from rich.console import Console

from monitor_arm import known_model
from patience import Granted, wait
from stopset.artifact.store import model_text
from stopset.cli.main import main
from stopset.monitor.fleet import Fleet, FleetPage
from stopset.monitor.layout import State
from stopset.monitor.report import Turn, _stops
from stopset.monitor.stopworker import answer_for
from stopset.monitor.viewer import View, ViewerPage, terminal
from stopset.offline.report.page import Page as Report
from stopset.offline.workbench import Loop, Server
from stopset.reach.stops import StopBounds
from test_page_security import Alive, twin

AXE = Path(__file__).with_name("node_modules") / "axe-core" / "axe.min.js"


@pytest.fixture(scope="session")
def axe() -> str:
    if not AXE.exists():
        pytest.skip("axe-core is not installed: npm --prefix tests install")
    return AXE.read_text(encoding="utf-8")


def serious(browser: Any, axe: str) -> list[str]:
    """What axe-core calls serious or critical on the page that is open."""
    browser.set_script_timeout(60)
    browser.execute_script(axe)
    found = browser.execute_async_script(
        "const done = arguments[0]; axe.run().then(r => done(r.violations), e => done([{impact: 'critical', id: String(e)}]))"
    )
    return [
        f"{v['id']}: {v['nodes'][0]['html'][:150]} {v['nodes'][0].get('failureSummary', '')[:300]}"
        for v in found
        if v["impact"] in ("serious", "critical")
    ]


def moving(state: State) -> Alive:
    """A daemon of a real model's arm with real bounds, heard by a view."""
    model = known_model()
    text = model_text(model)
    q = np.array([0.3, 0.5, 0.2, 0.9, 0.1, 0.4])
    x, r = np.concatenate([q, np.full(6, 0.2)]), np.full(12, 0.004)
    prepared = StopBounds.of(model, fast=True)
    numbers = {c: answer_for(prepared, c, x - r, x + r).numbers for c in ("0", "1")}
    joints = model.joints
    left = [{"joint": joints[3], "samples": 3, "state": "q", "side": "above", "unit": "rad", "excess": 0.01}]
    stops = _stops(Turn(state, 0, "", numbers, 0), joints)
    reported = twin("fine") | {
        "state": state.name, "joints": list(joints), "q": q.tolist(), "model_sha256": json.loads(text)["sha256"],
        "room": dict.fromkeys(joints, 0.5), "stops": stops, "violations": left if state is State.VIOLATION else [],
    }  # fmt: skip
    out = Alive(state)
    view = out.view
    out.words = json.dumps(reported).encode()
    out.speak()
    view.take_model(text.encode())
    view.take_event("", b'{"kind": "gap", "why": "gap of 2 samples", "t_ns": 5}')
    view.challenge()
    return out


@contextmanager
def shown(view: View, browser: Any, word: str) -> Iterator[ViewerPage]:
    """The live page in a browser, once it shows ``word`` and its joints."""
    page = ViewerPage(view, "127.0.0.1", 0)
    page.start()
    try:
        browser.get(page.url)
        there = wait(lambda: browser.find_element("id", "word").text == word and browser.find_element("id", "joints").text)
        assert there, browser.find_element("tag name", "body").text
        yield page
    finally:
        browser.get("about:blank")
        page.shutdown()
        page.server_close()


DRAWN = """
const canvas = document.createElement('canvas'); canvas.width = 900; canvas.height = 640;
Arm.draw(canvas, [[0, 0, 0], [0, 0, 0.5], [0.5, 0, 0.5]], [[arguments[0], '#f0a202']], []);
const drawn = canvas.getContext('2d').getImageData(0, 0, 900, 640).data;
let count = 0;
for (let k = 0; k < drawn.length; k += 4) count += drawn[k] > 200 && drawn[k + 2] < 180 && drawn[k + 3] > 100;
return count;
"""


def test_a_swept_ball_is_drawn_as_well_as_a_swept_line(browser: Any) -> None:
    """A stop that may go anywhere sweeps balls: their capsules have no length, and a canvas strokes no such line."""
    with shown(moving(State.OK).view, browser, "OK"):
        line, ball, none = (
            browser.execute_script(DRAWN, capsules)
            for capsules in ([[0.0, 0.0, 0.5, 0.02, 0.0, 0.5, 0.7]], [[0.0, 0.0, 0.5, 0.0, 0.0, 0.5, 0.7]], [])
        )
    assert ball > 20 * none and line > 1.01 * ball


@pytest.mark.parametrize("state", [State.OK, State.DEGRADED, State.VIOLATION, State.UNKNOWN, State.FAULT])
def test_the_live_page_is_for_everybody(state: State, browser: Any, axe: str) -> None:
    view = moving(state).view
    shot = view.snapshot()
    assert shot["arm"] is not None and len(shot["arm"]) == 8, "base, six joints, flange"
    assert shot["twin"]["stops"]["0"]["capsules"], "what it sweeps is drawn"
    with shown(view, browser, state.name):
        assert serious(browser, axe) == []


def test_bad_states_are_told_apart_without_colour(browser: Any) -> None:
    """By sign and by words; what is bad for another reason looks otherwise."""
    marks = {}
    for state in (State.OK, State.DEGRADED, State.VIOLATION, State.UNKNOWN, State.FAULT):
        with shown(moving(state).view, browser, state.name):
            marks[state.name] = tuple(browser.find_element("id", x).text for x in ("sign", "means"))
            ground = browser.execute_script(
                "const s = getComputedStyle(document.getElementById('band')); return s.backgroundColor + s.backgroundImage"
            )
            marks[f"{state.name} ground"] = ground
    assert len(set(marks.values())) == len(marks)


@pytest.mark.parametrize("size", [(390, 844), (1250, 900), (1920, 1080)])
def test_every_number_is_in_sight(browser: Any, size: tuple[int, int]) -> None:
    """No table is wider than what holds it: the flange's distance was cut off once on a telephone, and once on a desk."""
    daemon = moving(State.VIOLATION)
    reported = json.loads(daemon.words)
    reported["stops"]["1 guaranteed"] = {"time_s": 1.843, "tcp_m": 1.478, "why": "", "joints": {}}
    daemon.words = json.dumps(reported).encode()
    daemon.speak()
    seen = {"width": size[0], "height": size[1], "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", seen)
    try:
        with shown(daemon.view, browser, "VIOLATION"):
            assert wait(lambda: "1478 mm" in browser.find_element("id", "stops").text)
            wide = browser.execute_script(
                "return [...document.querySelectorAll('.wide')]"
                ".map(d => [d.firstElementChild.id, d.scrollWidth - d.clientWidth]).filter(x => x[1] > 0)"
            )
            assert wide == []
    finally:
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_positions_are_drawn_within_what_was_predicted_and_what_leaves_it_is_crossed(browser: Any) -> None:
    """Also for who opens the page later, and in words for who does not see it."""
    daemon = moving(State.OK)
    told = json.loads(daemon.words)
    q = np.array(told["q"])
    for off in (0.0, 0.005, 0.02):  # of joint 1, within 10 mrad of the middle of its prediction
        told |= {"q": (q + off * np.eye(6)[0]).tolist(), "tube": {"lo": (q - 0.01).tolist(), "hi": (q + 0.01).tolist()}}
        daemon.words = json.dumps(told).encode()
        daemon.speak()
    told["tube"]["lo"] = told["tube"]["lo"][:3]
    daemon.words = json.dumps(told).encode()
    daemon.speak()  # bounds of other joints than it has are not drawn
    assert [len(p["q"]) for p in daemon.view.traces()] == [6, 6, 6]
    with shown(daemon.view, browser, "OK"):
        labels = browser.execute_script(
            "return [...document.querySelectorAll('#rooms canvas')].map(c => c.getAttribute('aria-label'))"
        )
        assert labels[0].startswith("arm_1_joint: 20 of ± 10 mrad, ✕ left"), labels
        assert labels[1:] == [f"arm_{k}_joint: 0 of ± 10 mrad" for k in range(2, 7)]
        inked = browser.execute_script(
            "const red = c => { const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data; let n = 0;"
            " for (let i = 0; i < d.length; i += 4) n += d[i] > 150 && d[i + 1] < 60 && d[i + 3] > 200; return n; };"
            " return [...document.querySelectorAll('#rooms canvas')].map(red)"
        )
        assert inked[0] > 20, "a cross where it left"
        sizes = browser.execute_script(
            "return ['#word', '#stops td.n'].map(s => parseFloat(getComputedStyle(document.querySelector(s)).fontSize))"
        )
        height = browser.execute_script("return Math.min(innerWidth, innerHeight)")
        # 9 mm at two metres; a screen of 900 lines is some 300 mm high
        assert sizes[0] > 9 / 300 * height and sizes[1] > 9 / 300 * height, sizes


def test_bounds_are_rounded_up_wherever_they_are_shown(browser: Any) -> None:
    """To the next millisecond, millimetre and tenth of a milliradian, on the page and in the terminal."""
    daemon = moving(State.OK)
    reported = json.loads(daemon.words)
    stop = {"time_s": 0.0800001, "forward_rad": 0.00001, "back_rad": 0.0}
    reported["stops"] = {
        "0": {"time_s": 0.0800001, "tcp_m": 0.0120001, "why": "", "joints": dict.fromkeys(reported["joints"], stop)}
    }
    reported["margins"] = {"certified": True, "time_s": 0.0429, "tcp_m": -0.0001, "planes_m": {"fence": 0.1239}}
    daemon.words = json.dumps(reported).encode()
    daemon.speak()
    console = Console(width=150, record=True, file=io.StringIO())
    console.print(terminal(daemon.view))
    with shown(daemon.view, browser, "OK"):
        page = browser.find_element("id", "stops").text + browser.find_element("id", "joints").text
        left = browser.find_element("id", "margins").text
    assert "42 ms" in left and "✕ -1 mm" in left and "plane fence 123 mm" in left, "and what is left to a limit is rounded down"
    for text in (page, console.export_text()):
        assert "81 ms" in text and "13 mm" in text and "0.0001 rad" in text
        assert "80 ms" not in text and "12 mm" not in text and "0.0000 rad" not in text


def test_a_dead_monitor_greys_the_page_in_time(browser: Any) -> None:
    """Killed: within its watchdog and a look no bar is coloured and no distance stands."""
    daemon = moving(State.OK)
    view = daemon.view
    assert view.consumer is not None
    view.consumer.watchdog = 10**9 // 2
    living = threading.Event()

    def speak() -> None:
        while not living.wait(0.05):
            daemon.speak()

    threading.Thread(target=speak, daemon=True).start()
    left = (
        "return [...document.querySelectorAll('#joints meter')].filter(m => m.value > 0).length"
        " + (document.getElementById('stops').innerText.match(/ mm/g) || []).length"
    )
    with shown(view, browser, "OK"):
        assert wait(lambda: browser.execute_script(left) >= 7), "six bars and a distance while it lives"
        view.ask = None
        living.set()
        assert wait(lambda: not browser.execute_script(left) and browser.find_element("id", "word").text == "NO DATA", 1.5)
        assert "grayscale" in browser.execute_script("return getComputedStyle(document.querySelector('main')).filter")


def test_a_violation_is_on_the_page_within_a_fifth_of_a_second(browser: Any) -> None:
    daemon = moving(State.OK)
    watch = (
        "const word = document.getElementById('word'); window.seen = {};"
        "new MutationObserver(() => { window.seen[word.textContent] ??= Date.now(); })"
        ".observe(word, {childList: true, characterData: true, subtree: true})"
    )
    took = []
    with shown(daemon.view, browser, "OK"), Granted() as granted:
        for state in (State.VIOLATION, State.OK, State.VIOLATION, State.OK, State.VIOLATION):
            browser.execute_script(watch)
            daemon.state = state
            begin, apart = time.monotonic(), time.time() - time.monotonic()
            daemon.speak()
            at = "return window.seen[arguments[0]]"
            assert wait(lambda at=at, name=state.name: browser.execute_script(at, name))
            took.append(granted.between(begin, browser.execute_script(at, state.name) / 1e3 - apart))
    assert sorted(took)[2] < 0.2, took


def test_reports_are_for_everybody(planar: Any, browser: Any, axe: str, tmp_path: Path) -> None:
    folder = planar[0]
    model, data = str(folder / "m.model.json"), ["--data", str(folder / "rec.parquet")]
    asked = {
        "inspect": [str(folder / "rec.parquet")], "compare": [model, *data], "diagnose": [model, *data], "history": [model], "stops": [model],
    }  # fmt: skip
    for command, words in asked.items():
        done = main([command, *words, "--quiet", "--report", str(tmp_path / f"{command}.html")])
        assert done == (command == "stops"), command  # no brakes are known: refusals
    page = Report("All of it")
    for kind in ("", "good", "bad"):
        page.verdict("A sentence", kind)
    page.next("`stopset diagnose`")
    page.figure(go.Figure(go.Bar(x=[1.0], y=[2.0])), "A figure")
    with page.fold("More"):
        page.table(("joint", "n"), [("a", 1.0)], "A table")
    page.save(tmp_path / "all.html")
    for name in (*(f"{command}.html" for command in asked), "all.html"):
        browser.get((tmp_path / name).as_uri())
        browser.execute_script("document.querySelectorAll('details').forEach(d => { d.open = true; })")
        assert wait(lambda: browser.execute_script("return [...document.querySelectorAll('.plot')].every(d => d._fullLayout)"))
        assert serious(browser, axe) == [], name
    browser.get("about:blank")


def test_the_fleet_is_for_everybody(browser: Any, axe: str) -> None:
    """Every state at once, arms that are gone among them."""
    fleet = Fleet()
    for k, state in enumerate(("OK", "DEGRADED", "VIOLATION", "UNKNOWN", "FAULT", "INIT")):
        fleet.take_alive(f"hall/cell{k}/arm/stopset/alive", there=True)
        words = {
            "state": state,
            "why": "said so",
            "stops": {"0": {"time_s": 0.2, "tcp_m": 0.1}, "1": {"time_s": None, "tcp_m": None}},
        }
        fleet.take_json(f"hall/cell{k}/arm/stopset/state/json", json.dumps(words).encode())
    fleet.take_alive("hall/cell9/arm/stopset/alive", there=True)
    page: Any = FleetPage(fleet, "127.0.0.1", 0)
    page.start()
    try:
        browser.get(page.url)
        assert wait(lambda: len(browser.find_elements("css selector", "article")) == 7)
        assert serious(browser, axe) == []
    finally:
        browser.get("about:blank")
        page.shutdown()
        page.server_close()


def test_the_workbench_is_for_everybody(planar: Any, browser: Any, axe: str, tmp_path: Path) -> None:
    folder = planar[0]
    s = Server(Loop(folder / "m.model.json", [folder / "rec.parquet"], tmp_path), "127.0.0.1", 0)
    s.start()
    try:
        s.loop.start("compare")
        browser.get(s.url)
        assert wait(lambda: browser.find_elements("css selector", ".heat button") and not s.loop.busy, 120.0)
        time.sleep(0.7)  # until its buttons know that nothing runs
        assert serious(browser, axe) == []
    finally:
        browser.get("about:blank")
        s.shutdown()
        s.server_close()
