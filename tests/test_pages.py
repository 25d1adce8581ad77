"""Pages in a real browser: they draw their figures, log no error, and load nothing from anywhere."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nominal_cases import arm
from stopset.artifact import load_model
from stopset.cli.main import main
from stopset.offline.plan import Wishes, design
from stopset.offline.plan.page import page as plan_page
from stopset.offline.report.arm import WIDE, drawn_arm, telling_pose
from stopset.offline.report.page import Page
from synthetic import names, save_trials

NARROW = 420  # [px] a telephone


def drawn(browser: Any, page: Path) -> str:
    """Open a page wide and narrow, hold what every page promises; its text."""
    for width in (NARROW, 1250):
        size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        browser.get(page.as_uri())
        beyond = browser.execute_script("return document.documentElement.scrollWidth - document.documentElement.clientWidth")
        assert beyond <= 0, f"the page is {beyond} px wider than a screen of {width} px"
        hidden = browser.execute_script(
            "return [...document.querySelectorAll('.plot')].filter(d => d.querySelectorAll('.cartesianlayer .subplot').length === 1"
            " && d.clientWidth > d.closest('.wide, figure, body').clientWidth + 1).length"
        )
        assert hidden == 0, f"of {hidden} pictures of one panel a part is out of sight on a screen of {width} px"
    browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    loaded = browser.execute_script("return performance.getEntriesByType('resource').map(e => e.name)")
    assert [x for x in loaded if not x.startswith(("data:", "blob:"))] == []
    assert [e for e in browser.get_log("browser") if e["level"] == "SEVERE"] == []
    text = str(
        browser.execute_script(
            "document.querySelectorAll('details').forEach(d => {d.open = true}); return document.body.innerText"
        )
    )
    assert "Monitoring aid. Not a safety function" in text and " UTC" in text
    assert page.stat().st_size < 2_000_000, "readable over a slow line"
    printed(browser)
    return text


def printed(browser: Any) -> None:
    """On A4 nothing is wider than the sheet."""
    width = int(186 / 25.4 * 96)  # [px] less the margins
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    try:
        size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        browser.execute_script("dispatchEvent(new Event('beforeprint'))")
        wide = browser.execute_script(
            "return [...document.querySelectorAll('table, .main-svg, p, h1, h2, svg')]"
            ".map(e => [e.getBoundingClientRect().right, e.outerHTML.slice(0, 200)]).filter(x => x[0] > innerWidth + 1)"
        )
        assert wide == []
    finally:
        browser.execute_script("dispatchEvent(new Event('afterprint'))")
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def figures(browser: Any) -> int:
    return int(browser.execute_script("return document.querySelectorAll('.js-plotly-plot .main-svg').length"))


def test_the_comparison_draws_itself_from_its_own_file(browser, planar, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    folder, page = planar[0], tmp_path / "compare.html"
    assert main(["compare", str(folder / "m.model.json"), "--data", str(folder / "rec.parquet"), "--report", str(page)]) == 0
    text = drawn(browser, page)
    assert figures(browser) > 0, "no figure was drawn"
    assert "Identified sets" in text
    model = load_model(folder / "m.model.json")
    for reported in (model.sha256, "rec.parquet", "0 first identification"):  # what, of what, with which history
        assert reported in text, reported
    assert crosses(browser) == 0


def crosses(browser: Any) -> int:
    return int(browser.execute_script("return document.querySelectorAll('.js-plotly-plot .points path.point').length && "
                                      "Array.from(document.querySelectorAll('.js-plotly-plot')).flatMap(p => p.data)"
                                      ".filter(t => t.marker && t.marker.symbol == 'x').length"))  # fmt: skip


def outside(browser: Any) -> list[bool]:
    """Of each cross: whether its band, interpolated at its time, ends before it."""
    return list(
        browser.execute_script("""
      const at = (x, xs, ys) => { for (let i = 1; i < xs.length; i++) if (xs[i] >= x) { const s = (x - xs[i-1]) / (xs[i] - xs[i-1] || 1);
        return ys[i-1] + s * (ys[i] - ys[i-1]); } return NaN; };
      return [...document.querySelectorAll('.js-plotly-plot')].flatMap(p => p._fullData.filter(t => t.marker && t.marker.symbol == 'x').map(c => {
        const b = p._fullData.find(t => t.fill == 'toself' && t.xaxis == c.xaxis), n = b.x.length / 2, x = [...b.x].slice(0, n);
        const hi = at(c.x[0], x, [...b.y].slice(0, n)), lo = at(c.x[0], x, [...b.y].slice(n).reverse());
        return c.y[0] > hi || c.y[0] < lo; }))""")
    )


def test_a_violation_is_drawn_where_it_is_and_its_joint_named(browser, planar, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    folder, trials, _ = planar
    wrong = [replace(r, tau=r.tau * np.array([1.0, 2.0])) for r in trials if r.trial == 0]  # no repetition, so no floor
    save_trials(tmp_path / "wrong.parquet", wrong, names(2))
    page, data = tmp_path / "compare.html", str(tmp_path / "wrong.parquet")
    assert main(["compare", str(folder / "m.model.json"), "--data", data, "--report", str(page)]) == 1
    text = drawn(browser, page)
    assert "The model fails most at axis_2" in text and "Not conformant" in text
    assert crosses(browser) == min(len(wrong), 6) > 0
    assert outside(browser) == [True] * crosses(browser), "each cross lies outside the band it is drawn with"
    worst = [line.split()[3] for line in text.splitlines() if line.startswith("motion ")]
    assert worst == ["axis_2"] * len(wrong)
    assert "What next:" in text


def test_the_joint_in_question_is_marked_where_it_is(planar: Any) -> None:
    model = planar[2].model
    q = telling_pose(model)
    assert np.all((model.domain.q.lo <= q) & (q <= model.domain.q.hi)), (
        "an arm nobody has seen like this would be a drawing, not a picture"
    )
    marks, places = [], []
    for name in model.joints:
        svg = drawn_arm(model, q, views=WIDE, marked=[name])
        lines = re.findall(r'polyline points="([^"]+)"', svg)
        points = [[tuple(map(float, p.split(","))) for p in line.split()] for line in lines]
        places.append([view[1 + model.joints.index(name)] for view in points])
        marks.append(
            [(float(x), float(y)) for x, y in re.findall(r'<circle cx="([\d.]+)" cy="([\d.]+)" r="9" fill="#b00020"', svg)]
        )
    assert marks == places and len(marks[0]) == len(WIDE)
    lengths = np.linalg.norm(np.diff(model.robot.outline(q), axis=0), axis=1)
    drawn_lengths = np.linalg.norm(
        np.diff(np.array(points[0]), axis=0), axis=1
    )  # this arm moves in one plane, seen at right angles
    scale = drawn_lengths.sum() / lengths.sum()
    assert drawn_lengths == pytest.approx(scale * lengths, abs=0.3), "true to scale"


def test_an_inspection_in_a_browser(browser, planar, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    folder, page = planar[0], tmp_path / "inspect.html"
    code = main(["inspect", str(folder / "rec.parquet"), "--robot", str(folder / "robot.urdf"), "--report", str(page)])
    assert code in (0, 1)
    assert "missing for identification" in drawn(browser, page)
    assert figures(browser) > 0


def test_a_plan_in_a_browser(browser, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    wishes = Wishes(motions=2, repeats=2, poses=6, excitations=1, period=5.0, evaluations=20, floor=-0.3)
    plan_page(design(arm(), wishes)).save(tmp_path / "plan.html")
    text = drawn(browser, tmp_path / "plan.html")
    assert figures(browser) >= 3  # excitation, slow, fast
    assert "kg m²" in text and "Collisions with itself" in text


def test_words_stand_left_and_figures_right(browser, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    page = Page("Table")
    long = "a sentence that is long enough to be broken into several lines on any screen " * 3
    rows = [("a", 1.5, "[-1e-05, 2.5]", "9 of 9", long, None, ""), ("b", 20.0, "[0, 1]", "0 of 3", "short", None, "")]
    page.table(("word", "number", "range [N m]", "share", "sentence", "dash", "empty"), rows)
    page.save(tmp_path / "t.html")
    drawn(browser, tmp_path / "t.html")
    script = "return Array.from(document.querySelectorAll('tbody tr:first-child td')).map(c => getComputedStyle(c).textAlign)"
    left, right = ("left", "start"), ("right", "end")
    wanted = (left, right, right, right, left, right, left)
    assert all(side in sides for side, sides in zip(browser.execute_script(script), wanted, strict=True))


def test_a_refused_effect_leaves_a_page_with_its_numbers(planar, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    folder, page, added = planar[0], tmp_path / "add.html", tmp_path / "m2.model.json"
    words = [str(folder / "m.model.json"), "asymmetric_coulomb", "--joint", "axis_1", "--data", str(folder / "rec.parquet")]
    assert main(["add", *words, "--out", str(added), "--report", str(page)]) == 1 and not added.exists()
    text = page.read_text()
    assert (
        "asymmetric_coulomb:axis_1 is refused: " in text
        and load_model(folder / "m.model.json").sha256 in text
        and "adds" not in text
    )


@pytest.mark.parametrize(("effect", "forced"), [("spring", False), ("asymmetric_coulomb", True)])
def test_what_was_added_is_said_once_of_the_model_as_it_was_written(  # type: ignore[no-untyped-def]
    planar, tmp_path: Path, effect: str, forced: bool
) -> None:
    folder, page, added = planar[0], tmp_path / "add.html", tmp_path / "m2.model.json"
    words = [str(folder / "m.model.json"), effect, "--joint", "axis_1", "--data", str(folder / "rec.parquet")]
    assert main(["add", *words, "--out", str(added), "--report", str(page), *["--force"] * forced]) == 0
    text = page.read_text()
    assert text.count(f"adds {effect}:axis_1") == 1 and load_model(added).sha256 in text and "not saved yet" not in text
    assert ("forced in, though it does not lower the error" in text) == forced


def test_recordings_made_here_come_with_their_inspection(tmp_path: Path) -> None:
    page = tmp_path / "made.html"
    assert main(["simulate", "--hide", "none", "--plan", "short", "--out", str(tmp_path / "made"), "--report", str(page)]) == 0
    assert "Inspection of recordings" in page.read_text() and "Do not identify" not in page.read_text()
