"""`stopset stops`: rows with the agreed keys, shapes of the vendors' tables, files, separation terms, refusals in one sentence."""

from __future__ import annotations

import csv
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pypdf import PdfReader

from stopset.artifact import load_model, save_model
from stopset.cli.main import main
from stopset.errors import NotCovered
from stopset.offline.report.pdf import Document, Plot
from stopset.offline.stops.page import build_page
from stopset.offline.stops.shown import up
from stopset.offline.stops.table import StopRow
from stopset.reach.stops import Ramp, StopBounds
from stopset.reach.stops.ramp import KEY
from stopset.reach.stops.start import Extrapolation
from stopset.sets import Box

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from stop_arms import prbt_like, ur5_like

KEYS = [
    "category",
    "joint",
    "speed_percent",
    "payload_percent",
    "extension_percent",
    "time_s",
    "angle_rad",
    "tcp_m",
    "certified",
    "why",
    "end_stops",
]
RAMP = ["--ramp-time", "0.3", "--off-after", "0.33"]
SWEPT = np.array([[0.0, 0.0, 0.2, 0.0, 0.0, 0.5, 0.1], [0.0, 0.0, 0.5, 0.3, 0.3, 0.9, 0.4]])  # capsules [m]
TERMS = ["--reaction", "0.1", "--intrusion", "0.85", "--person-uncertainty", "0.1", "--robot-uncertainty", "0.02"]


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("stops") / "p.model.json"
    save_model(prbt_like((0.0, 1.0)), path)
    return str(path)


@pytest.fixture(scope="module")
def rows(model: str, tmp_path_factory: pytest.TempPathFactory) -> list[dict]:  # type: ignore[type-arg]
    folder = tmp_path_factory.mktemp("out")
    files = [
        f"{o}={folder / f}" for o, f in (("--json", "a.json"), ("--csv", "a.csv"), ("--pdf", "a.pdf"), ("--report", "a.html"))
    ]
    assert main(["stops", model, *files, *RAMP]) == 0
    out = json.loads((folder / "a.json").read_text())
    table = list(csv.DictReader((folder / "a.csv").open()))
    assert len(table) == len(out) and table[0]["time [s]"] == str(out[0]["time_s"])
    paper = pdf_text(folder / "a.pdf")
    for r in out:  # every number of every row is on paper, whole
        assert all(up(r[k], 4) in paper for k in ("time_s", "angle_rad", "tcp_m") if r[k] is not None)
    html = (folder / "a.html").read_text()
    assert "<html" in html and 'src="http' not in html and "Not a safety function" in html
    return out


def pick(rows, **want):  # type: ignore[no-untyped-def]
    found = [r for r in rows if all(r[k] == v for k, v in want.items())]
    assert found
    return found


def test_rows_have_the_agreed_keys_and_the_whole_grid(rows: list[dict]) -> None:  # type: ignore[type-arg]
    assert all(list(r) == KEYS for r in rows)
    for category in ("0", "1", "1 guaranteed", "2"):
        grid = {
            (r["joint"], r["speed_percent"], r["payload_percent"], r["extension_percent"]) for r in pick(rows, category=category)
        }
        singles = {g for g in grid if "+" not in g[0]}
        assert len(singles) == 81 and len(grid) == 81 + 9  # three axes x 27, and all three at once at full extension
    for r in rows:
        numbers = [r["time_s"], r["angle_rad"], r["tcp_m"]]
        assert all(isinstance(x, float) for x in numbers) if r["certified"] else numbers == [None] * 3 and r["why"]


