"""The workbench at work: a process of its own, what runs by itself, what survives a reload, and long recordings."""

from __future__ import annotations

import os
import shutil
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from patience import wait
from stopset.artifact import Model, load_model
from stopset.errors import RecordingError
from stopset.fmu import Contents
from stopset.offline.compare.scene import POINTS, Scene
from stopset.offline.workbench import Loop, Server
from stopset.offline.workbench.jobs import Job
from stopset.progress import Progress


def here_only(model: Model, target: Path, progress: Progress) -> None:
    """An FMU of sources alone: nothing is compiled."""
    from stopset.fmu import export

    export(model, target, Contents(3, (), True, False), progress)


@pytest.fixture
def loop(altered: Path, tmp_path: Path) -> Iterator[Loop]:
    made = Loop(altered / "m.model.json", [altered / "altered.parquet", altered / "healthy.parquet"], tmp_path, here_only)
    made.choose([0], ["", ""])
    yield made
    made.close()


def until(holds: Callable[[], Any], seconds: float = 90.0) -> Any:
    found = wait(holds, seconds)
    assert found, "never"
    return found


def at_hand(loop: Loop) -> dict[str, Any]:
    return dict(loop.snapshot()["models"][-1]["answers"])


def test_a_worker_that_is_killed_costs_one_answer(loop: Loop) -> None:
    """As by a machine out of memory: one sentence, the page's process lives, and the next job finds a new worker."""
    loop.start("diagnose")
    until(lambda: loop.job()["job"]["says"])
    process = loop._worker._process
    assert process is not None and process.pid is not None and process.pid != os.getpid()
    os.kill(process.pid, signal.SIGKILL)
    until(lambda: not loop.busy)
    assert "ended by signal SIGKILL" in loop.job()["job"]["error"]
    loop.start("compare")
    until(lambda: not loop.busy)
    assert loop.job()["job"]["error"] == "" and "verdict" in at_hand(loop)


def test_it_compares_and_diagnoses_by_itself_and_gives_way(loop: Loop) -> None:
    """Nobody has to ask; who asks does not wait for what nobody asked for; afterwards it goes on with the new model."""
    loop.attend()
    until(lambda: (job := loop.job()["job"]) and job["what"] == "diagnose" and job["running"])
    assert at_hand(loop)["verdict"]["kind"] == "bad", "the comparison's answer is there while the diagnosis runs"
    assert loop.start("undo"), "a job that nobody asked for holds nobody up"
    until(lambda: (job := loop.job()["job"]) and job["what"] == "diagnose" and job["running"])  # and is begun again afterwards
    assert loop.job()["job"]["automatic"]


