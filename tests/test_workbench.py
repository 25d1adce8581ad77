"""The workbench as its user meets it: a served page in a real browser, and what others in that browser may not do."""

from __future__ import annotations

import json
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import patience
from stopset.artifact import load_model
from stopset.errors import BusError, OutputError, RecordingError
from stopset.offline.workbench import Loop, Server


@pytest.fixture
def server(planar: Any, tmp_path: Path) -> Iterator[Server]:
    folder = planar[0]
    s = Server(Loop(folder / "m.model.json", [folder / "rec.parquet"], tmp_path), "127.0.0.1", 0)
    s.start()
    yield s
    s.shutdown()
    s.server_close()
    s.loop.close()


def call(s: Server, path: str, body: bytes | None = None, **headers: str) -> tuple[int, str]:
    try:
        with urllib.request.urlopen(urllib.request.Request(s.url + path, data=body, headers=headers)) as reply:
            return int(reply.status), reply.read().decode()
    except urllib.error.HTTPError as e:
        return e.code, e.read().decode()


def do(s: Server, action: str, **options: Any) -> tuple[int, str]:
    return call(s, f"do/{action}", json.dumps(options).encode(), **{"X-Stopset-Token": s.token})


def wait(s: Server) -> dict[str, Any]:
    assert patience.wait(lambda: not s.loop.busy, 120.0), "the job never ended"
    return dict(json.loads(call(s, "state")[1]))


def test_the_loop_answers_as_the_commands_do(server: Server, planar: Any, tmp_path: Path) -> None:
    from stopset.cli.main import main

    folder = planar[0]
    assert do(server, "compare")[0] == 200
    mine = wait(server)["models"][-1]["answers"]["compare"]
    main(["compare", str(folder / "m.model.json"), "--data", str(folder / "rec.parquet"), "--json", str(tmp_path / "c.json")])
    assert mine == json.loads((tmp_path / "c.json").read_text())
    assert "Identified sets" in call(server, "report/compare-0")[1]


def test_a_revision_is_a_new_file_and_becomes_the_model_at_hand(server: Server, planar: Any, tmp_path: Path) -> None:
    was = (planar[0] / "m.model.json").read_bytes()
    assert do(server, "add", effect="spring", joint=load_model(planar[0] / "m.model.json").joints[0], force=True)[0] == 200
    state = wait(server)
    assert state["job"]["error"] == ""
    if len(state["models"]) == 1:  # no trace of a spring in these data: refused, with the numbers, and nothing written
        assert state["models"][0]["answers"]["add"]["before"]["held_out_torque_rmse"] > 0
        assert list(tmp_path.iterdir()) == []
    else:
        saved = load_model(state["models"][-1]["file"])
        assert saved.sha256 == state["models"][-1]["sha256"]
        assert saved.revisions[-1].added.startswith("spring")
    assert (planar[0] / "m.model.json").read_bytes() == was


def test_an_error_is_shown_and_the_next_action_still_runs(server: Server) -> None:
    do(server, "add", effect="no_such_effect")
    assert "no_such_effect" in wait(server)["job"]["error"]
    do(server, "compare")
    assert wait(server)["job"]["error"] == ""


def test_one_action_at_a_time(server: Server) -> None:
    assert do(server, "diagnose")[0] == 200
    assert do(server, "compare") == (409, "another action is running; wait for its end")
    wait(server)


def test_other_pages_of_the_same_browser_can_do_nothing(server: Server) -> None:
    assert call(server, "do/compare", b"{}")[0] == 403, "started without the page's token"
    assert call(server, "state", Host="evil.example")[0] == 403, "answered to a foreign name (DNS rebinding)"
    assert not server.loop.busy


@pytest.mark.parametrize(
    ("action", "body", "says"),
    [
        ("remove", b"{}", "no action 'remove'"), ("compare", b'{"force": true}', "compare takes none"), ("add", b'{"effect": 3}', "add takes"),
        ("add", b"[]", "expected an object"), ("add", b"{", "no JSON"), ("add", b" " * 5000, "at most 4096"),
    ],
)  # fmt: skip
def test_a_wrong_request_gets_a_sentence(server: Server, action: str, body: bytes, says: str) -> None:
    code, text = call(server, f"do/{action}", body, **{"X-Stopset-Token": server.token})
    assert code == 400 and says in text


def test_the_arm_over_a_recording(server: Server) -> None:
    """Every recording can be looked at; the line keeps its extremes, and lies in the band where nothing is violated."""
    assert call(server, "scene/anything")[0] == 404, "nothing compared yet"
    do(server, "compare")
    rows = wait(server)["models"][-1]["answers"]["recordings"]["listed"]
    label = rows[0]["label"]
    code, text = call(server, "scene/" + urllib.parse.quote(label))
    found = json.loads(text)
    assert code == 200 and found["label"] == label and found["violation"] is None
    assert len(found["arm"]) == len(found["t"]) and len(found["arm"][0]) == 4, "base, two joints, flange"
    for j in found["joints"]:
        inside = (
            np.interp(j["t"], j["band_t"], j["lo"]) - 1e-5 <= j["y"],
            np.interp(j["t"], j["band_t"], j["hi"]) + 1e-5 >= j["y"],
        )
        assert np.all(inside)
    assert call(server, "scene/nothing")[0] == 404


