"""Pages in a real browser: they draw their figures, log no error, and load nothing from anywhere."""

from __future__ import annotations

from pathlib import Path

from stopset.cli.main import main


def test_the_comparison_draws_itself_from_its_own_file(browser, planar, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    folder = planar[0]
    model, data = next(folder.glob("*.model.json")), next(folder.glob("*.parquet"))
    page = tmp_path / "compare.html"
    assert main(["compare", str(model), "--data", str(data), "--report", str(page)]) in (0, 1)
    browser.get(page.as_uri())
    figures = browser.execute_script("return document.querySelectorAll('.js-plotly-plot .main-svg').length")
    assert figures > 0, "no figure was drawn"
    loaded = browser.execute_script("return performance.getEntriesByType('resource').map(e => e.name)")
    assert [x for x in loaded if not x.startswith(("data:", "blob:"))] == []
    assert [e for e in browser.get_log("browser") if e["level"] == "SEVERE"] == []
    text = browser.execute_script("return document.body.innerText")
    assert "Monitoring aid. Not a safety function" in text and "Identified sets" in text


def test_a_refused_effect_leaves_a_page_with_its_numbers(planar, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    folder, page = planar[0], tmp_path / "add.html"
    words = [str(folder / "m.model.json"), "spring", "--joint", "axis_1", "--data", str(folder / "rec.parquet")]
    code = main(["add", *words, "--out", str(tmp_path / "m2.model.json"), "--report", str(page)])
    assert code == (0 if (tmp_path / "m2.model.json").exists() else 1)
    text = page.read_text()
    assert "Tried just now" in text and "spring:axis_1" in text


def test_recordings_made_here_come_with_their_inspection(tmp_path: Path) -> None:
    page = tmp_path / "made.html"
    assert main(["simulate", "--hide", "none", "--plan", "short", "--out", str(tmp_path / "made"), "--report", str(page)]) == 0
    assert "Inspection of recordings" in page.read_text() and "Do not identify" not in page.read_text()