def test_partial_answers_come_while_it_works(loop: Loop, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[tuple[str, ...]] = []
    said: list[str] = []
    take = loop._take

    def heard(job: Job, message: Any) -> None:
        take(job, message)
        seen.append(tuple(at_hand(loop)))
        said.append(job.says)

    monkeypatch.setattr(loop, "_take", heard)
    loop.start("compare")
    until(lambda: not loop.busy)
    first = next(k for k, names in enumerate(seen) if "verdict" in names)
    assert "dependence" not in seen[first], "the verdict does not wait for the rest"
    assert any("trials compared" in s and "leave the sets so far" in s for s in said)
    loop.start("diagnose")
    until(lambda: not loop.busy)
    assert any(s.startswith("so far: spring at bend") for s in loop.job()["job"]["steps"])


def test_a_job_can_be_stopped_and_is_not_begun_again(loop: Loop) -> None:
    loop.attend()
    until(lambda: loop.busy)
    what = loop.job()["job"]["what"]
    assert loop.start("stop") and not loop.busy
    time.sleep(0.3)
    job = loop.job()["job"]
    assert job["stopped"] and job["what"] == what and not job["running"]


def test_recordings_are_chosen_each_with_its_condition(loop: Loop, altered: Path) -> None:
    assert [r["chosen"] for r in loop.snapshot()["recordings"]] == [True, False]
    loop.choose([0, 1], ["", "tool=none"])
    assert loop._order("add", {}).conditions == (f"tool=none@{altered / 'healthy.parquet'}",)
    loop.start("add", effect="spring", joint="bend")
    until(lambda: not loop.busy)
    assert "2 conditions" in loop.job()["job"]["error"], "what differs is not taken as one"
    for files, conditions, says in (
        ([], ["", ""], "mark one"), ([7], ["", ""], "mark one"), ([0], ["payload", ""], "payload=2.8 kg"), ([0], ["a=1@x", ""], "KEY=VALUE"),
        ([0], [""], "reload"),
    ):  # fmt: skip
        with pytest.raises(RecordingError, match=says):
            loop.choose(files, conditions)


def test_an_fmu_and_a_plan_to_take_away(loop: Loop, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    loop.start("fmu")
    until(lambda: not loop.busy)
    assert loop.job()["job"]["error"] == "" and (loop.fmu("0") or b"").startswith(b"PK") and loop.fmu("1") is None
    assert (tmp_path / "m.r0.fmu").is_file()


def long(seconds: float) -> Scene:
    """A quarter of an hour at 250 Hz of six joints, a spike of one sample somewhere in it."""
    t = np.arange(round(250 * seconds)) / 250.0
    q = np.sin(t[:, None] * np.linspace(0.3, 2.0, 6))
    q[123_456, 2], q[200_001, 4] = 9.0, -9.0
    outline = SimpleNamespace(outline=lambda q: np.zeros((8, 3)))
    model: Any = SimpleNamespace(n=6, robot=outline)
    return Scene("long", model, t, q, q - 0.1, q + 0.1, None, None)


def test_a_quarter_of_an_hour_is_drawn_without_losing_a_spike() -> None:
    import json

    scene = long(900.0)
    begin = time.process_time()
    whole = scene.window(0.0, np.inf, scene)
    took = time.process_time() - begin
    assert took < 0.5 and len(json.dumps(whole)) < 600_000, "a stutter"
    lines = whole["joints"]
    assert max(lines[2]["y"]) == 9.0 and min(lines[4]["y"]) == -9.0 and max(len(j["y"]) for j in lines) <= POINTS + 2
    assert max(lines[2]["hi"]) == 9.1, "the band contains the whole band"
    near = scene.window(493.0, 495.0)
    assert len(near["joints"][2]["t"]) > 400 and max(near["joints"][2]["y"]) == 9.0, "every sample of a short stretch"
    assert near["t"][0] >= 493.0 and near["t"][-1] <= 495.01 and near["whole"] > 899.0
    spent = []
    for k in range(20):
        begin = time.process_time()
        scene.window(float(k), float(k) + 60.0)
        spent.append(time.process_time() - begin)
    assert np.median(spent) < 0.05, "dragging the window stays smooth"


def test_diagnose_add_and_the_curve_falls_in_a_browser(altered: Path, tmp_path: Path, browser: Any) -> None:
    """The whole loop as its user clicks it, with the page reloaded and the server away while jobs run."""
    shutil.copy(altered / "m.model.json", tmp_path / "m.model.json")
    loop = Loop(tmp_path / "m.model.json", [altered / "altered.parquet"], tmp_path)
    server = Server(loop, "127.0.0.1", 0)
    server.start()
    loop.attend()
    text = lambda what: browser.find_element("id", what).text  # noqa: E731
    try:
        browser.get(server.url)
        until(lambda: loop.job()["job"]["what"] == "diagnose")
        until(lambda: "diagnose" in text("jobtext"))
        browser.refresh()  # in the middle of a job: it is still there
        until(lambda: "diagnose" in text("jobtext"))
        assert loop.busy or "done in" in text("jobtext")
        until(lambda: "missing" in text("diagnose"))
        assert "The model fails most at bend" in text("says")
        card = browser.find_element("css selector", ".card")
        assert "spring at bend" in card.text and "N m/rad" in card.text and card.find_element("css selector", "canvas.evidence")
        card.find_element("css selector", "button.take").click()
        until(lambda: "add spring" in text("jobtext"))
        server.shutdown()  # the connection is lost in the middle of a job
        server.server_close()
        until(lambda: "does not answer" in text("jobtext"))
        server = Server(loop, "127.0.0.1", server.port)
        server.start()
        until(lambda: "revision 1" in text("data"))
        browser.execute_script("window.whole = show; show = () => { throw new Error('no such row'); }; shown = -1")
        until(lambda: "a defect of stopset (no such row)" in text("jobtext"))  # not: the workbench is gone
        browser.execute_script("show = window.whole")
        until(lambda: "defect" not in text("jobtext"))
        until(lambda: "compare-1" in loop.snapshot()["reports"] and "diagnose-1" in loop.snapshot()["reports"])
        bars = browser.execute_script(
            "return document.querySelector('#waterfall canvas').getAttribute('aria-label')"
        )  # at once: it is drawn anew
        values = [float(part.rsplit(" ", 1)[1]) for part in bars.partition("]")[2].partition(": ")[2].split(", ")]
        assert values[-1] < 0.5 * values[0], bars
        until(lambda: "%" in text("sides"))
        assert browser.find_element("id", "beside").get_attribute("value") == "0", "before and after over one another"
        scene = loop.scene(loop.snapshot()["models"][1]["answers"]["recordings"]["listed"][0]["label"], 0.0, 1.0, beside=0)
        assert scene is not None
        widths = [np.max(np.subtract(b["hi"], b["lo"])) for b in (scene["joints"][2], scene["before"][2])]
        assert widths[0] != widths[1], "predictions of both models over one recording"
        span = browser.execute_script("return scene.t[scene.t.length - 1]")
        browser.find_element("id", "closer").click()
        until(lambda: browser.execute_script("return scene.t[scene.t.length - 1] - scene.t[0]") < 0.5 * span)
        field = browser.find_element("css selector", ".condition")
        browser.execute_script("arguments[0].value = 'payload'", field)
        browser.refresh()
        until(lambda: "payload=2.8 kg" in refused(browser))
        assert [
            e
            for e in browser.get_log("browser")
            if e["level"] == "SEVERE" and "net::ERR_" not in e["message"] and "400" not in e["message"]
        ] == []
    finally:
        browser.get("about:blank")
        server.shutdown()
        server.server_close()
        loop.close()
    assert load_model(tmp_path / "m.r1.model.json").revisions[-1].added == "spring:bend"


def refused(browser: Any) -> str:
    """What the page says beside a condition of another form."""
    fields = browser.find_elements("css selector", ".condition")
    if not fields:
        return ""
    browser.execute_script("arguments[0].value = 'payload'; document.getElementById('choose').click()", fields[0])
    wait(lambda: browser.find_element("id", "choosesays").text, 0.5)
    return str(browser.find_element("id", "choosesays").text)
