"""The documentation: it builds, loads nothing from elsewhere, and its commands are commands."""

from __future__ import annotations

import importlib.util
import json
import re
import shlex
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

from stopset.cli.main import commands, parser_of

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")), *sorted((ROOT / "deploy").rglob("*.md"))]
LINKING = [
    p
    for p in sorted(ROOT.rglob("*.md"))
    if not {".venv", "node_modules", "docs", "site"} & {*p.relative_to(ROOT).parts} and ".pytest" not in str(p)
]
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.S | re.M)


def lines(page: Path) -> list[str]:
    """Commands of stopset that a page tells its reader to type."""
    text = page.read_text(encoding="utf-8")
    blocks = "\n".join(b.replace("\\\n", " ") for language, b in BLOCK.findall(text) if language in ("", "sh"))
    found = [line.strip().removeprefix("$ ") for line in blocks.splitlines()]
    return [line for line in found if line.startswith("stopset ")]


TYPED = sorted({(page.relative_to(ROOT).as_posix(), line) for page in PAGES for line in lines(page)})


def reference_pages() -> ModuleType:
    spec = importlib.util.spec_from_file_location("reference_pages", ROOT / "benchmarks" / "reference_pages.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_there_are_commands_to_check() -> None:
    assert len(TYPED) > 30 and {line.split()[1] for _, line in TYPED} <= set(commands())


@pytest.mark.parametrize(("page", "line"), TYPED)
def test_every_command_in_the_docs_is_one(page: str, line: str) -> None:
    """An option that was renamed, or a word that is missing, fails here and not at the reader's."""
    words = shlex.split(line, comments=True)[1:]
    try:
        parser_of(words[0]).parse_args(words[1:])
    except SystemExit as e:
        pytest.fail(f"{page}: {line} ends with {e.code}")


def heading(line: str) -> str:
    """The anchor of a heading, as both the site and a repository's pages make it of plain words."""
    return re.sub(r"\s+", "-", re.sub(r"[^\w\s-]", "", line.lstrip("#").strip().lower()))


@pytest.mark.parametrize("page", LINKING, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_no_link_leads_nowhere(page: Path) -> None:
    """Of the pages that the site does not hold, whose links nobody else follows: files, and headings in them."""
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if re.match(r"[a-z]+:", target):
            continue
        name, _, anchor = target.partition("#")
        led = (page.parent / name).resolve() if name else page
        assert led.exists(), f"{page.name}: {target}"
        if anchor:
            lines = led.read_text(encoding="utf-8").splitlines()
            assert anchor in {heading(line) for line in lines if line.startswith("#")}, f"{page.name}: {target}"


@pytest.mark.parametrize("page", [*PAGES, *LINKING], ids=lambda p: p.relative_to(ROOT).as_posix())
def test_every_script_that_is_named_is_there(page: Path) -> None:
    named = re.findall(r"(?<![\w/.-])((?:benchmarks|deploy|tests|\.ci|docs)/[\w./-]*\w)", page.read_text(encoding="utf-8"))
    assert not [n for n in named if not (ROOT / n).exists()]


def test_a_wrong_option_is_noticed() -> None:
    with pytest.raises(SystemExit):
        parser_of("stops").parse_args(["arm.model.json", "--of-after", "0.6"])


def test_the_reference_is_what_the_code_says() -> None:
    for path, text in reference_pages().pages().items():
        assert path.read_text(encoding="utf-8") == text, f"run python benchmarks/reference_pages.py ({path.name})"


def test_the_site_builds_and_loads_nothing_from_elsewhere(tmp_path: Path) -> None:
    """Strict: a page left out of the contents, a link or an anchor that leads nowhere is an error."""
    site = tmp_path / "site"
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(site)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    found = json.loads((site / "search/search_index.json").read_text(encoding="utf-8"))["docs"]
    assert any("canary" in d["text"] and d["location"].startswith("fleet.html") for d in found), (
        "what is written can be searched for"
    )
    written = sorted(site.rglob("*.html"))
    assert len(written) > 40
    loads = re.compile(r"<(?:script|img|iframe|source|link)\b[^>]*?\b(?:src|href)=\"?(?:https?:)?//", re.I)
    for page in written:
        assert not loads.search(page.read_text(encoding="utf-8")), page.name


@pytest.mark.slow
def test_the_tutorial_runs_as_written(tmp_path: Path) -> None:
    pages = reference_pages()
    typed = [command for block in pages.steps(pages.TUTORIAL.read_text(encoding="utf-8")) for command in block]
    said = {command.split()[1]: pages.output_of(command, tmp_path) for command in typed}
    assert {
        "simulate",
        "inspect",
        "identify",
        "compare",
        "diagnose",
        "add",
        "history",
        "stops",
        "export-fmu",
        "check-fmu",
    } == set(said)
    assert "1. stribeck:arm_2_joint" in said["diagnose"] and "revision 1: stribeck:arm_2_joint" in said["history"]
