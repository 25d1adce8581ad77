"""What is known before the question is asked: the description and data sheet, or a model from other recordings."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stopset.artifact import Model
from stopset.effects import Fitted
from stopset.effects.selection import of_part
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.evidence.priors import Known
from stopset.offline.nominal.prior import Tolerance
from stopset.recording import Meta, Recordings
from stopset.robot import Robot
from stopset.robot.rigid import gravity_torques
from stopset.sets import Box

DESCRIBED = "robot description and data sheet"
POSES = 500  # at which gravity torques are compared


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
    described = model.robot.as_described
    return Baseline(described, None, DESCRIBED) if own(model, recordings.meta) else of_model(model)


def of_model(model: Model) -> Baseline:
    """What other recordings than a model's own are measured against."""
    described = model.robot.as_described
    drives = tuple(replace(d, rotor_inertia=float(r)) for d, r in zip(model.robot.drives, model.rotor, strict=True))
    friction, error = np.zeros((model.n, 2)), np.zeros((model.n, 2))
    for f in model.effects:
        for column, law in enumerate((of_part("dry friction"), of_part("damping"))):
            if f.effect == law.name and f.joint in model.joints:
                at, symbol = (model.joints.index(f.joint), column), law.terms[0].symbol
                friction[at], error[at] = f.values[symbol], f.std.get(symbol) or 0.0
    robot = replace(model.robot, drives=drives)
    gain, std, notes = drive_gain(described, robot, model.domain.q)
    left_open = np.array(model.provenance.get("left_open", []), float)
    left = np.array(model.provenance.get("left_of_own_Nm", []), float)
    excess = np.array(model.provenance.get("excess_of_own", []), float)
    return Baseline(
        robot, Known(friction, error, gain, std, left_open=left_open, own=left, own_excess=excess), "identified model", notes
    )


def own(model: Model, meta: Meta) -> bool:
    """Whether a model was identified from some of these recordings."""
    return bool(set(dict(model.provenance.get("data", {})).values()) & {digest for _, digest in meta.sources})


def settled(model: Model) -> tuple[Fitted, ...]:
    """The effects that are no longer in question: those that were asked for or added, not those that `identify` chose itself."""
    chosen = set(model.provenance.get("chosen", ()))
    return tuple(f for f in model.effects if f.label not in chosen)


def drive_gain(described: Robot, identified: Robot, reach: Box) -> tuple[float, float, tuple[str, ...]]:
    """Recorded over true torque, its standard deviation and notes, from gravity torques, identified and described, over ``reach``.

    A torque constant that is off scales every identified mass, and every new load with them; but so does a description whose
    masses are off, and recordings of one arm cannot tell the two apart.  How far the ratio differs from joint to joint says how
    far the description is to be trusted: a wrong gain is the same for all.  What is left is shared by how well each is known.
    """
    q = np.random.default_rng(0).uniform(reach.lo, reach.hi, (POSES, reach.dim))
    ours, theirs = (gravity_torques(r.chain, r.pi, q) for r in (identified, described))
    weight, product = (theirs**2).sum(axis=0), (ours * theirs).sum(axis=0)
    total = float(weight.sum())
    if total == 0.0:
        return 1.0, limit.DRIVES, ()  # no gravity loads a joint: nothing tells, and no mass is weighed
    ratio, (least, most) = float(product.sum()) / total, limit.GAIN
    if not least < ratio < most:
        note = (
            f"the identified gravity torque is {ratio:.2g} times what the robot description says; expected {least:g} to {most:g}, which a "
            "torque constant that is off would explain: no scale of the torque is assumed, so a new load is weighed in the recorded "
            "torque as it is. Check the masses in the URDF and the torque's unit (`stopset inspect --robot`)"
        )
        return 1.0, limit.DRIVES, (note,)
    loaded = weight > limit.LOADED * weight.max()
    spread = float(weight[loaded] @ (product[loaded] / weight[loaded] - ratio) ** 2) / total
    masses = Tolerance().mass ** 2 + spread * float(weight @ weight) / total**2
    share = limit.DRIVES**2 / (limit.DRIVES**2 + masses)
    return 1.0 + share * (ratio - 1.0), float(np.sqrt(share * masses)), ()
