"""pinocchio's reading of a description, reduced to the joints of one arm: everything that stands still lumped into its link.

Source: Carpentier et al. (2019); `buildReducedModel` of pinocchio.
"""

from __future__ import annotations

import os
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from stopset.errors import RobotError
from stopset.offline.description.outline import Outline
from stopset.types import Array

LINK = " (link)"  # told apart from the joint of the same name


class Reduced(NamedTuple):
    """pinocchio's model of the arm alone, and its collision geometry (None where none was asked for)."""

    model: Any
    geometry: Any | None


def library() -> Any:
    """pinocchio. Raises `RobotError` where it is not installed."""
    try:
        import pinocchio
    except ImportError as e:
        raise RobotError(
            "pinocchio is not installed, by which robot descriptions are read; expected what `pip install 'stopset[offline]'` brings "
            f"({e}): install it, or identify on another machine and take the model file from there"
        ) from e
    return pinocchio


def reduced(urdf: str, tree: Outline, held: Sequence[str], *, collision: bool = False) -> Reduced:
    """The description with the joints ``held`` at zero. Raises `RobotError` with what pinocchio can't read in it."""
    pinocchio = library()
    with _heard() as complaints:
        try:
            distinct = _distinct_links(urdf)
            model = pinocchio.buildModelFromXML(distinct)
            geometry = pinocchio.buildGeomFromUrdfString(model, distinct, pinocchio.GeometryType.COLLISION) if collision else None
        except (ValueError, RuntimeError) as e:
            complaints.append(str(e))
    if complaints:
        raise RobotError(
            f"{tree.source} can't be read by pinocchio: {complaints[0].rstrip('.')}; expected a URDF by its standard: mend it"
        )
    locked = [model.getJointId(name) for name in held]
    if locked:
        at = pinocchio.neutral(model)
        if geometry is None:
            model = pinocchio.buildReducedModel(model, locked, at)
        else:
            model, geometry = pinocchio.buildReducedModel(model, geometry, locked, at)
    return Reduced(model, geometry)


def _distinct_links(urdf: str) -> str:
    """The description with links renamed that a joint shares its name with (a Sawyer's ``right_hand``): pinocchio keeps both in one list."""
    root = ET.fromstring(urdf)
    joints = {joint.get("name") for joint in root.iter("joint")}
    for kind, key in (("link", "name"), ("parent", "link"), ("child", "link")):
        for element in root.iter(kind):
            if (name := element.get(key)) in joints:
                element.set(key, f"{name}{LINK}")
    return ET.tostring(root, encoding="unicode")


def frame_of(model: Any, link: str) -> Any:
    """The frame of a link."""
    name = f"{link}{LINK}"
    return model.frames[model.getFrameId(name if model.existFrame(name) else link)]


def check_serial(model: Any, tree: Outline, held: Sequence[str]) -> None:
    """Raises `RobotError` where the arm has no joint, or several branches that turn."""
    if model.njoints < 2:
        raise RobotError(
            f"{tree.source} has no revolute joint between its base and the end of the chain; expected a serial arm: name its last link "
            f"with --tip, e.g. {tree.ends(())}, and lock what does not turn only"
        )
    for below in model.children:
        turns = [model.names[k] for k in below]
        if len(turns) > 1:
            at = next(j.parent for j in tree.joints if j.name == turns[0])
            raise RobotError(
                f"{tree.source} branches at {at} (joints {', '.join(turns)}); expected one arm: name the chain's last link with --tip, "
                f"one of {tree.ends(held)}, or lock a gripper's joints with --lock"
            )


def axes(model: Any) -> Array:
    """(n, 3) axis of each joint in its own frame."""
    pinocchio = library()
    data = model.createData()
    pinocchio.computeJointJacobians(model, data, pinocchio.neutral(model))
    LOCAL = pinocchio.ReferenceFrame.LOCAL
    columns = (np.reshape(pinocchio.getJointJacobian(model, data, k, LOCAL), (6, -1))[3:, k - 1] for k in range(1, model.njoints))
    return np.array(list(columns))


def position_limits(model: Any) -> Array:
    """(n, 2) [rad]; infinite for a joint that turns on, whose configuration is a cosine and a sine there."""
    out = np.tile([-np.inf, np.inf], (model.nv, 1))
    for k, joint in enumerate(model.joints[1:]):
        if joint.nq == 1:
            out[k] = model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q]
    return out


@contextmanager
def _heard() -> Iterator[list[str]]:
    """Sentences that the parser behind pinocchio writes to the terminal: it goes on after some errors, with zeros."""
    said: list[str] = []
    sys.stderr.flush()
    with tempfile.TemporaryFile() as captured:
        terminal = os.dup(2)
        os.dup2(captured.fileno(), 2)
        try:
            yield said
        finally:
            os.dup2(terminal, 2)
            os.close(terminal)
            captured.seek(0)
            lines = captured.read().decode("utf-8", "replace").splitlines()
            said[:0] = [" ".join(x.removeprefix("Error:").split()) for x in lines if x.startswith("Error:")]
