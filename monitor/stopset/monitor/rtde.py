"""Tables of a Universal Robots controller, as RTDE clients write them: columns ``timestamp, actual_q_0 .. 5, actual_qd_0 ..`` and a torque.

The torque is, of what is there, what comes nearest to a measurement: ``actual_current_as_torque``, ``actual_current`` times the torque
constants that were stated, or ``target_moment``, which is the controller's own model and not a measurement.  Separated by commas,
semicolons, tabs or blanks.
"""

from __future__ import annotations

import csv
import re
from itertools import pairwise
from pathlib import Path

import numpy as np

from stopset.errors import RecordingError
from stopset.monitor.config import TORQUES
from stopset.recording import Meta, Recording
from stopset.types import Array

JOINTS = (
    "shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint",
)  # fmt: skip
GAP = 5.5  # periods without a row that end a trial
SHORTEST = 10  # rows
TAKEN = {
    "actual_current_as_torque": "the controller's torque from current",
    "actual_current": "current times the torque constants given",
    "target_moment": "target_moment: the controller's own model, no measurement, so friction and load are what it believes",
}


def is_rtde(path: Path) -> bool:
    """Whether a table's first line holds the columns of an RTDE client."""
    if path.suffix.lower() not in (".csv", ".txt") or not path.is_file():
        return False
    with path.open(encoding="utf-8", errors="replace") as f:
        return "actual_q_0" in f.readline(100_000)


def read_rtde(
    path: Path, names: tuple[str, ...] | None, constants: tuple[float, ...] | None, suite: int
) -> tuple[Meta, list[Recording], str]:
    """Metadata, trials and what was taken for the torque, in words.

    ``names``: of the joints, those of the maker's URDF if left out; ``constants``: torque per current of each joint, link side [N m/A].
    Raises `RecordingError`.
    """
    head, table = _table(path)
    joints = names or JOINTS
    if len(joints) != len(JOINTS):
        raise RecordingError(
            f"{path}: {len(joints)} joint names; expected {len(JOINTS)}, from base to flange: give --joints anew"
        )
    if constants is not None and (len(constants) != len(joints) or not all(np.isfinite(k) and k > 0 for k in constants)):
        raise RecordingError(
            f"{len(constants)} torque constants ({', '.join(f'{k:g}' for k in constants)}); expected {len(joints)} above 0, N m/A on the "
            "link side: gear ratio times the motor's constant"
        )
    if "timestamp" not in head:
        raise RecordingError(f"{path}: no column timestamp; expected the controller's time [s]: record it with the joints")
    t, q, dq = table[:, head["timestamp"]], _six(path, head, table, "actual_q"), _six(path, head, table, "actual_qd")
    usable = [x for x in TORQUES if f"{x}_0" in head and (x != "actual_current" or constants is not None)]
    if not usable:
        seen = "currents, but no torque constants" if "actual_current_0" in head else "neither current nor moment"
        raise RecordingError(
            f"{path} holds {seen}; expected a torque: state --torque-constant K1,..,K6 (N m/A on the link side), or record "
            "actual_current_as_torque"
        )
    tau = _six(path, head, table, usable[0])
    if usable[0] == "actual_current":
        tau = tau * np.array(constants)
    said = TAKEN[usable[0]]
    if "payload" in head:
        said += (
            f"; payload stated to the controller {' and '.join(f'{x:g} kg' for x in np.unique(table[:, head['payload']])[:3])}"
        )
    trials = _trials(path, t, q, dq, tau, suite)
    rate = 1.0 / float(np.median(np.diff(trials[0].t)))
    return Meta(joints=joints, effort="motor_torque", velocity="measured", clock="recorded", rate_hz=rate), trials, said


def _table(path: Path) -> tuple[dict[str, int], Array]:
    """Column names with their places, and all rows."""
    with path.open(newline="", encoding="utf-8", errors="replace") as f:
        first = f.readline()
        found = re.search(r"[,;\t ]", first.strip())
        mark = found[0] if found else ","
        head = {name.strip(' "'): k for k, name in enumerate(next(csv.reader([first.strip()], delimiter=mark)))}
        rows = []
        for number, row in enumerate(csv.reader(f, delimiter=mark), start=2):
            if not any(row):
                continue
            try:
                rows.append([float(x) for x in row[: len(head)]])
            except ValueError as e:
                raise RecordingError(f"{path}, line {number}: {e}; expected numbers: export the table anew") from e
            if len(row) < len(head):
                raise RecordingError(
                    f"{path}, line {number}: {len(row)} numbers for {len(head)} columns; expected one each: was the writing cut off?"
                )
    return head, np.array(rows, np.float64).reshape(-1, len(head))


def _six(path: Path, head: dict[str, int], table: Array, stem: str) -> Array:
    missing = [f"{stem}_{k}" for k in range(len(JOINTS)) if f"{stem}_{k}" not in head]
    if missing:
        raise RecordingError(f"{path}: columns {', '.join(missing)} are missing; expected {stem}_0 to {stem}_5: record them")
    return table[:, [head[f"{stem}_{k}"] for k in range(len(JOINTS))]]


def _trials(path: Path, t: Array, q: Array, dq: Array, tau: Array, suite: int) -> list[Recording]:
    """Unbroken runs of rows; a row that repeats the stamp before it is left out."""
    new = np.concatenate([[True], np.diff(t) != 0])
    t, q, dq, tau = t[new], q[new], dq[new], tau[new]
    step = np.diff(t)
    if len(t) < SHORTEST or not (step > 0).any():
        raise RecordingError(f"{path}: {len(t)} rows with stamps of their own; expected at least {SHORTEST}: record longer")
    period = float(np.median(step[step > 0]))
    edges = [0, *(np.flatnonzero((step > GAP * period) | (step < 0)) + 1).tolist(), len(t)]
    runs = [(a, b) for a, b in pairwise(edges) if b - a >= SHORTEST]
    if not runs:
        raise RecordingError(
            f"{path}: no {SHORTEST} rows follow one another without a gap; expected a steady clock: record again"
        )
    return [
        Recording("closed_loop", suite, k, k, t[a:b] - t[a], q[a:b], dq[a:b], tau[a:b]) for k, (a, b) in enumerate(runs)
    ]  # fmt: skip
