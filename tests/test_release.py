"""`.ci/tag`: one version in changelog, packaging, citation and tag, or one sentence and nothing changed."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
NAMED = {f"GIT_{who}_{what}": f"{who}@example.invalid".lower() for who in ("AUTHOR", "COMMITTER") for what in ("NAME", "EMAIL")}


def ran(where: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(words, cwd=where, capture_output=True, text=True, env=os.environ | NAMED, check=False)


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    for name in ("CHANGELOG.md", "pyproject.toml", "CITATION.cff", ".ci/tag"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    log = tmp_path / "CHANGELOG.md"  # of a tree that was tagged just now nothing is left to tell
    log.write_text(
        log.read_text(encoding="utf-8").replace("## Unreleased\n", "## Unreleased\n\n### Safety\n- A bound.\n", 1),
        encoding="utf-8",
    )
    for words in (("init", "-q"), ("add", "-A"), ("commit", "-q", "-m", "begun")):
        assert ran(tmp_path, "git", *words).returncode == 0
    return tmp_path


def test_a_version_stands_everywhere_and_its_tag_says_what_changed(repository: Path) -> None:
    before = (repository / "CHANGELOG.md").read_text(encoding="utf-8")
    done = ran(repository, ".ci/tag", "7.8.9")
    assert done.returncode == 0, done.stderr
    assert tomllib.loads((repository / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"] == "7.8.9"
    assert re.search(r"^version: 7\.8\.9$", (repository / "CITATION.cff").read_text(encoding="utf-8"), re.M)
    after = (repository / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.sub(r"## Unreleased\n\n## 7\.8\.9, \d{4}-\d\d-\d\d\n", "## Unreleased\n", after) == before
    assert ran(repository, "git", "status", "--porcelain").stdout == ""
    said = ran(repository, "git", "tag", "-l", "--format=%(contents)", "v7.8.9").stdout
    first = next(line for line in before.splitlines() if line.startswith("- "))
    assert said.startswith("Version 7.8.9\n") and "### Safety" in said and first in said
    assert "tagged already" in ran(repository, ".ci/tag", "7.8.9").stderr
    empty = ran(repository, ".ci/tag", "7.9.0")
    assert empty.returncode == 2 and "nothing under '## Unreleased'" in empty.stderr


@pytest.mark.parametrize(
    ("version", "dirty", "says"), [("7.8", False, "is no version"), ("", False, "is no version"), ("7.8.9", True, "files differ")]
)
def test_what_is_wrong_is_one_sentence_and_nothing_is_changed(repository: Path, version: str, dirty: bool, says: str) -> None:
    if dirty:
        (repository / "more").touch()
    done = ran(repository, ".ci/tag", version)
    assert done.returncode == 2 and says in done.stderr and done.stderr.count("\n") == 1
    assert ran(repository, "git", "tag").stdout == "" and ran(repository, "git", "diff", "--stat").stdout == ""
