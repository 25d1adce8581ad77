"""A robot as stopset knows it: a serial arm of revolute joints, reduced from its description, and its drives from a data sheet.

Descriptions are read by `stopset.offline.description` alone; the model file holds what came of it, and whoever takes a model takes
the arm from there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from stopset.errors import RobotError
from stopset.robot.drives import Drive, drives_of, gravity_of
from stopset.robot.rigid import Chain, link_frames
from stopset.types import Array


@dataclass(frozen=True, slots=True)
class Arm:
    """What a description says of an arm of ``n`` revolute joints, all that stands still lumped into the link that carries it.

    ``R`` (n, 3, 3), ``p`` (n, 3) [m], ``axis`` (n, 3): see `stopset.robot.rigid.Chain`; ``pi``: (n, 10) standard parameters;
    ``q_limit``: (n, 2) [rad], infinite where a joint turns on; ``dq_limit``: (n,) [rad/s]; ``effort``: (n,) [N m]; ``tip``: (3,)
    [m] the tool point in the last link; ``capsules``: (n, 7) [m] both ends in the link's frame and radius, which enclose the
    link's collision geometry; of ``bare`` joints' links, of which none is known, the line from joint to joint.
    """

    name: str
    joints: tuple[str, ...]
    R: Array
    p: Array
    axis: Array
    pi: Array
    q_limit: Array
    dq_limit: Array
    effort: Array
    tip: Array
    capsules: Array
    bare: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        n = len(self.joints)
        shapes = {
            "R": (n, 3, 3), "p": (n, 3), "axis": (n, 3), "pi": (n, 10), "q_limit": (n, 2), "dq_limit": (n,), "effort": (n,),
            "tip": (3,), "capsules": (n, 7),
        }  # fmt: skip
        for name, shape in shapes.items():
            if (seen := getattr(self, name).shape) != shape:
                raise RobotError(f"{name} of the arm {self.name} has shape {seen}; expected {shape} for {n} joints: read it anew")


@dataclass(frozen=True, slots=True)
class Robot:
    """A serial arm with ``n`` revolute joints.

    ``pi``: (n, 10) standard parameters (see `stopset.robot.rigid`); of an identified arm, with all it carried when it was
    recorded, an identified payload included; ``q_limit``: (n, 2) [rad]; ``dq_limit``: (n,)
    [rad/s]; ``torque_limit``: (n,) [N m]; ``tip``: (3,) position of the tool point in the last link [m];
    ``arm``: as described, whatever was identified since; ``urdf``: the description's text, kept to be read by people.
    """

    name: str
    joints: tuple[str, ...]
    chain: Chain
    pi: Array
    q_limit: Array
    dq_limit: Array
    torque_limit: Array
    tip: Array
    drives: tuple[Drive, ...]
    arm: Arm
    urdf: str
    datasheet: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def n(self) -> int:
        return len(self.joints)

    @property
    def rotor(self) -> Array:
        """(n,) reflected rotor inertia [kg m^2]; 0 where the data sheet gives none."""
        return np.asarray(np.nan_to_num(np.array([d.rotor_inertia for d in self.drives]), nan=0.0))

    @property
    def as_described(self) -> Robot:
        """The arm of the description and the data sheet, without what was identified since."""
        return robot_of(self.arm, self.urdf, self.datasheet)

    def outline(self, q: Array) -> Array:
        """(n + 2, 3) [m] base, joints and flange in space at ``q`` (n,) [rad]: what a picture of the arm joins by lines."""
        R, o = link_frames(self.chain, np.ascontiguousarray(q, dtype=float))
        return np.vstack([np.zeros(3), o, o[-1] + R[-1] @ self.tip])

    def with_parameters(self, pi: Array) -> Robot:
        """The same arm with other standard parameters ``pi`` (n, 10)."""
        return replace(self, pi=np.array(pi, float).reshape(self.n, 10))


def robot_of(arm: Arm, urdf: str, datasheet: Mapping[str, Any]) -> Robot:
    """The described ``arm`` with the drives of its data sheet. Raises `RobotError` for a sheet that can't be meant."""
    drives, unknown = drives_of(arm.joints, datasheet)
    name = str(datasheet.get("robot") or arm.name)
    return Robot(
        name=name,
        joints=arm.joints,
        chain=Chain(arm.R, arm.p, arm.axis, gravity_of(datasheet, name)),
        pi=arm.pi,
        q_limit=arm.q_limit,
        dq_limit=arm.dq_limit,
        torque_limit=np.array(
            [d.torque_limit if np.isfinite(d.torque_limit) else e for d, e in zip(drives, arm.effort.tolist(), strict=True)]
        ),
        tip=arm.tip,
        drives=drives,
        arm=arm,
        urdf=urdf,
        datasheet=datasheet,
        notes=(*arm.notes, *unknown),
    )


def standard_parameters(mass: float, com: Array, inertia_com: Array) -> Array:
    """(10,) standard parameters of a body: mass, first moments, inertia about the frame's origin (parallel axes)."""
    inertia = inertia_com + mass * ((com @ com) * np.eye(3) - np.outer(com, com))
    ixx, iyy, izz = np.diag(inertia)
    return np.array([mass, *(mass * com), ixx, inertia[0, 1], iyy, inertia[0, 2], inertia[1, 2], izz])
