"""What is known before the question is asked: the description and data sheet, or a model from other recordings."""

from __future__ import annotations

from dataclasses import replace

from stopset.artifact import Model
from stopset.recording import Meta
from stopset.robot import Robot
from stopset.robot.arm import robot_from_text


def known_robot(model: Model, meta: Meta) -> tuple[Robot, str]:
    """The robot to measure these recordings against, and where it comes from.

    Recordings that the model was identified from can't show a shifted mass against it: the fit has absorbed that.  They are
    measured against the robot description and data sheet.  Other recordings are measured against the model.
    """
    own = set(dict(model.provenance.get("data", {})).values())
    if own & {digest for _, digest in meta.sources}:
        return robot_from_text(model.robot.urdf, model.robot.datasheet), "robot description and data sheet"
    drives = tuple(
        replace(d, rotor_inertia=float(r)) for d, r in zip(model.robot.drives, model.rotor, strict=True)
    )
    return replace(model.robot, drives=drives), "identified model"
