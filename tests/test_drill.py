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
    reported = drill.drill(tmp_path / "out", str(tmp_path / "three.urdf"), "spring:turn")
    kinds = [e["kind"] for e in reported]
    expected = ["started", "started", "reload_refused", "reloaded", "reset"]
    assert [k for k in kinds if k in expected] == expected
    assert kinds.index("started") < kinds.index("violation") < kinds.index("bundle") < kinds.index("reload_refused")
    steps = " | ".join(e["why"] for e in reported if e["kind"] == "step")
    for step in (
        "identified and signed",
        "healthy arm is OK",
        "VIOLATION",
        "kill -9",
        "named and added",
        "rolled out",
        "OK again",
    ):
        assert step in steps, steps
    assert [json.loads(line) for line in (tmp_path / "out/events.jsonl").read_text().splitlines()] == reported
    reset = next(e for e in reported if e["kind"] == "reset")
    assert reset["name"] == "A. Smith" and reset["reason"]
