"""What the demonstration says of a monitored cell is what a subscriber was told, and of most of the time."""

from __future__ import annotations

from typing import Any

import pytest

from stopset.cli.demo import Asides, _outcome
from stopset.errors import StopsetError


def twin(**more: Any) -> dict[str, Any]:
    return {"state": "OK", "verdicts": {"CONFORMANT": 390}, **more}


def test_the_state_that_held_longest_the_second_time_round_is_told_with_what_came_between() -> None:
    counts = [{}, {"UNKNOWN": 20, "DEGRADED": 80}, {"UNKNOWN": 40, "DEGRADED": 160}, {"UNKNOWN": 60, "DEGRADED": 170, "OK": 170}]
    reported = _outcome(twin(), counts)
    assert reported["word"] == "OK" and "170 OK, 20 UNKNOWN, 10 DEGRADED" in reported["text"]
    worse = [*counts[:3], {"UNKNOWN": 300, "DEGRADED": 160, "OK": 10}]
    assert _outcome(twin(), worse)["word"] == "UNKNOWN", "a good last moment does not make a good round"


def test_a_violation_and_silence_are_told_as_such() -> None:
    latched = twin(state="VIOLATION", violation_latched=True, violating_joints=["j3"])
    assert _outcome(latched, [{"OK": 10}])["word"] == "VIOLATION" and "at j3" in _outcome(latched, [])["text"]
    assert _outcome({}, [])["word"] == "no state" == _outcome(twin(), [{}])["word"]


def test_what_runs_beside_the_story_is_told_when_it_failed(capsys: pytest.CaptureFixture[str]) -> None:
    """A command in a process of its own prints for the story, and ends it with its own sentence where it fails."""
    with Asides() as beside:
        begun = beside.begin("inspect", "--help")
        assert "usage: stopset inspect" in begun.result()
        with pytest.raises(StopsetError, match=r"`stopset history` ended with 2: .*nowhere\.model\.json"):
            beside.begin("history", "nowhere.model.json").result()
    assert "$ stopset inspect --help &" in capsys.readouterr().out
