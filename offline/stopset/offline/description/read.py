"""Read a robot from its description: pinocchio reads the URDF, here stands which part of it is the arm."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from stopset.errors import RobotError
from stopset.offline.description.complete import complete, limits
from stopset.offline.description.enclose import capsules_of
from stopset.offline.description.meshes import with_mesh_paths
from stopset.offline.description.outline import Outline, check_joints, last_link, notes_of, outline
from stopset.offline.description.reduce import axes, check_serial, frame_of, position_limits, reduced
from stopset.robot.arm import Arm, Robot, robot_of
from stopset.types import Array


def shipped_robots() -> list[str]:
    """Names of the arms in the package, usable wherever a URDF path is."""
    folder = resources.files("stopset.robot") / "arms"
    return sorted(e.name for e in folder.iterdir() if e.is_dir() and (e / "robot.urdf").is_file())


def load_robot(where: str | Path, tip: str | None = None, lock: Sequence[str] = ()) -> Robot:
    """Read a robot: the name of a shipped arm (``lwa4p``) or the path of a URDF, with ``robot.json`` beside it.

    ``tip``: the frame (link or joint) that is the tool point, and with it the chain that is meant where the URDF branches;
    ``lock``: joints that are held at zero, as part of the link before them (a gripper's fingers, a lift).  Both may stand in
    ``robot.json`` too (``tip``, ``locked``).
    Raises `RobotError` for anything that is not a serial arm of revolute joints with inertias.
    """
    folder: Path | None = None
    if isinstance(where, str) and where in shipped_robots():
        arms = resources.files("stopset.robot") / "arms" / where
        urdf = (arms / "robot.urdf").read_text()
        sheet_text: str | None = (arms / "robot.json").read_text()
        source = where
    else:
        path = Path(where)
        if path.is_dir() or not path.exists():
            raise RobotError(
                f"--robot {where}: no such URDF file; expected a path to a URDF or one of the shipped arms "
                f"({', '.join(shipped_robots())})"
            )
        try:
            urdf = path.read_text()
            beside = path.with_name("robot.json")
            sheet_text = beside.read_text() if beside.exists() else None
        except (OSError, UnicodeDecodeError) as e:
            raise RobotError(f"{path}: cannot be read as text ({e}); give a URDF") from e
        source, folder = str(path), path.parent
    try:
        sheet = json.loads(sheet_text) if sheet_text else {}
    except (ValueError, RecursionError) as e:
        raise RobotError(f"robot.json beside {source} is not JSON ({e}); mend or remove it") from e
    if not isinstance(sheet, dict):
        raise RobotError(f"robot.json beside {source} is a {type(sheet).__name__}; expected an object: mend or remove it")
    if tip is not None:
        sheet = {**sheet, "tip": tip}
    if lock:
        sheet = {**sheet, "locked": [*sheet.get("locked", []), *lock]}
    return robot_from_text(urdf, sheet, source, folder)


def robot_from_text(
    urdf: str, datasheet: Mapping[str, Any] | None = None, source: str = "URDF", folder: Path | None = None
) -> Robot:
    """Build a robot from URDF text and a drive data sheet (see ``interfaces``: joints -> gear_ratio, ...).

    ``folder``: where the URDF lies, for its mesh files. Raises `RobotError`.
    """
    sheet = dict(datasheet or {})
    return robot_of(described(urdf, sheet, source, folder), urdf, sheet)


class Tree(NamedTuple):
    """A URDF's XML, complete; its tree by name; the joints that stand at zero; what was added."""

    root: ET.Element
    outline: Outline
    held: list[str]
    notes: list[str]


def read_tree(urdf: str, sheet: Mapping[str, Any], source: str) -> Tree:
    """The XML of a URDF and its tree by name. Raises `RobotError`."""
    try:
        root = ET.fromstring(urdf)
    except ET.ParseError as e:
        raise RobotError(f"{source} is not XML ({e}); expected a URDF") from e
    if root.tag != "robot":
        raise RobotError(f"{source} starts with <{root.tag}>, expected <robot>: give a URDF (expand xacro first)")
    added = complete(root)
    tree = outline(root, source)
    tip = sheet.get("tip")
    held = check_joints(tree, sheet.get("locked", ()), None if tip is None else tree.link_of(tip))
    return Tree(root, tree, held, added)


def described(urdf: str, sheet: Mapping[str, Any], source: str, folder: Path | None) -> Arm:
    """The arm of a description: ``sheet`` may name its ``tip`` and ``locked`` joints. Raises `RobotError`."""
    root, tree, held, added = read_tree(urdf, sheet, source)
    located, lacking = with_mesh_paths(root, folder)
    model, geometry = reduced(located, tree, held, collision=True)
    check_serial(model, tree, held)
    joints, n = tuple(model.names[1:]), model.nv
    pi = np.array([body.toDynamicParameters() for body in model.inertias[1:]])
    if not np.all(pi[:, 0] > 0):
        light = ", ".join(joints[k] for k in np.flatnonzero(pi[:, 0] <= 0))
        raise RobotError(f"{source}: no mass behind joint {light}; expected <inertial> with a positive mass")
    end = last_link(tree, joints[-1], held) if sheet.get("tip") is None else str(sheet["tip"])
    tip = np.array(frame_of(model, tree.link_of(end)).placement.translation)
    p = np.array([place.translation for place in model.jointPlacements[1:]])
    without = {frame_of(model, link).parentJoint - 1 for link in lacking}
    capsules, bare = capsules_of(geometry, _lines(p, tip), without, tip)
    none = tuple(joints[k] for k in bare)
    return Arm(
        name=tree.name,
        joints=joints,
        R=np.array([place.rotation for place in model.jointPlacements[1:]]),
        p=p,
        axis=axes(model),
        pi=pi,
        q_limit=limits(position_limits(model)),
        dq_limit=limits(np.reshape(model.velocityLimit, n)),
        effort=limits(np.reshape(model.effortLimit, n)),
        tip=tip,
        capsules=capsules,
        bare=none,
        notes=(*added, *notes_of(tree, held, sheet.get("locked", ()), end), *_of_shapes(none, joints, lacking)),
    )


def _lines(p: Array, tip: Array) -> Array:
    """(n, 7) the line from each joint to the next, or to the tool point, without any width."""
    ends = np.vstack([p[1:], tip])
    return np.hstack([np.zeros_like(ends), ends, np.zeros((len(ends), 1))])


def _of_shapes(bare: Sequence[str], joints: Sequence[str], lacking: Mapping[str, str]) -> list[str]:
    """What is to be said where a stop's swept volume is that of lines."""
    if not bare:
        return []
    which = "any joint" if len(bare) == len(joints) else f"joints {', '.join(bare)}"
    files = f" (e.g. {next(iter(lacking.values()))} is not here)" if lacking else ""
    return [
        f"no collision geometry behind {which}{files}: what a stop sweeps there is the line between joints, without the link's width"
    ]
