"""Recordings as found and their diagnosis: nothing is named that is not there, and what was made of the file is said."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from stopset.offline.description import robot_from_text
from test_hidden_effects import ARM

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from as_found import CASES, answer

DRIFTS = "torque sensor drifts by 1 N m, one trajectory"
LATE = "torque 12 ms late"
SAID = {
    "healthy, one trajectory": "one trial: how friction scatters",
    "3 % of the samples lost": "samples are lost",
    "stamps scatter by 1 ms": "about an even clock",
}


@pytest.mark.parametrize(("case", "rate"), [(c, 100.0 if c == LATE else (100.0, 125.0)[k % 2]) for k, c in enumerate(CASES)])
def test_nothing_is_named_that_is_not_there(case: str, rate: float) -> None:
    found = answer(robot_from_text(ARM), case, rate, 5)
    assert [r.label for r in found.ranked if not (r.effect == "delay" and CASES[case][1].late)] == []
    if case == DRIFTS:
        assert found.verdict == "unknown" and found.depends_on == ("time in the trial",)
    elif not CASES[case][1].drift:  # half as large it is of the size of friction's scatter: either answer is right
        assert found.verdict == ("missing" if case == LATE else "none")
    if case in SAID:
        assert any(SAID[case] in note for note in found.notes)
