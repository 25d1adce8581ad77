"""The collector is off in the daemon's loop, and a life lasts months: whatever happens in it, nothing is left that only it would free.

Nor is anything imported while samples wait: that takes as long as several cycles.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from monitor_life import EVENTS


@pytest.fixture(scope="module")
def found() -> dict[str, dict[str, object]]:
    done = subprocess.run(
        [sys.executable, Path(__file__).with_name("monitor_life.py")], capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr
    out: dict[str, dict[str, object]] = json.loads(done.stdout)
    return out


@pytest.mark.parametrize("event", [e.__name__ for e in EVENTS])
def test_nothing_waits_for_the_collector_and_nothing_is_imported(event: str, found: dict[str, dict[str, object]]) -> None:
    assert found[event] == {"circles": 0, "modules": []}
