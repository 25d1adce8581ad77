"""What is known before the question is asked: the description and data sheet, or a model from other recordings."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stopset.artifact import Model
from stopset.effects import Fitted
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.evidence.engine import Known
from stopset.recording import Recordings
from stopset.robot import Robot
from stopset.robot.arm import robot_from_text
from stopset.robot.rigid import gravity_torques


@dataclass(frozen=True, slots=True)
class Baseline:
    """The robot to measure recordings against, what else is known of it, where that comes from, and what is to be told of it."""

    robot: Robot
    known: Known | None
    against: str
    notes: tuple[str, ...] = ()


def baseline(model: Model, recordings: Recordings) -> Baseline:
    """What these recordings are measured against.

    Recordings that the model was identified from can't show a shifted mass against it: the fit has absorbed that.  They are
    measured against the robot description and data sheet.  Other recordings are measured against the model.
    """
    described = robot_from_text(model.robot.urdf, model.robot.datasheet)
    own = set(dict(model.provenance.get("data", {})).values())
    if own & {digest for _, digest in recordings.meta.sources}:
        return Baseline(described, None, "robot description and data sheet")
    drives = tuple(replace(d, rotor_inertia=float(r)) for d, r in zip(model.robot.drives, model.rotor, strict=True))
    friction = np.zeros((model.n, 2))
    for f in model.effects:
        for column, (effect, symbol) in enumerate((("coulomb", "F_c"), ("viscous", "F_v"))):
            if f.effect == effect and f.joint in model.joints:
                friction[model.joints.index(f.joint), column] = f.values[symbol]
    robot = replace(model.robot, drives=drives)
    gain, notes = drive_gain(described, robot, recordings)
    return Baseline(robot, Known(friction, gain), "identified model", notes)


def settled(model: Model) -> tuple[Fitted, ...]:
    """The effects that are no longer in question: those that were asked for or added, not those that `identify` chose itself."""
    chosen = set(model.provenance.get("chosen", ()))
    return tuple(f for f in model.effects if f.label not in chosen)


def drive_gain(described: Robot, identified: Robot, recordings: Recordings) -> tuple[float, tuple[str, ...]]:
    """Recorded over true torque: the identified gravity torque over the described one, all joints together; and notes.

    A torque constant that is off scales every identified mass, and every new load with them.  Taken over all joints, the
    heavy inner links decide, whose masses a tool or cables hardly change.
    """
    q = np.concatenate([r.q[:: max(1, len(r.q) // 200)] for r in recordings])
    ours, theirs = (gravity_torques(r.chain, r.pi, np.ascontiguousarray(q)) for r in (identified, described))
    total = float(np.sum(theirs**2))
    if total == 0:
        return 1.0, ()  # no gravity loads a joint: nothing tells, and no mass is weighed
    gain, (least, most) = float(np.sum(ours * theirs)) / total, limit.GAIN
    if least < gain < most:
        return gain, ()
    return 1.0, (
        f"the identified gravity torque is {gain:.2g} times what the robot description says; expected {least:g} to {most:g}, which a "
        "torque constant that is off would explain: no scale of the torque is assumed, so a new load is weighed in the recorded torque "
        "as it is. Check the masses in the URDF and the torque's unit (`stopset inspect --robot`)",
    )
