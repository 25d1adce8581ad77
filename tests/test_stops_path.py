"""Path-preserving STOP 1: on the path, within torque, shorter than any gentler stop; refused where it cannot be."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path as File

import numpy as np
import pytest

from stopset.errors import NotCovered
from stopset.reach.stops import Ramp, StopBounds
from stopset.robot.rigid import torque

sys.path.insert(0, str(File(__file__).resolve().parents[1] / "benchmarks"))
from stop_arms import prbt_like

pytest.importorskip("toppra")
from stopset.offline.stops.path import Path, path_stop

MODEL = prbt_like((0.0, 0.5))
RAMP = Ramp.stated(6, time=0.3, control=0.02)
BOUNDS = StopBounds.of(MODEL, ramp=RAMP)
POINTS = np.array(
    [
        [0.0, 0.3, 0.4, 0.0, 0.5, 0.0],
        [0.5, 0.6, 0.1, 0.2, 0.3, 0.2],
        [1.0, 0.5, -0.4, 0.5, 0.2, 0.6],
        [1.4, 0.2, -0.6, 0.7, 0.0, 1.0],
    ]
)


def test_stays_on_the_path_within_torque_and_uses_it() -> None:
    path = Path.through(POINTS)
    stop = path_stop(BOUNDS, path, 0.5, 1.5)
    assert stop.bound.certified and stop.room >= 0.0
    dense = path.p(np.linspace(0.5, 0.5 + stop.length, 4000), 0)
    assert all(np.abs(dense - q).max(axis=1).min() < 1e-3 for q in stop.q)
    travel = dense - dense[0]
    assert np.all(travel.max(axis=0) <= stop.bound.forward + 1e-9) and np.all(-travel.min(axis=0) <= stop.bound.back + 1e-9)
    # full braking leaves some drive with little torque: no shorter stop exists
    assert stop.room < 0.1 * MODEL.robot.torque_limit.max()
    slower = path_stop(BOUNDS, path, 0.5, 0.75)
    assert slower.length < stop.length and slower.time < stop.time


def test_straight_line_matches_the_closed_form() -> None:
    """Joint 6 alone, torque limit tau: deceleration tau_free / M_66, length v^2 / 2a, within the bisection and the grid."""
    q = np.zeros(6)
    weak = replace(MODEL.robot, torque_limit=np.array([1e4, 1e4, 1e4, 1e4, 1e4, 8.0]))
    model = replace(MODEL, robot=weak)
    end = q.copy()
    end[5] = 1.0
    ramp = Ramp.stated(6, time=0.3, control=0.0)
    stop = path_stop(StopBounds.of(model, (0.0, 0.0), ramp=ramp), Path.through(np.array([q, end])), 0.0, 1.0)
    # the drive's torque less friction (2 N m and 1 N m s/rad, a quarter more), U and reserve does the braking
    free = 8.0 * 0.98 - 2.5 - 1.25 - 0.4
    inertia = (
        MODEL.rotor[5] + torque(weak.chain, weak.pi, q, 0 * q, np.eye(6)[5])[5] - torque(weak.chain, weak.pi, q, 0 * q, 0 * q)[5]
    )
    assert stop.length == pytest.approx(0.5 * inertia / free, rel=0.02)


@pytest.mark.parametrize(
    ("points", "s", "ds", "word"),
    [
        (POINTS, 2.968, 1.5, "too fast"),
        (POINTS, 0.5, 50.0, "too fast"),
        (POINTS + 3.0, 0.5, 1.0, "beyond its limits"),
        (POINTS, 7.0, 1.0, "expected 0 <= row"),
        (POINTS[:1], 0.0, 1.0, "at least two"),
    ],
)
def test_impossible_paths_are_refused(points: np.ndarray, s: float, ds: float, word: str) -> None:
    with pytest.raises(NotCovered, match=word):
        path_stop(BOUNDS, Path.through(points), s, ds)


def test_between_the_poses_looked_at_nothing_leaves_the_bound() -> None:
    """Tool, link ends and speeds of a hundred times as many points of the path."""
    from stopset.robot.rigid import link_frames

    path, robot = Path.through(POINTS), MODEL.robot
    stop = path_stop(BOUNDS, path, 0.5, 1.5)
    s = np.linspace(0.5, 0.5 + stop.length, 20000)
    q, d1 = path.p(s, 0), path.p(s, 1)

    def ends(x: np.ndarray) -> np.ndarray:
        R, o = link_frames(robot.chain, x)
        return np.array([*o[1:], o[-1] + R[-1] @ robot.tip])

    p = np.array([ends(x) for x in q])
    far = np.linalg.norm(p - p[0], axis=2).max(axis=0)
    pace = 1.5 * np.linalg.norm(np.diff(p, axis=0), axis=2).max(axis=0) / (s[1] - s[0])
    b = stop.bound
    # the start is known to 1 mrad in each of six joints, 0.7 m long together
    assert np.all(far <= b.links) and far[-1] <= b.tcp <= far[-1] + 0.005
    assert pace[-1] <= b.tcp_speed <= 1.5 * pace[-1] and np.all(1.5 * np.abs(d1).max(axis=0) <= b.speed)
    way = p[:, -1] - p[0, -1]
    assert np.all(way >= b.tcp_box[:, 0]) and np.all(way <= b.tcp_box[:, 1])
    assert b.holding_margin is not None and b.holding_margin.min() > 0.0


def test_path_from_the_command_line(tmp_path: File, capsys: pytest.CaptureFixture[str]) -> None:
    from stopset.artifact import save_model
    from stopset.cli.main import main

    save_model(MODEL, tmp_path / "m.json")
    lines = [",".join(f"{x:.3f}" for x in row) for row in POINTS]
    (tmp_path / "p.csv").write_text("\n".join([",".join(MODEL.joints), *lines]) + "\n")
    asked = ["stops", str(tmp_path / "m.json"), "--path", str(tmp_path / "p.csv"), "--ramp-time", "0.3", "--path-start", "0.5"]
    assert main([*asked, "--path-rate", "1.5"]) == 0
    assert "stays on its programmed path" in capsys.readouterr().out
    for rate, word in ((["--path-rate", "60"], "too fast"), ([], "--path-rate")):
        assert main([*asked, *rate]) == 2
        err = capsys.readouterr().err
        assert word in err and err.count("\n") == 1
    (tmp_path / "p.csv").write_text("1,2,3\n4,5,6\n")
    assert main([*asked, "--path-rate", "1"]) == 2 and "expected 6 angles" in capsys.readouterr().err
