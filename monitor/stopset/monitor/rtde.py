"""Tables of a Universal Robots controller, as RTDE clients write them: columns ``timestamp, actual_q_0 .. 5, actual_qd_0 ..`` and a torque.

The torque is, of what is there, what comes nearest to a measurement: ``actual_current_as_torque``, ``actual_current`` times the torque
constants that were stated, or ``target_moment``, which is the controller's own model and not a measurement.  Separated by commas,
semicolons, tabs or blanks.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from stopset.errors import RecordingError
from stopset.monitor.config import TORQUES
from stopset.recording import Meta, Recording
from stopset.recording.table import CUT_OFF, Stated, columns_of, read_table
from stopset.recording.tabular import header

JOINTS = (
    "shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint",
)  # fmt: skip
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
    joints = names or JOINTS
    if len(joints) != len(JOINTS):
        raise RecordingError(
            f"{path}: {len(joints)} joint names; expected {len(JOINTS)}, from base to flange: give --joints anew"
        )
    head = header(path)
    if "timestamp" not in head:
        raise RecordingError(f"{path}: no column timestamp; expected the controller's time [s]: record it with the joints")
    usable = [x for x in TORQUES if f"{x}_0" in head and (x != "actual_current" or constants is not None)]
    if not usable:
        seen = "currents, but no torque constants" if "actual_current_0" in head else "neither current nor moment"
        raise RecordingError(
            f"{path} holds {seen}; expected a torque: state --torque-constant K1,..,K6 (N m/A on the link side), or record "
            "actual_current_as_torque"
        )
    kinds = {"q": "actual_q", "dq": "actual_qd", "i" if usable[0] == "actual_current" else "tau": usable[0]}
    for stem in kinds.values():
        if missing := [f"{stem}_{k}" for k in range(len(JOINTS)) if f"{stem}_{k}" not in head]:
            raise RecordingError(f"{path}: columns {', '.join(missing)} are missing; expected {stem}_0 to {stem}_5: record them")
    columns = ",".join(["t=timestamp", *(f"{kind}={stem}_?" for kind, stem in kinds.items())])
    stated = Stated(columns, joints, constants=constants)
    meta, trials, said = read_table([path], stated, "motor_torque", suite)
    return meta, trials, TAKEN[usable[0]] + _payload(path, head) + (CUT_OFF if CUT_OFF in said else "")


def _payload(path: Path, head: list[str]) -> str:
    """What the controller was told of the load, in words."""
    if "payload" not in head:
        return ""
    stated = np.unique(columns_of(path, ["payload"])["payload"])
    return f"; payload stated to the controller {' and '.join(f'{x:g} kg' for x in stated[:3])}"
