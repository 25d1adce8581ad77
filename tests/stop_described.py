"""Arms drawn at random as descriptions, and where their bodies are by a way of its own: from the XML's numbers, no line shared with the reader.

Joints with turned frames and slanted axes, links that fixed joints carry, a branch whose fingers follow one another, a slide that is
locked, boxes, cylinders and balls as shapes, any mounting.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass, field

import numpy as np

from stopset.types import Array

GRAVITY = 9.81


def turned(axis: Array, angle: float) -> Array:
    """(3, 3) rotation about ``axis`` (3,), of any length (Rodrigues)."""
    x, y, z = np.asarray(axis, float) / np.linalg.norm(axis)
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K)


def rpy(r: float, p: float, y: float) -> Array:
    """(3, 3) of fixed axes, as URDF means it."""
    return turned(np.array([0, 0, 1]), y) @ turned(np.array([0, 1, 0]), p) @ turned(np.array([1, 0, 0]), r)


def _words(x: Array) -> str:
    return " ".join(f"{v:.12g}" for v in x)


def _numbers(e: ET.Element | None, key: str, default: str) -> Array:
    return np.array((default if e is None else e.get(key, default)).split(), float)


@dataclass
class Drawn:
    """A description's text, its turning joints, those that are locked, and where gravity pulls in the base (3,) [m/s^2]."""

    urdf: str
    turning: list[str]
    locked: list[str]
    gravity: Array
    root: ET.Element = field(init=False)

    def __post_init__(self) -> None:
        self.root = ET.fromstring(self.urdf)

    def frames(self, q: Array) -> dict[str, tuple[Array, Array]]:
        """Of every link its rotation and origin in the base, from the URDF's own numbers."""
        at = {"base": (np.eye(3), np.zeros(3))}
        joints = self.root.findall("joint")
        while len(at) <= len(joints):
            for j in joints:
                parent, child = (str(j.find(k).get("link")) for k in ("parent", "child"))  # type: ignore[union-attr]
                if parent not in at or child in at:
                    continue
                R, o = at[parent]
                origin = j.find("origin")
                place, turn = R @ rpy(*_numbers(origin, "rpy", "0 0 0")), o + R @ _numbers(origin, "xyz", "0 0 0")
                if j.get("name") in self.turning:
                    place = place @ turned(_numbers(j.find("axis"), "xyz", "1 0 0"), q[self.turning.index(str(j.get("name")))])
                at[child] = place, turn
        return at

    def moving(self) -> set[str]:
        """Links behind a joint that turns."""
        above = {str(j.find("child").get("link")): j for j in self.root.findall("joint")}  # type: ignore[union-attr]

        def turns(link: str) -> bool:
            j = above.get(link)
            return j is not None and (j.get("name") in self.turning or turns(str(j.find("parent").get("link"))))  # type: ignore[union-attr]

        return {link for link in above if turns(link)}

    def bodies(self, q: Array) -> list[tuple[float, Array, Array]]:
        """Mass [kg], centre [m] and inertia about it [kg m^2] of every link, in base axes."""
        out, at = [], self.frames(q)
        for link in self.root.findall("link"):
            body = link.find("inertial")
            if body is None:
                continue
            R, o = at[str(link.get("name"))]
            origin, I = body.find("origin"), body.find("inertia")  # noqa: E741
            own = R @ rpy(*_numbers(origin, "rpy", "0 0 0"))
            ixx, iyy, izz, ixy, ixz, iyz = (float(I.get(k, "0")) for k in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"))  # type: ignore[union-attr]
            tensor = np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
            mass = float(body.find("mass").get("value"))  # type: ignore[union-attr, arg-type]
            out.append((mass, o + R @ _numbers(origin, "xyz", "0 0 0"), own @ tensor @ own.T))
        return out

    def surface(self, q: Array, rng: np.random.Generator, count: int = 6) -> list[Array]:
        """Points of the surfaces of all shapes of moving links (m, 3) [m], drawn with ``rng``: the same of one generator's state."""
        out, at = [], self.frames(q)
        for link in self.root.findall("link"):
            for shape in link.findall("collision"):
                origin, kind = shape.find("origin"), shape.find("geometry")[0]  # type: ignore[index]
                unit = rng.normal(size=(count, 3))
                unit /= np.linalg.norm(unit, axis=1)[:, None]
                if kind.tag == "sphere":
                    points = unit * float(kind.get("radius"))  # type: ignore[arg-type]
                elif kind.tag == "box":
                    points = 0.5 * np.sign(unit) * _numbers(kind, "size", "")
                else:
                    radius, half = float(kind.get("radius")), 0.5 * float(kind.get("length"))  # type: ignore[arg-type]
                    flat = unit[:, :2] / np.linalg.norm(unit[:, :2], axis=1)[:, None]
                    points = np.column_stack([radius * flat, half * np.sign(unit[:, 2])])
                R, o = at[str(link.get("name"))]
                if str(link.get("name")) in self.moving():
                    out.append(o + (points @ rpy(*_numbers(origin, "rpy", "0 0 0")).T + _numbers(origin, "xyz", "0 0 0")) @ R.T)
        return out


def _shape(rng: np.random.Generator) -> str:
    size = rng.uniform(0.03, 0.12, 3)
    kind = rng.choice(["box", "cylinder", "sphere"])
    words = {
        "box": f'<box size="{_words(size)}"/>',
        "cylinder": f'<cylinder radius="{size[0]:.6g}" length="{2 * size[1]:.6g}"/>',
        "sphere": f'<sphere radius="{size[0]:.6g}"/>',
    }[str(kind)]
    place = f'<origin xyz="{_words(rng.uniform(-0.1, 0.1, 3))}" rpy="{_words(rng.uniform(-2, 2, 3))}"/>'
    return f"<collision>{place}<geometry>{words}</geometry></collision>"


def _link(name: str, rng: np.random.Generator, mass: float) -> str:
    a, b, c = mass * rng.uniform(0.002, 0.01, 3)
    Q = turned(rng.normal(size=3), rng.uniform(0, 3))
    I = Q @ np.diag([a + b, b + c, a + c]) @ Q.T  # noqa: E741
    numbers = " ".join(
        f'{k}="{v:.12g}"'
        for k, v in zip(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), (*np.diag(I), I[0, 1], I[0, 2], I[1, 2]), strict=True)
    )
    place = f'<origin xyz="{_words(rng.uniform(-0.1, 0.1, 3))}" rpy="{_words(rng.uniform(-2, 2, 3))}"/>'
    return f'<link name="{name}"><inertial>{place}<mass value="{mass:.6g}"/><inertia {numbers}/></inertial>{_shape(rng)}</link>'


