"""A robot as stopset knows it: a serial arm of revolute joints from a URDF, and its drives from a data sheet.

The URDF is read here with the standard library, because the monitor's host needs the same arm from the text embedded
in the model file and should not carry a rigid-body library for that; the tests compare every arm with pinocchio's reading.
"""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from stopset.errors import RobotError
from stopset.robot.rigid import Chain, link_frames
from stopset.types import Array

STANDARD_GRAVITY = 9.81  # [m/s^2] as in most URDF tools; the data sheet's "gravity" overrides it


@dataclass(frozen=True, slots=True)
class Drive:
    """What a drive's data sheet says of one joint; ``nan`` where it says nothing. All link side, SI."""

    gear_ratio: float = float("nan")
    rotor_inertia: float = float("nan")  # k_r^2 I_m [kg m^2], reflected to the link side
    torque_limit: float = float("nan")  # [N m]
    brake_torque: float = float("nan")  # nominal dynamic torque [N m]
    brake_delay: tuple[float, float] = (float("nan"), float("nan"))  # current off -> torque starts to rise [s]
    brake_rise: tuple[float, float] = (float("nan"), float("nan"))  # torque rise [s]
    brake_tolerance: float = float("nan")  # relative half-width of the torque interval


@dataclass(frozen=True, slots=True)
class Robot:
    """A serial arm with ``n`` revolute joints.

    ``pi``: (n, 10) standard parameters (see `stopset.robot.rigid`); of an identified arm, with all it carried when it was
    recorded, an identified payload included; ``q_limit``: (n, 2) [rad]; ``dq_limit``: (n,)
    [rad/s]; ``torque_limit``: (n,) [N m]; ``tip``: (3,) position of the flange (last fixed frame) in the last link [m];
    ``gravity``: (3,) [m/s^2] in the base frame.
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

    def outline(self, q: Array) -> Array:
        """(n + 2, 3) [m] base, joints and flange in space at ``q`` (n,) [rad]: what a picture of the arm joins by lines."""
        R, o = link_frames(self.chain, np.ascontiguousarray(q, dtype=float))
        return np.vstack([np.zeros(3), o, o[-1] + R[-1] @ self.tip])

    def with_payload(self, mass: float, com: Array, inertia: Array | None = None) -> Robot:
        """The same arm with a rigid load in the last link: ``mass`` [kg], ``com`` (3,) [m] in the last link frame.

        ``inertia``: (3, 3) about the load's centre of mass [kg m^2], zero if left out (a point mass).
        """
        pi = self.pi.copy()
        pi[-1] += standard_parameters(mass, np.asarray(com, float), np.zeros((3, 3)) if inertia is None else inertia)
        return replace(self, pi=pi)

    def with_parameters(self, pi: Array) -> Robot:
        """The same arm with other standard parameters ``pi`` (n, 10)."""
        return replace(self, pi=np.array(pi, float).reshape(self.n, 10))


def standard_parameters(mass: float, com: Array, inertia_com: Array) -> Array:
    """(10,) standard parameters of a body: mass, first moments, inertia about the frame's origin (parallel axes)."""
    inertia = inertia_com + mass * ((com @ com) * np.eye(3) - np.outer(com, com))
    ixx, iyy, izz = np.diag(inertia)
    return np.array([mass, *(mass * com), ixx, inertia[0, 1], iyy, inertia[0, 2], inertia[1, 2], izz])


def shipped_robots() -> list[str]:
    """Names of the arms in the package, usable wherever a URDF path is."""
    folder = resources.files("stopset.robot") / "arms"
    return sorted(e.name for e in folder.iterdir() if e.is_dir() and (e / "robot.urdf").is_file())


def load_robot(where: str | Path, payload: float = 0.0, tip: str | None = None, lock: Sequence[str] = ()) -> Robot:
    """Read a robot: the name of a shipped arm (``lwa4p``) or the path of a URDF, with ``robot.json`` beside it.

    ``tip``: the last link of the chain that is meant, where the URDF branches; ``lock``: joints that are held at zero, as
    part of the link before them (a gripper's fingers, a lift).  Both may stand in ``robot.json`` too (``tip``, ``locked``).
    Raises `RobotError` for anything that is not a serial arm of revolute joints with inertias.
    """
    if isinstance(where, str) and where in shipped_robots():
        folder = resources.files("stopset.robot") / "arms" / where
        urdf = (folder / "robot.urdf").read_text()
        sheet_text: str | None = (folder / "robot.json").read_text()
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
        source = str(path)
    try:
        sheet = json.loads(sheet_text) if sheet_text else {}
    except json.JSONDecodeError as e:
        raise RobotError(f"robot.json beside {source} is not JSON ({e}); mend or remove it") from e
    if tip is not None:
        sheet = {**sheet, "tip": tip}
    if lock:
        sheet = {**sheet, "locked": [*sheet.get("locked", []), *lock]}
    return robot_from_text(urdf, sheet, source)


