"""Path-preserving STOP 1: on the path, within torque, shorter than any gentler stop; refused where it cannot be."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path as File

import numpy as np
import pytest

from stopset.errors import NotCovered
from stopset.reach.stops import Ramp
from stopset.robot.rigid import torque

sys.path.insert(0, str(File(__file__).resolve().parents[1] / "benchmarks"))
from stop_arms import prbt_like

pytest.importorskip("toppra")
from stopset.offline.stops.path import Path, path_stop

MODEL = prbt_like((0.0, 0.5))
RAMP = Ramp.stated(6, time=0.3, control=0.02)
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
    stop = path_stop(MODEL, path, 0.5, 1.5, RAMP)
    assert stop.bound.certified and stop.room >= 0.0
    dense = path.p(np.linspace(0.5, 0.5 + stop.length, 4000), 0)
    assert all(np.abs(dense - q).max(axis=1).min() < 1e-3 for q in stop.q)
    travel = dense - dense[0]
    assert np.all(travel.max(axis=0) <= stop.bound.forward + 1e-9) and np.all(-travel.min(axis=0) <= stop.bound.back + 1e-9)
    # full braking leaves some drive with little torque: no shorter stop exists
    assert stop.room < 0.1 * MODEL.robot.torque_limit.max()
    slower = path_stop(MODEL, path, 0.5, 0.75, RAMP)
    assert slower.length < stop.length and slower.time < stop.time


def test_straight_line_matches_the_closed_form() -> None:
    """Joint 6 alone, torque limit tau: deceleration tau_free / M_66, length v^2 / 2a, within the bisection and the grid."""
    q = np.zeros(6)
    weak = replace(MODEL.robot, torque_limit=np.array([1e4, 1e4, 1e4, 1e4, 1e4, 8.0]))
    model = replace(MODEL, robot=weak)
    end = q.copy()
    end[5] = 1.0
    ramp = Ramp.stated(6, time=0.3, control=0.0)
    stop = path_stop(model, Path.through(np.array([q, end])), 0.0, 1.0, ramp, (0.0, 0.0))
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
        (POINTS, 7.0, 1.0, "expected 0 <= s"),
        (POINTS[:1], 0.0, 1.0, "at least two"),
    ],
)
def test_impossible_paths_are_refused(points: np.ndarray, s: float, ds: float, word: str) -> None:
    with pytest.raises(NotCovered, match=word):
        path_stop(MODEL, Path.through(points), s, ds, RAMP)
