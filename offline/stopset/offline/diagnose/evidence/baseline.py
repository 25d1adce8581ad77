"""What is known before the question is asked: the description and data sheet, or a model from other recordings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stopset.artifact import Model
from stopset.offline.diagnose.evidence.priors import DRIVES, Known, Tolerance
from stopset.recording import Recordings
from stopset.robot import Robot
from stopset.robot.arm import robot_from_text
from stopset.robot.rigid import gravity_torques
from stopset.sets import Box

POSES = 500  # at which gravity torques are compared
LOADED = 1e-3  # of the most loaded joint: joints that gravity loads less say nothing


def baseline(model: Model, recordings: Recordings) -> tuple[Robot, Known | None, str]:
    """The robot to measure these recordings against, what else is known of it, and where that comes from.

    Recordings that the model was identified from can't show a shifted mass against it: the fit has absorbed that.  They are
    measured against the robot description and data sheet.  Other recordings are measured against the model.
    """
    described = robot_from_text(model.robot.urdf, model.robot.datasheet)
    own = set(dict(model.provenance.get("data", {})).values())
    if own & {digest for _, digest in recordings.meta.sources}:
        return described, None, "robot description and data sheet"
    drives = tuple(replace(d, rotor_inertia=float(r)) for d, r in zip(model.robot.drives, model.rotor, strict=True))
    friction = np.zeros((model.n, 2))
    for f in model.effects:
        for column, (effect, symbol) in enumerate((("coulomb", "F_c"), ("viscous", "F_v"))):
            if f.effect == effect and f.joint in model.joints:
                friction[model.joints.index(f.joint), column] = f.values[symbol]
    robot = replace(model.robot, drives=drives)
    return robot, Known(friction, *drive_gain(described, robot, model.domain.q)), "identified model"


def drive_gain(described: Robot, identified: Robot, reach: Box) -> tuple[float, float]:
    """Recorded over true torque and its standard deviation, from identified over described gravity torques at angles in ``reach``.

    A torque constant that is off scales every identified mass, and every new load with them; but so does a description whose
    masses are off, and recordings of one arm cannot tell the two apart.  How far the ratio differs from joint to joint says how
    far the description is to be trusted: a wrong gain is the same for all.  What is left is shared by how well each is known.
    """
    q = np.random.default_rng(0).uniform(reach.lo, reach.hi, (POSES, reach.dim))
    ours, theirs = (gravity_torques(r.chain, r.pi, q) for r in (identified, described))
    weight, product = (theirs**2).sum(axis=0), (ours * theirs).sum(axis=0)
    total = float(weight.sum())
    loaded = weight > LOADED * weight.max()
    if total <= 0.0 or not 0.5 < product.sum() / total < 2.0:
        return 1.0, DRIVES
    ratio = float(product.sum()) / total
    spread = float(weight[loaded] @ (product[loaded] / weight[loaded] - ratio) ** 2) / total
    masses = Tolerance().mass ** 2 + spread * float(weight @ weight) / total**2
    share = DRIVES**2 / (DRIVES**2 + masses)
    return 1.0 + share * (ratio - 1.0), float(np.sqrt(share * masses))
