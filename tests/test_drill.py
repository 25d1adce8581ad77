"""The drill of deploy/checks, whole, with real processes: healthy, changed, explained, rolled out, healthy again."""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path

import pytest

from test_hidden_effects import ARM

SCRIPT = Path(__file__).resolve().parents[1] / "deploy/checks/drill.py"


@pytest.mark.slow
def test_the_drill(tmp_path: Path) -> None:
    spec = importlib.util.spec_from_file_location("drill", SCRIPT)
    assert spec is not None and spec.loader is not None
    drill = importlib.util.module_from_spec(spec)
    sys.modules["drill"] = drill
    spec.loader.exec_module(drill)
    (tmp_path / "three.urdf").write_text(ARM)
    kinds = drill.drill(tmp_path / "out", str(tmp_path / "three.urdf"), "spring:bend")
    steps = [k for k in kinds if k in ("started", "violation", "bundle", "reload_refused", "reloaded", "reset")]
    order = [steps.index(k) for k in ("started", "violation", "bundle", "reload_refused", "reloaded", "reset")]
    assert order == sorted(order) and steps.count("started") == 2, steps
    written = [json.loads(line) for line in (tmp_path / "out/events.jsonl").read_text().splitlines()]
    assert [e["kind"] for e in written] == kinds
    reset = next(e for e in written if e["kind"] == "reset")
    assert reset["name"] == "A. Smith" and reset["reason"]
