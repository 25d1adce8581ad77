"""docs/examples: the notebooks are the scripts, every cell of theirs runs, in order, and each leaves its picture."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from types import ModuleType
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def pages() -> ModuleType:
    spec = importlib.util.spec_from_file_location("example_pages", ROOT / "benchmarks" / "example_pages.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_notebooks_are_the_scripts_and_the_page_lists_them(pages: ModuleType) -> None:
    listed = (pages.EXAMPLES / "index.md").read_text(encoding="utf-8")
    assert [s.stem[0] for s in pages.scripts()] == ["1", "2", "3", "4", "5", "6"]
    for script in pages.scripts():
        text = script.read_text(encoding="utf-8")
        assert script.with_suffix(".ipynb").read_text(encoding="utf-8") == pages.notebook(text), (
            "python benchmarks/example_pages.py"
        )
        assert f"]({script.name})" in listed and f"]({script.stem}.ipynb)" in listed and f"]({script.stem}.svg)" in listed
        nbformat = pytest.importorskip("nbformat")
        nbformat.validate(nbformat.reads(pages.notebook(text), as_version=4))


@pytest.mark.slow
def test_every_cell_of_every_notebook_runs(
    pages: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """No Jupyter here: the cells are executed one after another, as its kernel does."""
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("agg")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.urdf").write_bytes((pages.EXAMPLES / "arm.urdf").read_bytes())
    said = {}
    for script in pages.scripts():
        space: dict[str, object] = {"__name__": "__main__"}
        for cell in json.loads(script.with_suffix(".ipynb").read_text(encoding="utf-8"))["cells"]:
            if cell["cell_type"] == "code":
                exec(compile("".join(cell["source"]), script.name, "exec"), space)
        said[script.stem[0]] = capsys.readouterr().out
        picture = ElementTree.parse(tmp_path / f"{script.stem}.svg").getroot()
        assert len(picture.findall(".//{http://www.w3.org/2000/svg}path")) > 20
    assert "inside the set that was predicted for it: True" in said["1"]
    assert " 0 go beyond their bound" in said["2"] and "Not conformant" in said["3"]
    assert "spring at bend" in said["4"] and "spring:bend: helps" in said["4"] and "certified: " in said["5"]
    faults = ("damaged", "another data id", "repeated or out of order", "silent", "older than they are valid for")
    assert all(f in said["6"] for f in faults) and "nothing wrong:\n    believed" in said["6"]
