"""``stopset demo``, the drill, whole and with real processes, on an arm of three joints: healthy, changed, explained, rolled out, healthy."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from stopset.cli.main import main
from stopset.cli.story import chapters
from stopset.cli.story.cell import MonitoredCell, Subscriber
from stopset.cli.story.telling import Asides
from stopset.errors import StopsetError
from stopset.monitor.journal import Journal
from stopset.monitor.journal_file import FileStore
from stopset.monitor.latch import Latch, Record
from test_hidden_effects import ARM


@pytest.fixture
def words(tmp_path: Path) -> list[str]:
    (tmp_path / "three.urdf").write_text(ARM)
    return [
        "demo",
        "--out",
        str(tmp_path / "out"),
        "--robot",
        str(tmp_path / "three.urdf"),
        "--seed",
        "1",
        "--hide",
        "spring:turn",
    ]


@pytest.mark.slow
def test_the_drill(tmp_path: Path, words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    code = main(words)
    said = capsys.readouterr()
    assert code == 0, said.err
    events: list[dict[str, Any]] = [json.loads(line) for line in (tmp_path / "out/events.jsonl").read_text().splitlines()]
    assert [e["t_ns"] for e in events] == sorted(e["t_ns"] for e in events)
    told = [e for e in events if e["kind"] == "violation"]
    sides = [(v["joint"], v["state"], v["side"]) for e in told for v in e["violations"]]
    assert len(set(sides)) == len(sides), "each side on which a state left its sets is told once"
    # how many did before the first was classed is a matter of which samples came when
    kinds = [e["kind"] for e in events if e not in told[1:]]
    expected = ["started", "violation", "bundle", "started", "reload_refused", "reloaded", "reset"]
    assert [k for k in kinds if k in expected] == expected
    steps = [e["why"] for e in events if e["kind"] == "step"]
    for step in ("motions held out|none leaves", "healthy, the second|OK", "changed: VIOLATION, class", "spring at turn", "kill -9",
                 "another's signature is refused", "rolled out without a gap", "OK again", "no event lost",
                 "U of turn", "STOP 0 of turn"):  # fmt: skip
        assert any(all(part in s for part in step.split("|")) for s in steps), (step, steps)
    reset = next(e for e in events if e["kind"] == "reset")
    assert reset["name"] == "A. Smith" and reset["reason"]
    for page in ("compare-first.html", "diagnosis.html", "compare-second.html", "history.html", "stops.html", "arm.fmu"):
        assert (tmp_path / "out" / page).stat().st_size > 1000 and page in said.out


def test_a_sentence_that_does_not_hold_ends_it(
    tmp_path: Path, words: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(chapters, "LIKELY", 1e-3)  # a promise that no recordings could give
    assert main(words) == 1
    assert "it did not hold that a new motion leaves the sets with at most 0%" in capsys.readouterr().err
    assert (tmp_path / "out/events.jsonl").exists()


@pytest.mark.parametrize("hide", ["spring", ":turn", "spring:", "nothing:turn"])
def test_what_cannot_happen_is_one_sentence(words: list[str], hide: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*words[:-1], hide]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_samples_of_a_round_are_counted_by_state() -> None:
    ear = Subscriber.__new__(Subscriber)
    ear.samples = [Counter(UNKNOWN=20, DEGRADED=80), Counter(UNKNOWN=40, DEGRADED=160), Counter(UNKNOWN=60, DEGRADED=170, OK=170)]
    assert ear.counted(200, 400) == Counter(OK=170, UNKNOWN=20, DEGRADED=10)
    assert ear.counted(0, 200) == Counter(UNKNOWN=40, DEGRADED=160)


def test_what_runs_beside_the_story_is_shown_when_it_failed(capsys: pytest.CaptureFixture[str]) -> None:
    """A command in a process of its own prints for the story, and ends it with its own sentence where it fails."""
    with Asides() as beside:
        begun = beside.begin("inspect", "--help")
        assert "usage: stopset inspect" in begun.result()
        with pytest.raises(StopsetError, match=r"`stopset history` ended with 2: .*nowhere\.model\.json"):
            beside.begin("history", "nowhere.model.json").result()
    assert "$ stopset inspect --help &" in capsys.readouterr().out


def test_a_second_demonstration_in_a_folder_begins_without_the_violation_of_the_first(tmp_path: Path) -> None:
    MonitoredCell.built(tmp_path, can=True)
    path, first = tmp_path / "arm.latch", asdict(Record())
    journal = Journal(FileStore(path, first))
    latch = Latch(journal)
    latch.record.why = "left the model"
    latch.save(0.0)
    latch.close()
    MonitoredCell.built(tmp_path, can=True)
    again = Latch(Journal(FileStore(path, first)))
    assert not again.latched, again.record.why
    again.close()