def test_stop0_full_extension_is_certified_and_shaped_like_vendors_tables(rows: list[dict]) -> None:  # type: ignore[type-arg]
    stop0 = [r for r in pick(rows, category="0") if "+" not in r["joint"]]
    assert all(r["certified"] for r in stop0)
    for joint in {r["joint"] for r in stop0}:
        a, b, c = (
            pick(stop0, joint=joint, speed_percent=float(s), payload_percent=100.0, extension_percent=100.0)[0]
            for s in (33, 66, 100)
        )
        # between linear (delay) and quadratic (brake) in speed, so the ratio at three times the speed lies between 2 and 9
        assert 2.0 < c["angle_rad"] / a["angle_rad"] < 9.0 and a["angle_rad"] < b["angle_rad"] < c["angle_rad"]
        assert a["time_s"] < b["time_s"] < c["time_s"]
        # free fall in the delay raises s / (v t) above a constant deceleration's 0.5
        assert 0.35 <= c["angle_rad"] / (1.26 * c["time_s"]) <= 1.1
    flat = pick(stop0, joint="arm_1_joint", speed_percent=100.0, payload_percent=100.0, extension_percent=100.0)[0]
    down = pick(stop0, joint="arm_2_joint", speed_percent=100.0, payload_percent=100.0, extension_percent=100.0)[0]
    assert down["angle_rad"] > 1.1 * flat["angle_rad"] and down["time_s"] > flat["time_s"]


def test_fixed_time_ramps_are_linear_and_do_not_know_the_load(rows: list[dict]) -> None:  # type: ignore[type-arg]
    nominal = pick(rows, category="1", joint="arm_1_joint", extension_percent=100.0)
    noise = 0.01 * (0.024 + 0.15)  # speed noise of 10 mrad/s over the ramp
    by = {(r["payload_percent"], r["speed_percent"]): r["angle_rad"] - noise for r in nominal}
    for load in (33.0, 66.0, 100.0):
        assert by[load, 66.0] / by[load, 33.0] == pytest.approx(2.0, rel=1e-3)
        assert by[load, 100.0] / by[load, 33.0] == pytest.approx(100 / 33, rel=1e-3)
        assert by[load, 100.0] == pytest.approx(by[33.0, 100.0], rel=1e-6)


def test_guaranteed_is_never_shorter_than_power_off(rows: list[dict]) -> None:  # type: ignore[type-arg]
    keys = ("joint", "speed_percent", "payload_percent", "extension_percent")
    off = {tuple(r[k] for k in keys): r for r in pick(rows, category="0")}
    for r in pick(rows, category="1 guaranteed"):
        if r["certified"]:
            assert r["angle_rad"] >= off[tuple(r[k] for k in keys)]["angle_rad"]


