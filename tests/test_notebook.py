"""Objects in a notebook: they show themselves in units and words, and no text of theirs becomes markup."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from stopset.artifact import load_model
from stopset.offline.compare.compare import compare
from stopset.offline.diagnose import diagnose_model
from stopset.reach.stops import stop
from stopset.recording import read_recordings


def read(thing: Any) -> tuple[str, int]:
    """The text that is shown, and how many rows of numbers."""
    tree = ElementTree.fromstring(thing._repr_html_())  # well-formed, so nothing in it opens an element of its own
    return " ".join(" ".join(tree.itertext()).split()), len(tree.findall(".//tbody/tr"))


def test_model_comparison_diagnosis_and_stop_show_themselves(altered: Path) -> None:
    model, data = load_model(altered / "m.model.json"), altered / "altered.parquet"
    text, rows = read(model)
    assert "first identification" in text and model.sha256[:16] in text and "U from [N m]" in text and rows == model.n
    text, rows = read(compare(model, [data]))
    assert "recordings leave the sets" in text and rows == model.n
    text, rows = read(diagnose_model(model, read_recordings([data], model.robot))[0])
    assert "Diagnosis: missing" in text and "spring:bend" in text and rows >= 1
    bound = stop(model, model.domain.q.centre, np.zeros(model.n), "0")
    text, rows = read(bound)
    assert text.startswith("STOP 0") and rows in (0, model.n)
    text, rows = read(replace(bound, time=None, why="<b>no brake</b> & nothing"))
    assert "no stop provable" in text and "<b>no brake</b> & nothing" in text and rows == 0
