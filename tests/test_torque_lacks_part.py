"""A torque that steps up where a joint turns round and falls with its speed is not all that drives it: told, and no model is made of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stopset.cli.main import main
from stopset.offline.description import load_robot, robot_from_text
from stopset.offline.inspect import inspect_recordings
from stopset.recording import Recordings, write_recordings
from stopset.simulation import prepare
from test_hidden_effects import ARM

FORWARD = 40.0  # [N m s/rad] that a drive is given beside what it tells


def _written(folder: Path, share: dict[str, float], sign: float = 1.0) -> tuple[Path, Path]:
    """A healthy arm, with ``share`` of `FORWARD` missing in the torque of these joints."""
    s = prepare(robot_from_text(ARM), ["none"], 3, "short")
    lacks = FORWARD * np.array([share.get(j, 0.0) for j in s.meta.joints])
    moving = ("closed_loop", "open_loop")
    data = Recordings(s.meta, tuple(replace(r, tau=sign * (r.tau - lacks * r.dq)) for r in s.recordings() if r.phase in moving))
    record, urdf = folder / "r.parquet", folder / "robot.urdf"
    write_recordings(record, data.meta, data)
    urdf.write_text(s.robot.urdf)
    (folder / "robot.json").write_text(s.datasheet)
    return record, urdf


def test_friction_that_would_push_is_told_and_makes_no_model(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    record, urdf = _written(tmp_path, {"bend": 1.0})
    found = [f for f in inspect_recordings([record], load_robot(urdf))[0].findings if f.severity == "error"]
    assert [(f.kind, f.joint) for f in found] == [("torque_lacks_part", "bend")], [f.says for f in found]
    assert main(["identify", "--robot", str(urdf), "--data", str(record), "--out", str(tmp_path / "m.model.json")]) == 2
    assert "bend: whatever the links weigh, the torque falls by" in capsys.readouterr().err
    assert not (tmp_path / "m.model.json").exists()


@pytest.mark.parametrize("share", [{}, {"bend": 0.1}, {"bend": -1.0}])
def test_friction_that_rises_less_or_more_is_none_of_it(tmp_path: Path, share: dict[str, float]) -> None:
    record, urdf = _written(tmp_path, share)
    assert "torque_lacks_part" not in {f.kind for f in inspect_recordings([record], load_robot(urdf))[0].findings}


def test_a_wrong_sign_stays_a_wrong_sign(tmp_path: Path) -> None:
    record, urdf = _written(tmp_path, {}, -1.0)
    kinds = {f.kind for f in inspect_recordings([record], load_robot(urdf))[0].findings if f.severity == "error"}
    assert kinds == {"wrong_sign"}