def _joint(name: str, kind: str, parent: str, child: str, rng: np.random.Generator, more: str = "") -> str:
    slanted = rng.normal(size=3) if rng.random() < 0.4 else np.eye(3)[rng.integers(3)] * rng.choice([-1.0, 1.0])
    place = f'<origin xyz="{_words(rng.uniform(-0.25, 0.25, 3))}" rpy="{_words(rng.uniform(-3, 3, 3))}"/>'
    limit = '<limit lower="-3.1" upper="3.1" velocity="2.0" effort="500"/>'
    return (
        f'<joint name="{name}" type="{kind}">{place}<parent link="{parent}"/><child link="{child}"/>'
        f'<axis xyz="{_words(slanted / np.linalg.norm(slanted))}"/>{limit}{more}</joint>'
    )


def draw(n: int, seed: int) -> Drawn:
    """An arm of ``n`` joints; a link on a fixed joint between some, and a gripper with two fingers, a camera beside."""
    rng = np.random.default_rng([n, seed])
    rows, turning, locked, last = [_link("base", rng, 5.0)], [], [], "base"
    for i in range(n):
        if rng.random() < 0.4:
            rows += [_link(f"between_{i}", rng, 0.4), _joint(f"still_{i}", "fixed", last, f"between_{i}", rng)]
            last = f"between_{i}"
        if rng.random() < 0.25:
            rows += [_link(f"slid_{i}", rng, 0.3), _joint(f"slide_{i}", "prismatic", last, f"slid_{i}", rng)]
            locked.append(f"slide_{i}")
            last = f"slid_{i}"
        rows += [_link(f"l{i}", rng, 4.0 / (i + 1)), _joint(f"j{i}", "revolute", last, f"l{i}", rng)]
        turning.append(f"j{i}")
        last = f"l{i}"
        if rng.random() < 0.3:
            rows += [_link(f"camera_{i}", rng, 0.2), _joint(f"screws_{i}", "fixed", last, f"camera_{i}", rng)]
    rows += [_link("palm", rng, 0.5), _joint("wrist", "fixed", last, "palm", rng)]
    rows += [_link("finger", rng, 0.1), _joint("open", "prismatic", "palm", "finger", rng)]
    rows += [_link("other", rng, 0.1), _joint("follow", "prismatic", "palm", "other", rng, '<mimic joint="open"/>')]
    locked += ["open", "follow"]
    gravity = turned(rng.normal(size=3), rng.uniform(0, np.pi)) @ np.array([0.0, 0.0, -GRAVITY])
    return Drawn(f'<robot name="drawn">{"".join(rows)}</robot>', turning, locked, gravity)