def robot_from_text(urdf: str, datasheet: Mapping[str, Any] | None = None, source: str = "URDF") -> Robot:
    """Build a robot from URDF text and a drive data sheet (see ``interfaces``: joints -> gear_ratio, ...)."""
    try:
        root = ET.fromstring(urdf)
    except ET.ParseError as e:
        raise RobotError(f"{source} is not XML ({e}); expected a URDF") from e
    if root.tag != "robot":
        raise RobotError(f"{source} starts with <{root.tag}>, expected <robot>: give a URDF (expand xacro first)")
    sheet = dict(datasheet or {})
    notes: list[str] = []
    links, path = _read_tree(root, source, sheet, notes)
    moving = [j for j in path if j.kind != "fixed"]
    if not moving:
        raise RobotError(f"{source} has no revolute joint on its longest chain; expected a serial arm")
    R, p = np.empty((len(moving), 3, 3)), np.empty((len(moving), 3))
    pi = np.zeros((len(moving), 10))
    T = np.eye(4)  # from the last moving link (or the base) to the current link
    i = -1
    for j in path:
        T = T @ j.placement
        if j.kind != "fixed":
            i += 1
            R[i], p[i] = T[:3, :3], T[:3, 3]
            T = np.eye(4)
        if i >= 0:
            for body in links.get(j.child, ()):  # the link and whatever is fixed to it off the chain
                pi[i] += _moved(body, T)
    if not np.all(pi[:, 0] > 0):
        lacking = [moving[k].name for k in np.flatnonzero(pi[:, 0] <= 0)]
        raise RobotError(f"{source}: no mass behind joint {', '.join(lacking)}; expected <inertial> with a positive mass")
    drives = tuple(_drive(j.name, sheet, notes) for j in moving)
    gravity = np.array(sheet.get("gravity", [0.0, 0.0, -STANDARD_GRAVITY]), float)
    if gravity.shape != (3,) or not np.all(np.isfinite(gravity)):
        raise RobotError(f"robot.json of {source}: gravity is {sheet['gravity']}; expected three numbers [m/s^2]")
    return Robot(
        name=str(sheet.get("robot") or root.get("name") or "robot"),
        joints=tuple(j.name for j in moving),
        chain=Chain(R, p, np.array([j.axis for j in moving]), gravity),
        pi=pi,
        q_limit=np.array([j.q_limit for j in moving]),
        dq_limit=np.array([j.dq_limit for j in moving]),
        torque_limit=np.array(
            [d.torque_limit if np.isfinite(d.torque_limit) else j.effort for d, j in zip(drives, moving, strict=True)]
        ),
        tip=T[:3, 3].copy(),
        drives=drives,
        urdf=urdf,
        datasheet=sheet,
        notes=tuple(notes),
    )


@dataclass(frozen=True, slots=True)
class _Joint:
    name: str
    kind: str
    parent: str
    child: str
    placement: Array
    axis: Array
    q_limit: tuple[float, float]
    dq_limit: float
    effort: float


def _numbers(text: str | None, default: str, what: str) -> Array:
    try:
        out = np.array([float(x) for x in (text or default).split()])
    except ValueError as e:
        raise RobotError(f"{what}: {text!r} are not numbers; expected e.g. {default!r}") from e
    if out.shape != (len(default.split()),) or not np.all(np.isfinite(out)):
        raise RobotError(f"{what}: {text!r}; expected {len(default.split())} finite numbers")
    return out