def test_it_refuses_before_it_serves(planar: Any, tmp_path: Path) -> None:
    folder = planar[0]
    with pytest.raises(OutputError, match="does not exist"):
        Loop(folder / "m.model.json", [folder / "rec.parquet"], tmp_path / "nowhere")
    with pytest.raises(RecordingError):
        Loop(folder / "m.model.json", [folder / "robot.urdf"], tmp_path / "..")


def test_a_revision_can_be_undone_and_its_file_stays(server: Server, planar: Any, tmp_path: Path) -> None:
    """The list of the diagnosis is there after an add and after an undo; what was written once is never written over."""
    joint = load_model(planar[0] / "m.model.json").joints[0]
    assert "nothing was added here" in undone(server)["job"]["error"]
    do(server, "diagnose")
    before = wait(server)
    do(server, "add", effect="cubic_viscous", joint=joint, force=True)
    state = wait(server)
    assert state["job"]["error"] == "" and len(state["models"]) == 2, state["models"][0]["answers"].get("add")
    first = Path(state["models"][-1]["file"])
    text = first.read_bytes()
    assert first.name == "m.r1.model.json" and "compare" in state["models"][-1]["answers"], "the new model is compared by itself"
    assert state["models"][0]["answers"]["diagnose"] == before["models"][0]["answers"]["diagnose"]
    assert json.loads(call(server, "model/1")[1])["sha256"] == state["models"][-1]["sha256"]
    state = undone(server)
    assert len(state["models"]) == 1 and first.read_bytes() == text and "compare-1" not in state["reports"]
    assert call(server, "model/1")[0] == 404
    do(server, "add", effect="cubic_viscous", joint=joint, force=True)
    assert Path(wait(server)["models"][-1]["file"]).name == "m.r1-2.model.json" and first.read_bytes() == text
    again = Loop(first, [planar[0] / "rec.parquet"], tmp_path)  # starts on its own output
    assert again._free_name("model.json").name == "m.r2.model.json"
    assert (
        Loop(tmp_path / "m.r1-2.model.json", [planar[0] / "rec.parquet"], tmp_path)._free_name("model.json").name
        == "m.r2.model.json"
    )


def undone(s: Server) -> dict[str, Any]:
    do(s, "undo")
    return wait(s)


def test_the_dots_behind_a_share(server: Server) -> None:
    do(server, "compare")
    answers = wait(server)["models"][-1]["answers"]
    shares = answers["dependence"]
    joint = next(iter(answers["compare"]["joints"]))
    code, text = call(server, f"partial/{joint}%2Fdq")
    found = json.loads(text)
    assert code == 200 and found["variable"] == "dq" and len(found["x"]) == len(found["y"]) > 20
    assert len(shares["share"][0]) == len(shares["variables"])
    for path in (
        "partial/nobody%2Fdq",
        f"partial/{joint}%2Fnothing",
        "partial/",
        "model/7",
        "model/-1",
        "model/x",
        "report/none",
    ):
        assert call(server, path)[0] == 404, path


def test_a_port_that_cannot_be_had_is_said_in_a_sentence(server: Server) -> None:
    for port in (99999, server.server_address[1]):  # no port number; taken already
        with pytest.raises(BusError, match="choose another --host or --port"):
            Server(server.loop, "127.0.0.1", int(port))


def test_the_page_in_a_browser(server: Server, browser: Any) -> None:
    browser.get(server.url)
    browser.find_element("css selector", "[data-do=compare]").click()
    compared = patience.wait(lambda: "recordings leave the sets" in browser.find_element("id", "compare").text, 120.0)
    assert compared, browser.find_element("id", "jobtext").text
    text = browser.execute_script("return document.body.innerText")
    assert "Monitoring aid. Not a safety function" in text
    assert browser.find_element("id", "stage").is_displayed()
    before = browser.find_element("id", "now").text
    browser.execute_script("const t = document.getElementById('time'); t.value = 50; t.dispatchEvent(new Event('input'))")
    assert browser.find_element("id", "now").text != before, "the arm goes through the recording"
    assert patience.wait(lambda: browser.find_elements("css selector", ".heat tbody button")), "what it depends on comes later"
    browser.find_element("css selector", ".heat tbody button").click()
    assert patience.wait(lambda: browser.find_element("id", "cloudsays").text)
    for width in (390, 1250):
        size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        beyond = browser.execute_script("return document.documentElement.scrollWidth - document.documentElement.clientWidth")
        assert beyond <= 0, f"{beyond} px beyond a screen of {width} px"
    browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    assert [e for e in browser.get_log("browser") if e["level"] == "SEVERE"] == []
    browser.get("about:blank")  # or the page would go on asking a server that has ended
