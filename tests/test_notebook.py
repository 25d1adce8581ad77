"""Objects in a notebook: they show themselves in units and words, no text of theirs becomes markup; their numbers and pictures come out."""

from __future__ import annotations

import json
import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from mcap.reader import make_reader

from stopset.artifact import load_model
from stopset.cli.main import main
from stopset.errors import NotCovered
from stopset.offline.compare.compare import compare
from stopset.offline.diagnose import diagnose_model
from stopset.offline.notebook import columns, frame, plot
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


def test_numbers_come_out_as_arrays_frames_and_pictures(altered: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pandas = pytest.importorskip("pandas")
    model, data = load_model(altered / "m.model.json"), altered / "altered.parquet"
    found, trials = compare(model, [data]), read_recordings([data], model.robot)
    bound, trial = stop(model, model.domain.q.centre, np.zeros(model.n), "1"), next(iter(trials))
    for thing, rows in ((model, model.n), (found, model.n), (trial, len(trial.t)), (bound, 0 if bound.time is None else model.n)):
        told = frame(thing)
        assert isinstance(told, pandas.DataFrame) and len(told) == rows, type(thing)
        assert {k: list(v) for k, v in columns(thing).items()}.keys() == {*told.columns}
    errors = columns(found)
    assert list(errors["torque_rmse_Nm"]) == [found.figures[j]["torque_rmse"] for j in errors["joint"]]
    drawn = {bar.name: dict(zip(bar.x, bar.y, strict=True)) for bar in plot(found).data}
    assert drawn["torque error"] == {j: r["torque_rmse_known"] for j, r in found.figures.items()}
    simpler = drawn["what the abstraction leaves out, in U"]
    for j, r in found.figures.items():
        assert drawn["torque error"][j] + simpler[j] == pytest.approx(max(r["torque_rmse"], r["torque_rmse_known"]))
    diagnosis = diagnose_model(model, trials)[0]
    assert list(frame(diagnosis)["effect"]) == [r.effect for r in diagnosis.ranked] and len(plot(diagnosis).data) == 2
    with pytest.raises(NotCovered, match="nothing was added"):
        plot(model)
    with pytest.raises(NotCovered, match="no stop provable: <b>"):
        plot(replace(bound, forward=None, why="<b>no brake</b>"))
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(NotCovered, match="pandas is not installed"):
        frame(found)


def test_a_comparison_leaves_as_mcap(altered: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What it holds is the recording, the bounds about it, and the arm where it was; read back by the format's own library."""
    model, data, file = altered / "m.model.json", altered / "altered.parquet", tmp_path / "c.mcap"
    arm = load_model(model)
    trial = next(r for r in read_recordings([data], arm.robot) if r.phase == "open_loop")
    asked = ["compare", str(model), "--data", str(data), "--quiet", "--mcap", str(file), "--recording"]
    assert main([*asked, "no such"]) == 2 and "no recording is called 'no such'" in capsys.readouterr().err and not file.exists()
    assert main([*asked, trial.label]) in (0, 1)
    with file.open("rb") as stream:
        messages = [(channel.topic, m.log_time, json.loads(m.data)) for _, channel, m in make_reader(stream).iter_messages()]
    for k, j in enumerate(arm.joints):
        mine = [(t, m) for topic, t, m in messages if topic == f"joint/{j}"]
        at = np.array([t for t, _ in mine]) * 1e-9
        assert np.interp(at, trial.t - trial.t[0], trial.q[:, k]) == pytest.approx([m["q_rad"] for _, m in mine], abs=1e-6)
        inside = [m for _, m in mine if m["lo_rad"] is not None]
        assert inside and all(m["outside_rad"] == max(m["lo_rad"] - m["q_rad"], m["q_rad"] - m["hi_rad"], 0.0) for m in inside)
    pictures = [m["entities"][0] for topic, _, m in messages if topic == "arm"]
    first = np.array([[p[x] for x in "xyz"] for p in pictures[0]["lines"][0]["points"]])
    assert first == pytest.approx(arm.robot.outline(trial.q[0])) and len(pictures[0]["spheres"]) == arm.n


def test_the_arm_in_the_mcap_is_what_foxglove_publishes_as_its_scene(altered: Path, tmp_path: Path) -> None:
    """Read by the publisher's own message class: every field known, of its type, none that a viewer would miss."""
    pytest.importorskip("foxglove_schemas_protobuf", reason="foxglove-schemas-protobuf is not installed")
    from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate  # type: ignore[import-untyped]
    from google.protobuf import json_format

    arm, file = load_model(altered / "m.model.json"), tmp_path / "c.mcap"
    main(["compare", str(altered / "m.model.json"), "--data", str(altered / "altered.parquet"), "--quiet", "--mcap", str(file)])
    with file.open("rb") as stream:
        read = list(make_reader(stream).iter_messages(["arm"]))
    assert len(read) > 10
    for schema, _, message in read:
        assert schema is not None and (schema.name, schema.encoding) == ("foxglove.SceneUpdate", "jsonschema")
        scene = json.loads(message.data)
        (entity,) = scene["entities"]
        known = {f.json_name for f in SceneUpdate.DESCRIPTOR.fields_by_name["entities"].message_type.fields}
        assert {re.sub(r"_(.)", lambda x: x[1].upper(), k) for k in entity} == known
        # JSON writes times as two integers; the message's own mapping wants text
        at, entity["lifetime"] = entity["timestamp"], "0s"
        entity["timestamp"] = f"1970-01-01T00:00:{at['sec']:02d}.{at['nsec']:09d}Z"
        (drawn,) = json_format.ParseDict(scene, SceneUpdate()).entities
        assert drawn.timestamp.ToNanoseconds() == message.log_time and len(drawn.spheres) == arm.n
        assert [[p.x, p.y, p.z] for p in drawn.lines[0].points] == [[p[x] for x in "xyz"] for p in entity["lines"][0]["points"]]