def test_a_pose_with_all_axes_and_its_separation_distance(model: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "at.json"
    terms = ["--separation", "--v-human", "1.6", "--reaction", "0.1", "--intrusion", "0.85", "--person-uncertainty", "0.1"]
    pose = ["--at", "0.1,0.5,0.3,-0.4,0.2,0.1", "--speed", "1,0.8,-0.7,0.3,0.5,-1", "--category", "0"]
    assert main(["stops", model, *pose, *terms, "--robot-uncertainty", "0.02", "--json", str(out)]) == 0
    rows = json.loads(out.read_text())
    assert len(rows) == 6 and all(r["certified"] for r in rows)
    text = capsys.readouterr().out
    time, tcp = max(r["time_s"] for r in rows), rows[0]["tcp_m"]
    speed = float(next(x for x in text.splitlines() if x.strip().startswith("v_r")).split()[1])
    total = float(next(x for x in text.splitlines() if "15066" in x).split()[-2])
    # printed rounded up to 1 mm, the speed to 1e-4 m/s
    exact = 1.6 * (0.1 + time) + 0.1 * speed + tcp + 0.85 + 0.1 + 0.02
    assert exact - 1e-5 <= total <= exact + 1.1e-3


@pytest.mark.parametrize(
    ("extra", "word"),
    [
        (["--payload", "4"], "payload of 4 kg lies outside"),
        (["--at", "9,0,0,0,0,0", "--speed", "1,1,1,1,1,1"], "beyond its limits"),
        (["--at", "0,0,0,0,0,0", "--speed", "5,1,1,1,1,1"], "beyond its limit"),
        (["--at", "0,0,0", "--speed", "1,1,1,1,1,1"], "expected 6"),
        (["--at", "0,0,0,0,0,0"], "--speed"),
        (["--at", "0,0,0,0,0,0", "--speed", "50%", "--separation", "--v-human", "1.6"], "missing"),
        (["--ramp-time", "-1"], "positive"),
        (["--off-after", "0.1"], "--ramp-time"),
        (["--fail-together"], "--ramp-time"),
        (["--ramp-time", "inf"], "positive"),
        (["--ramp-time", "1e9"], "at most 60 s"),
        (["--ramp-time", "0"], "positive"),
        (["--ramp-time", "0.3", "--ramp-deceleration", "4"], "exactly one"),
        (["--ramp-deceleration", "1e9"], "at most"),
        (["--ramp-deceleration", "nan"], "positive"),
        (["--ramp-time", "0.3", "--off-after", "nan"], "not negative"),
        (["--ramp-time", "0.3", "--off-after", "1e9"], "0 to 60 s"),
        (["--ramp-time", "0.3", "--off-after", "0.33", "--failed-speed", "nan"], "not negative"),
        (["--ramp-time", "0.3", "--off-after", "0.33", "--failed-speed", "-5"], "not negative"),
        (["--ramp-time", "0.3", "--off-after", "0.33", "--failed-speed", "1e9"], "0 to 1000 %"),
        (["--payload", "nan"], "at least 0 kg"),
        (["--payload", "1e9", "--extrapolate-payload"], "at most 1000 kg"),
        (["--payload", "inf", "--extrapolate-payload"], "at most 1000 kg"),
        (["--rated-payload", "nan", "--extrapolate-payload"], "a rated payload of nan kg"),
        (["--rated-payload", "-3", "--extrapolate-payload"], "a rated payload of -3 kg"),
        (["--rated-payload", "1e-300", "--payload", "1"], "a rated payload"),
        (["--payload-at", "1e9,0,0"], "at most 10 m"),
        (["--payload-at", "nan,0,0"], "finite"),
        (["--payload-at", "0,0,0,0"], "expected 3"),
        (["--at", "0,0,0,0,0,0", "--speed=-50%"], "expected 0 to 100 %"),
        (["--at", "0,0,0,0,0,0", "--speed", "nan%"], "finite"),
        (["--at", "0,0,0,0,0,0", "--speed", "1e9,0,0,0,0,0"], "beyond its limit"),
        (["--at", "0,0,0,0,0,0", "--speed", "nan,0,0,0,0,0"], "finite"),
        (["--at", "inf,0,0,0,0,0", "--speed", "50%"], "finite"),
        (["--at", "0,0,0,0,0,0", "--speed", "50%", "--path-rate", "1"], "--path"),
        (["--path-start", "1"], "--path"),
        (["--at", "0,0,0,0,0,0", "--speed", "50%", *TERMS, "--v-human", "nan", "--separation"], "v_h = nan"),
        (["--at", "0,0,0,0,0,0", "--speed", "50%", *TERMS, "--v-human", "-1", "--separation"], "at least 0"),
        (["--at", "0,0,0,0,0,0", "--speed", "50%", *TERMS, "--v-human", "1.6", "--separation", "--supplement", "1"], "D_DS"),
        (["--ramp-time", "0.3", "--off-after", "-1"], "not negative"),
        (["--ramp-time", "nan"], "positive"),
        (["--payload", "-1", "--extrapolate-payload"], "at least 0 kg"),
        (["--rated-payload", "3"], "--extrapolate-payload"),
        (["--payload-at", "0,0"], "expected 3"),
        (["--at", "0,0,0,0,0,x", "--speed", "50%"], "not numbers"),
        (["--at", "0,0,0,0,0,0", "--speed", "120%"], "beyond what 100 % means"),
        (["--speed", "50%"], "give --at"),
        (["--at", "0,0,0,0,0,0", "--speed", "50%", "--v-human", "1.6"], "without --separation"),
    ],
)
def test_bad_questions_get_one_sentence(model: str, extra: list[str], word: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["stops", model, *extra]) == 2
    said = [line for line in capsys.readouterr().err.splitlines() if not line.startswith("[")]  # progress is no answer
    assert len(said) == 1 and word in said[0]


@pytest.mark.parametrize(
    ("radii", "word"),
    [
        ((np.full(6, -0.01), np.zeros(6)), "at least 0"),
        ((np.zeros(6), np.full(6, np.nan)), "finite"),
        ((np.zeros(5), np.zeros(6)), "expected 6"),
        ((np.zeros(6), np.float64(0.1)), "expected 6"),
        ((np.full(6, np.inf), np.zeros(6)), "finite"),
    ],
)
def test_half_widths_that_are_none_are_refused(radii: tuple[np.ndarray, np.ndarray], word: str) -> None:
    bounds = StopBounds.of(prbt_like((0.0, 0.25)), ramp=Ramp.stated(6, time=0.3).failing(off_after=0.1))
    for ask in (lambda *x, c=c: bounds.bound(*x[:2], c, *x[2:]) for c in ("0", "1", "1 guaranteed", "2")):
        with pytest.raises(NotCovered, match=word):
            ask(np.zeros(6), np.zeros(6), *radii)


@pytest.mark.parametrize("at", [np.zeros(2), np.full(3, np.nan), np.array([1e9, 0, 0])])
def test_a_payloads_centre_that_is_none_is_refused(at: np.ndarray) -> None:
    with pytest.raises(NotCovered, match="expected three numbers"):
        StopBounds.of(prbt_like(), payload_com=at)


def test_power_off_alone_is_told_where_the_model_holds_the_ramp(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = tmp_path / "r.model.json", tmp_path / "r.json"
    save_model(replace(prbt_like(), provenance={KEY: Ramp.stated(6, time=0.3).as_dict()}), path)
    asked = ["stops", str(path), "--at", "0.1,0.5,0.3,-0.4,0.2,0.1", "--speed", "50%", "--category", "1 guaranteed"]
    assert main(asked) == 1 and "--off-after" in capsys.readouterr().out
    for extra in (["--off-after", "0.1"], ["--monitored"], ["--off-after", "0.1", "--fail-together"]):
        assert main([*asked, *extra, "--json", str(out)]) == 0
        assert all(r["certified"] for r in json.loads(out.read_text()))
    assert main([*asked, "--off-after", "nan"]) == 2 and "SS1-t time" in capsys.readouterr().err


def test_missing_brakes_are_a_reason_and_no_number(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = tmp_path / "n.model.json", tmp_path / "n.json"
    save_model(replace(ur5_like(), brakes=None), path)  # its description has no data sheet beside it
    assert main(["stops", str(path), "--at", "0,0,0,0,0,0", "--speed", "50%", "--category", "0", "--json", str(out)]) == 1
    rows = json.loads(out.read_text())
    assert rows and all(not r["certified"] and r["time_s"] is r["angle_rad"] is r["tcp_m"] is None for r in rows)
    assert all("no brake" in r["why"] for r in rows) and "no brake" in capsys.readouterr().out


def test_a_payload_no_recording_carried_is_marked_everywhere(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "bare.model.json"
    save_model(prbt_like((0.0, 0.0)), path)  # as identification without payloads leaves it
    rows, table = tmp_path / "r.json", tmp_path / "r.csv"
    asked = ["--at", "0.1,0.5,0.3,-0.4,0.2,0.1", "--speed", "50%", "--category", "0", "--payload", "3"]
    assert main(["stops", str(path), *asked]) == 2
    assert "--extrapolate-payload" in capsys.readouterr().err
    assert main(["stops", str(path), *asked, "--extrapolate-payload", "--json", str(rows), "--csv", str(table)]) == 0
    found = json.loads(rows.read_text())
    assert all(r["extrapolated"] is True and r["certified"] is False and "EXTRAPOLATED" in r["why"] for r in found)
    assert all(r["time_s"] > 0 and any("EXTRAPOLATED PAYLOAD" in a for a in r["assumptions"]) for r in found)
    text = capsys.readouterr().out
    assert "EXTRAPOLATED PAYLOAD" in text and "EXTRAPOLATED PAYLOAD" in table.read_text()
    light = tmp_path / "l.json"
    assert main(["stops", str(path), *asked[:-2], "--json", str(light)]) == 0
    assert "extrapolated" not in light.read_text()
    by = [max(r["angle_rad"] for r in json.loads(f.read_text())) for f in (light, rows)]
    assert by[1] > by[0]


def test_a_table_without_payloads_says_how_to_get_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = tmp_path / "bare.model.json", tmp_path / "t.json"
    save_model(prbt_like((0.0, 0.0)), path)
    assert main(["stops", str(path), "--category", "0"]) == 0
    assert "--rated-payload" in capsys.readouterr().out
    rated = ["--rated-payload", "3", "--extrapolate-payload", "--json", str(out)]
    assert main(["stops", str(path), "--category", "0", *rated]) == 0
    rows = json.loads(out.read_text())
    assert {r["payload_percent"] for r in rows} == {33.0, 66.0, 100.0} and all(
        r["extrapolated"] and not r["certified"] for r in rows
    )


def test_the_page_opens_with_the_answer_and_says_each_remark_once(model: str, browser: Any, tmp_path: Path) -> None:
    from test_pages import drawn, figures

    page = tmp_path / "s.html"
    asked = ["stops", model, "--at", "0,0.9,0,0,0,0", "--speed", "50%", "--ramp-time", "0.3"]  # nothing says when power is taken
    assert main([*asked, "--report", str(page), "--json", str(tmp_path / "s.json")]) == 0
    text = drawn(browser, page)
    reported = json.loads((tmp_path / "s.json").read_text())
    assert (
        text.splitlines()[2].startswith("✕")
        or f"{sum(r['certified'] for r in reported)} of {len(reported)} stops proved" in text[:400]
    )
    assert "What next" in text[:1200] and figures(browser) >= 1 and "Where the flange goes farthest" in text
    for why in {part for r in reported for part in r["why"].split("; ") if part}:
        assert text.count(why) == 1, why
    assert any(not r["certified"] for r in reported)


def test_a_refusal_stands_once_and_the_worst_pose_shows_what_is_swept(model: str, browser: Any, tmp_path: Path) -> None:
    from test_pages import drawn

    page = tmp_path / "s.html"
    arm, none = load_model(model), "no stop provable: nothing says when power is taken if the ramp fails"
    rows = [
        StopRow(c, "arm_2_joint", s, 100.0, 100.0, s / 100, 1.0, *(3 * [None if refused else s / 1000]), None, not refused,
                f"not covered in 1 of 2 directions; {none}" if refused else "", tuple(np.full(6, 0.4)), swept=SWEPT)
        for c, refused in (("0", False), ("1 guaranteed", True)) for s in (33.0, 66.0, 100.0)
    ]  # fmt: skip
    build_page(arm, rows, ["an assumption"], (), ()).save(page)
    text = drawn(browser, page)
    assert text.count(none) == 1 and "None of 3 rows has a number: [1] [2]." in text, "however many rows it is the reason of"
    assert "3 of 6 rows have no number; [2] below say" in text
    assert text.count("all axes\t-\t-\t-\t0 of 3") == 1 and "STOP 0 within 0.100 s" in text
    colours = browser.execute_script(
        "return [...document.querySelectorAll('.drawn g')].map(g => [g.getAttribute('stroke'), g.querySelectorAll('path').length])"
    )
    assert [n for colour, n in colours if colour == "#f0a202"] == [2, 2], "both capsules in both views"
    box, view = browser.execute_script(
        "const g = document.querySelector('.drawn g').getBoundingClientRect(), v = document.querySelector('.drawn svg').getBoundingClientRect();"
        " return [[g.left, g.right, g.top, g.bottom], [v.left, v.right, v.top, v.bottom]]"
    )
    assert view[0] <= box[0] and box[1] <= view[1] and view[2] <= box[2] and box[3] <= view[3], "nothing of it is cut off"


def test_states_beyond_the_recordings_have_no_number_unless_asked_for_and_then_a_mark_everywhere(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arm = prbt_like((0.0, 1.0))
    narrow = replace(arm, domain=replace(arm.domain, q=Box.symmetric(np.full(6, 0.3))))
    slow = replace(arm, domain=replace(arm.domain, dq=Box.symmetric(np.full(6, 0.5))))
    out = [tmp_path / f"o.{x}" for x in ("json", "csv", "html", "pdf")]
    files = [f"--{o}={f}" for o, f in zip(("json", "csv", "report", "pdf"), out, strict=True)]
    for model, pose, speed, word in (
        (narrow, "0,0.9,0,0,0,0", "50%", "arm_2_joint at 0.9 rad"), (slow, "0,0,0,0,0,0", "1,0,0,0,0,0", "arm_1_joint at 1 rad/s"),
    ):  # fmt: skip
        path = tmp_path / "d.model.json"
        save_model(model, path)
        asked = ["stops", str(path), "--at", pose, "--speed", speed, "--ramp-time", "0.3", "--off-after", "0.33"]
        assert main([*asked, "--json", str(out[0])]) == 1
        rows = json.loads(out[0].read_text())
        assert len(rows) == 24 and all(list(r) == KEYS and not r["certified"] for r in rows)
        assert all(r["time_s"] is r["angle_rad"] is r["tcp_m"] is None and "not covered" in r["why"] for r in rows)
        assert word in (text := capsys.readouterr().out) and "EXTRAPOLATED" not in text and "--extrapolate-state" in text
        assert main([*asked, "--extrapolate-state", *files]) == 0
        rows = json.loads(out[0].read_text())
        assert all(list(r) == [*KEYS, "extrapolated", "assumptions"] for r in rows)
        assert all(r["extrapolated"] is True and r["certified"] is False and r["time_s"] > 0 for r in rows)
        assert all("EXTRAPOLATED STATE" in r["why"] and any("EXTRAPOLATED" in a for a in r["assumptions"]) for r in rows)
        text = capsys.readouterr().out
        assert text.count("EXTRAPOLATED") > 24 and "EXTRAPOLATED STATE" in text and word in text and "not certified" in text
        assert out[1].read_text().count("EXTRAPOLATED STATE") >= 24
        page = out[2].read_text()
        assert "0 of 24 stops proved" in page and "EXTRAPOLATED STATE: 24 of 24 rows" in page and "0 of 4, 4" not in page
        assert "EXTRAPOLATED STATE: 24 of 24 rows" in pdf_text(out[3])
    inside = ["stops", str(tmp_path / "d.model.json"), "--at", "0,0.2,0,0,0,0", "--speed", "50%", "--category", "0"]
    assert main(inside) == 0 and "EXTRAPOLATED" not in capsys.readouterr().out
    # and the object
    bound = StopBounds.of(narrow, extrapolate=Extrapolation(state=True)).bound(np.array([0, 0.9, 0, 0, 0, 0]), np.full(6, 0.1))
    assert not bound.certified and bound.time is not None and bound.extrapolated.startswith("EXTRAPOLATED STATE")
    bound = StopBounds.of(narrow).bound(np.array([0, 0.9, 0, 0, 0, 0]), np.full(6, 0.1))
    assert not bound.certified and bound.time is bound.angle is bound.tcp is None and not bound.extrapolated


def pdf_text(path: Path) -> str:
    """Words of a PDF file's pages, lines joined."""
    return " ".join(" ".join(page.extract_text() for page in PdfReader(path).pages).split())


def test_a_sheet_cuts_no_word_and_is_the_same_twice(tmp_path: Path) -> None:
    def sheet(name: str) -> Path:
        doc = Document("A & <B>", "foot")
        doc.heading("A & <B>")
        doc.table(("axis", "remark"), [("a_joint_whose_name_is_long " * 4, f"row {k} ends here") for k in range(200)], (1, 1))
        doc.plots([Plot("joint", [("0 kg", (0.0, 1.0), (0.0, 2.0))], ((0.5,), (1.0,)), "speed", "time") for _ in range(2)])
        (tmp_path / name).write_bytes(doc.bytes())
        return tmp_path / name

    one, two = sheet("one.pdf"), sheet("two.pdf")
    said = pdf_text(one)
    assert one.read_bytes() == two.read_bytes()
    assert "A & <B>" in said and said.count("a_joint_whose_name_is_long") == 800 and said.count("ends here") == 200
    heads = [page.extract_text().count("remark") for page in PdfReader(one).pages]
    assert len(heads) > 3 and all(heads[:-1]), "every page repeats the head"


def test_a_table_keeps_to_the_poses_that_recordings_hold(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A narrow domain: bent poses are taken from it, those it cannot hold (the stretched arm) are not covered, with the joints."""
    arm, out = prbt_like((0.0, 0.0)), tmp_path / "t.json"
    narrow = replace(arm, domain=replace(arm.domain, q=Box.of([-1.0, 0.6, 0.6, -1, -1, -1], [1.0, 1.4, 1.4, 1, 1, 1])))
    save_model(narrow, tmp_path / "n.model.json")
    assert main(["stops", str(tmp_path / "n.model.json"), "--category", "0", "--json", str(out)]) == 0
    rows = json.loads(out.read_text())
    assert {r["extension_percent"] for r in rows if r["certified"]} and not any(
        r["certified"] for r in rows if r["extension_percent"] == 100.0
    )
    assert all("not covered" in r["why"] for r in rows if not r["certified"])
    assert "those are not covered" in capsys.readouterr().out


def test_holding_margins_are_printed_in_newton_metres(model: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["stops", model, "--at", "0.1,0.5,0.3,-0.4,0.2,0.1", "--speed", "50%", "--category", "0"]) == 0
    line = next(x for x in capsys.readouterr().out.splitlines() if "holding margin" in x)
    assert "[N m]" in line and all(f"arm_{j}_joint" in line for j in range(1, 7))


def test_separation_is_refused_where_a_stop_has_no_number(model: str, capsys: pytest.CaptureFixture[str]) -> None:
    """STOP 1 guaranteed without a time for power-off has no number, so it has no separation distance; the others have."""
    terms = ["--separation", "--v-human", "1.6", "--reaction", "0.1", "--intrusion", "0.85", "--person-uncertainty", "0.1"]
    pose = ["--at", "0.1,0.5,0.3,-0.4,0.2,0.1", "--speed", "50%", "--ramp-time", "0.3", "--robot-uncertainty", "0.02"]
    assert main(["stops", model, *pose, *terms]) == 0
    text = capsys.readouterr().out
    assert "STOP 0:" in text and "STOP 1 guaranteed:" not in text
    assert main(["stops", model, *pose, *terms, "--category", "1 guaranteed"]) == 2
    assert "no separation distance" in capsys.readouterr().err
    assert main(["stops", model, *pose, *terms, "--device-distance", "0.2", "--supplement", "0.1", "--category", "0"]) == 0
    assert "ISO 13855:2024" in capsys.readouterr().out


def test_extension_means_what_it_says() -> None:
    from stopset.offline.stops.poses import Poses

    robot = prbt_like().robot
    poses = Poses.of(robot, robot.tip, prbt_like().domain.q)
    assert 0.70 < poses.reach < 0.76  # 0.350 + 0.305 + 0.084 m stretched
    for share in (0.33, 0.66, 1.0):
        q = poses.worst_for(1, share, robot.pi)
        assert abs(poses.extension_of(q) - share) <= 0.021
        assert np.all(q >= robot.q_limit[:, 0]) and np.all(q <= robot.q_limit[:, 1])


def test_only_a_pdf_needs_what_sets_one(model: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [
        m for m in sys.modules if m.startswith(("reportlab", "stopset.offline.report.pdf", "stopset.offline.stops.safety_file"))
    ]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "reportlab", None)
    words = ["stops", model, "--at=0,0.2,0.3,0,0.1,0", "--speed", "20%", "--category", "0"]
    assert main([*words, "--report", str(tmp_path / "a.html")]) in (0, 1)
    assert (tmp_path / "a.html").exists()
    assert main([*words, "--pdf", str(tmp_path / "a.pdf")]) == 2
    assert not (tmp_path / "a.pdf").exists()