def _placement(element: ET.Element | None, what: str) -> Array:
    T = np.eye(4)
    if element is not None:
        r, p, y = _numbers(element.get("rpy"), "0 0 0", what)
        cr, sr, cp, sp, cy, sy = np.cos(r), np.sin(r), np.cos(p), np.sin(p), np.cos(y), np.sin(y)
        T[:3, :3] = [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
        T[:3, 3] = _numbers(element.get("xyz"), "0 0 0", what)
    return T


def _read_joint(e: ET.Element, source: str) -> _Joint:
    name, kind = e.get("name", "?"), e.get("type", "?")
    what = f"{source}, joint {name}"
    parent, child = e.find("parent"), e.find("child")
    if parent is None or child is None:
        raise RobotError(f"{what} lacks <parent> or <child>; mend the URDF")
    axis_e = e.find("axis")
    axis = _numbers(axis_e.get("xyz") if axis_e is not None else None, "1 0 0", what)
    limit = e.find("limit")
    lo, hi, dq, effort = -np.inf, np.inf, np.inf, np.inf
    if limit is not None:
        if kind == "revolute":
            lo = float(limit.get("lower", "-inf"))
            hi = float(limit.get("upper", "inf"))
        dq, effort = float(limit.get("velocity", "inf")), float(limit.get("effort", "inf"))
    norm = float(np.linalg.norm(axis))
    if kind not in ("fixed",) and norm < 1e-9:
        raise RobotError(f"{what}: the axis is zero; expected a unit vector")
    return _Joint(
        name, kind, str(parent.get("link")), str(child.get("link")), _placement(e.find("origin"), what),
        axis / max(norm, 1e-9), (lo, hi), dq, effort,
    )  # fmt: skip


def _read_tree(
    root: ET.Element, source: str, sheet: Mapping[str, Any], notes: list[str]
) -> tuple[dict[str, list[Array]], list[_Joint]]:
    """Bodies of each link (as 10-vectors in its frame, what hangs beside the chain lumped in), and the chain of joints.

    The chain ends at the data sheet's ``tip``, or is the longest one; joints beside it, and those ``locked``, stand at zero.
    """
    joints = [_read_joint(e, source) for e in root.findall("joint")]
    names = {j.name for j in joints}
    locked = set(sheet.get("locked", ()))
    if not locked <= names:
        raise RobotError(
            f"{source} has no joint {', '.join(sorted(locked - names))} to lock; expected of its joints: mend --lock"
        )
    # fingers that follow another one move nothing by themselves
    follows = {str(e.get("name")) for e in root.findall("joint") if e.find("mimic") is not None}
    joints = [replace(j, kind="fixed") if j.name in locked or j.name in follows else j for j in joints]
    children: dict[str, list[_Joint]] = {}
    for j in joints:
        children.setdefault(j.parent, []).append(j)
    bodies: dict[str, list[Array]] = {}
    for e in root.findall("link"):
        inertial = e.find("inertial")
        if inertial is not None:
            bodies[str(e.get("name"))] = [_read_body(inertial, f"{source}, link {e.get('name')}")]
    links = {str(e.get("name")) for e in root.findall("link")}
    roots = links - {j.child for j in joints}
    if len(roots) != 1:
        raise RobotError(f"{source} has {len(roots)} base links ({', '.join(sorted(roots))}); expected one tree")
    base = roots.pop()
    chain = _chain(base, children, links, sheet.get("tip"), source)
    on = {j.name for j in chain}
    for link in [base, *(j.child for j in chain)]:
        for side in children.get(link, ()):
            if side.name not in on:
                bodies.setdefault(link, []).extend(_lumped(side, children, bodies))
    beside = [j.name for j in joints if j.kind != "fixed" and j.name not in on]
    if beside:
        notes.append(
            f"the URDF's joints {', '.join(beside)} are beside the chain to {chain[-1].child} and taken to stand at zero"
        )
    held = sorted(locked | follows)
    if held:
        notes.append(f"the URDF's joints {_few(held)} are taken to stand at zero")
    for j in chain:
        if j.kind not in ("revolute", "continuous", "fixed"):
            raise RobotError(
                f"{source}: joint {j.name} is {j.kind}; only revolute joints are covered: lock it where it stands still "
                f"(--lock {j.name})"
            )
    return bodies, chain


def _few(names: Sequence[str], most: int = 6) -> str:
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def _chain(base: str, children: Mapping[str, list[_Joint]], links: set[str], tip: str | None, source: str) -> list[_Joint]:
    """The joints from the base link to ``tip``, or along the one branch that turns; raises where there are several."""
    above = {j.child: j for some in children.values() for j in some}
    if tip is not None:
        if tip not in links:
            raise RobotError(f"{source} has no link {tip!r}; expected one of its links as --tip, e.g. {_ends(base, children)}")
        up: list[_Joint] = []
        while tip != base:
            up.append(above[tip])
            tip = up[-1].parent
        return up[::-1]

    def turning(link: str) -> int:
        """Most joints of an arm on a branch: fingers that slide are none."""
        return max((turning(j.child) + (j.kind in ("revolute", "continuous")) for j in children.get(link, ())), default=0)

    def plain(link: str) -> bool:
        return not any(j.kind == "fixed" for j in children.get(link, ()))

    chain: list[_Joint] = []
    link = base
    while children.get(link):
        here = sorted(children[link], key=lambda j: -turning(j.child) - (j.kind in ("revolute", "continuous")))
        turns = [j for j in here if turning(j.child) or j.kind in ("revolute", "continuous")]
        if len(turns) > 1:
            raise RobotError(
                f"{source} branches at {link} (joints {', '.join(j.name for j in turns)}); expected one arm: name the chain's last "
                f"link with --tip, one of {_ends(base, children)}, or lock a gripper's joints with --lock"
            )
        if not turns and (len(here) > 1 or here[0].kind != "fixed") and not plain(link):
            here = [j for j in here if j.kind == "fixed"]  # fingers beside the flange
        if not turns and here[0].kind != "fixed":
            break  # fingers that slide: the chain ends at the hand
        chain.append(here[0])
        link = here[0].child
    return chain


def _ends(base: str, children: Mapping[str, list[_Joint]]) -> str:
    """The tree's last links, those behind most joints first."""
    found: list[tuple[int, str]] = []

    def down(link: str, count: int) -> None:
        for j in children.get(link, ()):
            down(j.child, count + (j.kind != "fixed"))
        if not children.get(link):
            found.append((count, link))

    down(base, 0)
    return ", ".join(f"{name} ({count} joints)" for count, name in sorted(found, key=lambda x: -x[0])[:6])


def _lumped(joint: _Joint, children: Mapping[str, list[_Joint]], bodies: Mapping[str, list[Array]]) -> list[Array]:
    below = list(bodies.get(joint.child, ()))
    for j in children.get(joint.child, ()):
        below += _lumped(j, children, bodies)
    return [_moved(b, joint.placement) for b in below]


def _read_body(e: ET.Element, what: str) -> Array:
    mass_e, inertia_e = e.find("mass"), e.find("inertia")
    if mass_e is None or inertia_e is None:
        raise RobotError(f"{what}: <inertial> lacks <mass> or <inertia>; expected both")
    T = _placement(e.find("origin"), what)
    v = {k: float(inertia_e.get(k, "0")) for k in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")}
    tensor = np.array([[v["ixx"], v["ixy"], v["ixz"]], [v["ixy"], v["iyy"], v["iyz"]], [v["ixz"], v["iyz"], v["izz"]]])
    mass = float(mass_e.get("value", "nan"))
    if not (np.isfinite(mass) and mass >= 0 and np.all(np.isfinite(tensor))):
        raise RobotError(f"{what}: mass {mass} or inertia is not a finite, non-negative number")
    return standard_parameters(mass, T[:3, 3], T[:3, :3] @ tensor @ T[:3, :3].T)


def _moved(body: Array, T: Array) -> Array:
    """Standard parameters of a body, expressed in the parent frame of the placement ``T`` (4, 4)."""
    m, h = body[0], body[1:4]
    tensor = np.array([[body[4], body[5], body[7]], [body[5], body[6], body[8]], [body[7], body[8], body[9]]])
    R, p = T[:3, :3], T[:3, 3]
    hr = R @ h
    moved = R @ tensor @ R.T + (2 * hr @ p + m * p @ p) * np.eye(3)
    moved -= np.outer(hr, p) + np.outer(p, hr) + m * np.outer(p, p)
    return np.array([m, *(hr + m * p), moved[0, 0], moved[0, 1], moved[1, 1], moved[0, 2], moved[1, 2], moved[2, 2]])


_KNOWN = {
    "gear_ratio", "motor_inertia_kgm2", "reflected_motor_inertia_kgm2", "torque_limit_Nm", "brake_torque_nominal_Nm",
    "brake_delay_s", "brake_rise_s", "brake_tolerance", "source",
}  # fmt: skip


def _drive(joint: str, sheet: Mapping[str, Any], notes: list[str]) -> Drive:
    row = sheet.get("joints", {}).get(joint, {})
    if not isinstance(row, Mapping):
        raise RobotError(f"robot.json: the entry of joint {joint} is {row!r}; expected an object")
    unknown = set(row) - _KNOWN
    if unknown:
        notes.append(f"robot.json: {joint}: {', '.join(sorted(unknown))} ignored")

    def number(key: str) -> float:
        value = row.get(key, float("nan"))
        if isinstance(value, bool) or not isinstance(value, (int, float)) or value < 0:
            raise RobotError(f"robot.json: {joint}.{key} is {value!r}; expected a non-negative number")
        return float(value)

    def interval(key: str) -> tuple[float, float]:
        value = row.get(key)
        if value is None:
            return (float("nan"), float("nan"))
        if not (isinstance(value, list) and len(value) == 2 and 0 <= value[0] <= value[1]):
            raise RobotError(f"robot.json: {joint}.{key} is {value!r}; expected [lo, hi] in seconds")
        return (float(value[0]), float(value[1]))

    gear = number("gear_ratio")
    reflected = number("motor_inertia_kgm2") * gear**2
    if not np.isfinite(reflected):
        reflected = number("reflected_motor_inertia_kgm2")
    return Drive(
        gear_ratio=gear,
        rotor_inertia=reflected,
        torque_limit=number("torque_limit_Nm"),
        brake_torque=number("brake_torque_nominal_Nm"),
        brake_delay=interval("brake_delay_s"),
        brake_rise=interval("brake_rise_s"),
        brake_tolerance=number("brake_tolerance"),
    )
