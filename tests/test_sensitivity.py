"""Which answers hang on which threshold: found by parting where a walk would go otherwise, and told in docs from what is stored."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stopset.offline.diagnose import thresholds as limit

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "benchmarks"))

import diagnosis_sensitivity as sensitivity  # noqa: E402
import doc_tables  # noqa: E402

DATA = ROOT.parent / "shared" / "data" / "hidden_effect"
NAMES = ("QUIET", "WANDER", "FORMS", "PART", "SURE", "HANDFUL", "EDGE", "DEGREE")


def toy() -> list[str]:
    """Thresholds compared, multiplied, handed on, in grids, in arrays, as counts and as keys, one after another."""
    left, seen = np.array([1.9, 3.0, 2.6]), {}
    noisy = [str(k) for k, x in enumerate(left) if x > limit.QUIET]
    width = 1.2 * limit.WANDER - 0.1
    seen[limit.FORMS[0]] = "first"
    near = min(limit.FORMS, key=lambda form: abs(form - 0.02))
    parts = (np.arange(40.0) / limit.PART).astype(int).max()
    beyond = bool(np.any(left > 1.0 + limit.SURE * 0.3)) and bool(width < left[1])
    return [*noisy, f"{float(near):.4f}", str(parts), str(beyond), *"abcdefgh"[: limit.HANDFUL], str(len(seen))]


def each_alone() -> dict[str, dict[str, list[str]]]:
    """The same by asking once more for every threshold."""
    before, found = toy(), dict[str, dict[str, list[str]]]()
    for name in NAMES:
        value = getattr(limit, name)
        for change, factor in sensitivity.FACTORS.items():
            setattr(limit, name, sensitivity.varied(value, factor))
            if (answer := toy()) != before:
                found.setdefault(name, {})[change] = answer
        setattr(limit, name, value)
    return found


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_parting_finds_what_asking_for_each_alone_finds() -> None:
    found = sensitivity.sensitivity(sensitivity.watched(toy, NAMES))
    assert found["answer"] == toy()
    assert found["changed"] == each_alone()
    assert {"QUIET", "FORMS", "PART", "HANDFUL"} <= found["changed"].keys()
    assert set(NAMES) - set(found["read"]) == {"EDGE", "DEGREE"}  # not part of the question
    assert isinstance(limit.QUIET, float)  # nothing is watched here


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_a_value_that_cannot_be_worked_with_is_an_answer_too() -> None:
    found = sensitivity.sensitivity(sensitivity.watched(lambda: [str([0, 1, 2, 3, 4, 5][limit.HANDFUL])], ["HANDFUL"]))
    assert found["changed"] == {"HANDFUL": {"less": ["4"], "more": ["no answer: list index out of range"]}}


def stored() -> dict[str, Any]:
    out: dict[str, Any] = json.loads(sensitivity.STORED.read_text(encoding="utf-8"))
    return out


def test_every_threshold_stands_in_docs_with_what_was_asked() -> None:
    """A new threshold, or another value of one, is to be asked: run benchmarks/diagnosis_sensitivity.py."""
    labelled = [x for key, x in doc_tables.asked().items() if key.startswith(f"{doc_tables.LABELLED}/")]
    assert labelled and all(x["right"] for x in labelled)
    assert not set.intersection(*(x["due"] for x in labelled))  # at least one set was asked with each
    page = (ROOT / "docs" / "diagnosis.md").read_text(encoding="utf-8")
    rows = [line for line in page.splitlines() if line.startswith("| ")]
    assert all(sum(line.endswith(f"| `{t.name}` |") for line in rows) == 1 for t in limit.TABLE)


def test_another_value_is_not_said_to_have_been_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limit, "QUIET", 3.25)
    assert "| 3.25 |" in doc_tables.thresholds()
    row = next(line for line in doc_tables.thresholds().splitlines() if line.endswith("| `QUIET` |"))
    assert row.count("not asked") == 2
    assert all("QUIET" in x["due"] for x in sensitivity.stored()["sets"].values())


@pytest.mark.shared
@pytest.mark.skipif(not DATA.exists(), reason="../shared/data is not here")
def test_what_is_stored_is_what_a_question_with_another_threshold_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Asked in the ordinary manner, with the threshold changed from the start: the answers that hang on it, and one that does not."""
    changed = [(key, name, c) for key, x in stored()["sets"].items() for name, by in x["changed"].items() for c in by]
    key, name, change = next(x for x in changed if x[0].startswith(f"{doc_tables.LABELLED}/"))
    for where, expected in ((key, stored()["sets"][key]["changed"][name][change]["answer"]), ("hidden_effect/p01", ["none"])):
        monkeypatch.setattr(limit, name, sensitivity.varied(getattr(limit, name), sensitivity.FACTORS[change]))
        assert sensitivity.asked(DATA / where.partition("/")[2]) == expected
        monkeypatch.undo()
