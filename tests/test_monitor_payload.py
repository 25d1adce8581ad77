"""What the flange carries: not declared, surely nothing, a mass, a range; each is read, bounded and published as what it is."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec import structs

from monitor_arm import DT, known_model, motion
from stopset.artifact import Model, save_model
from stopset.monitor.along import watch_for
from stopset.monitor.config import ConfigError, Masses, Stops, load_config
from stopset.monitor.daemon import Daemon
from stopset.monitor.report import about
from stopset.monitor.sample import Quantum
from stopset.monitor.stopworker import answer_for, prepare
from stopset.monitor.verdict import Conformance
from test_monitor import samples
from test_monitor_daemon import Arm, Wire

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from stop_arms import prbt_like

TEXT = 'model = "arm.model.json"\ndata_id = 7\n{}\n[bus]\nlink = "hub:1"\n'
Q, DQ = np.array([0.1, 0.5, 0.3, -0.4, 0.2, 0.1]), np.array([0.8, 0.6, -0.5, 0.3, 0.4, -0.7])


def declared(folder: Path, line: str) -> Masses | None:
    (folder / "c.toml").write_text(TEXT.format(line))
    return load_config(folder / "c.toml").payload_kg


def carrying(lo: float, hi: float) -> Model:
    model = known_model()
    return replace(model, domain=replace(model.domain, payload=(lo, hi)))


@pytest.mark.parametrize(
    ("line", "means"),
    [
        ("", None),
        ("payload_kg = 0", None),
        ("payload_kg = 0.0", None),
        ("payload_kg = [0, 0]", (0.0, 0.0)),
        ("payload_kg = 2.5", (2.5, 2.5)),
        ("payload_kg = [0, 5]", (0.0, 5.0)),
        ("payload_kg = [2.75, 3.0]", (2.75, 3.0)),
    ],
)
def test_what_is_declared(line: str, means: Masses | None, tmp_path: Path) -> None:
    assert declared(tmp_path, line) == means


@pytest.mark.parametrize(
    "wrong", ["[5, 0]", "[0]", "[]", "[0, 1, 2]", '"3 kg"', "true", "-1", "[-1, 2]", "[0, nan]", "[0, inf]", "{}"]
)
def test_a_payload_that_is_none_is_refused(wrong: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"payload_kg.* is .*expected"):
        declared(tmp_path, f"payload_kg = {wrong}")


def test_surely_nothing_is_bounded_as_nothing_and_no_word_as_everything(tmp_path: Path) -> None:
    save_model(prbt_like((0.0, 3.0)), tmp_path / "m.json")
    x, distances = np.concatenate([Q, DQ]), {}
    for line, means in {
        "": (0.0, 3.0),
        "payload_kg = 0": (0.0, 3.0),
        "payload_kg = [0, 0]": (0.0, 0.0),
        "payload_kg = [0, 1]": (0.0, 1.0),
    }.items():
        prepared, why = prepare(str(tmp_path / "m.json"), declared(tmp_path, line), Stops(("0",)))
        assert prepared is not None and prepared.setting is not None, why
        assert prepared.setting.payload == means
        distances[line] = answer_for(prepared, "0", x, x).numbers.tcp
    assert distances["payload_kg = [0, 0]"] < distances["payload_kg = [0, 1]"] < distances[""] == distances["payload_kg = 0"]
    prepared, why = prepare(str(tmp_path / "m.json"), declared(tmp_path, "payload_kg = [1, 5]"), Stops(("0",)))
    assert prepared is None and "1 to 5 kg lies outside" in why


@pytest.mark.parametrize(
    ("known", "line", "why"),
    [
        ((0.0, 3.0), "", ""),
        ((0.0, 3.0), "payload_kg = [0, 3]", ""),
        ((2.75, 3.0), "payload_kg = 2.8", ""),
        ((2.75, 3.0), "", "not declared"),
        ((2.75, 3.0), "payload_kg = [0, 0]", "payload 0.0 kg is outside"),
        ((2.75, 3.0), "payload_kg = 0", "not declared"),
        ((0.0, 3.0), "payload_kg = [1, 4]", "payload 1.0 to 4.0 kg is outside"),
    ],
)
def test_no_verdict_for_what_was_not_identified(known: Masses, line: str, why: str, tmp_path: Path) -> None:
    watch = watch_for(carrying(*known), Quantum.none(6), declared(tmp_path, line), (0.0, 1.0), DT)
    last = [watch.step(s) for s in samples(motion(0, 3))][-1]
    assert (last.conformance is Conformance.CONFORMANT) == (not why) and why in last.why


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("", {"least": 0.0, "most": 3.0, "declared": False}),
        ("payload_kg = [0, 0]", {"least": 0.0, "most": 0.0, "declared": True}),
        ("payload_kg = [0.5, 2]", {"least": 0.5, "most": 2.0, "declared": True}),
    ],
)
def test_which_payload_was_assumed_is_published(line: str, said: dict[str, Any], tmp_path: Path) -> None:
    model = save_model(carrying(0.0, 3.0), tmp_path / "arm.model.json")
    declared(tmp_path, line)
    arm, wire = Arm([structs.replace(s, t=0.0) for s in samples(motion(0, 5))]), Wire()
    arm.daemon = daemon = Daemon(load_config(tmp_path / "c.toml"), model, arm, wire, DT)
    try:
        daemon.run(lambda: arm)
    finally:
        daemon.close()
    assert wire.slow["state/json"][-1]["payload_kg"] == said
    kept = about(daemon)
    assert json.loads(kept["payload_kg"]) == [said["least"], said["most"]]
    assert json.loads(kept["payload_declared"]) is said["declared"]
