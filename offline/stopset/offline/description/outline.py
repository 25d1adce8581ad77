"""A description's tree by name, to refuse by name what is no arm before pinocchio builds it: who turns, who follows, who closes a loop.

No number is read here but the masses' signs; frames, axes, limits and inertias are pinocchio's.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Collection, Sequence
from dataclasses import dataclass

from stopset.errors import RobotError

TURNS = ("revolute", "continuous")


@dataclass(frozen=True, slots=True)
class Joint:
    """One joint of a description: its kind of the URDF, the links it joins, and whom it follows ("" nobody)."""

    name: str
    kind: str
    parent: str
    child: str
    follows: str


@dataclass(frozen=True, slots=True)
class Outline:
    """Links and joints of a description in its own order; ``base`` is the one link that hangs on nothing."""

    name: str
    links: tuple[str, ...]
    joints: tuple[Joint, ...]
    base: str
    source: str

    def below(self, link: str) -> list[Joint]:
        """The joints that hang on ``link``."""
        return [j for j in self.joints if j.parent == link]

    def to(self, link: str) -> list[Joint]:
        """The joints from the base to ``link``."""
        above = {j.child: j for j in self.joints}
        up: list[Joint] = []
        while link != self.base:
            up.append(above[link])
            link = up[-1].parent
        return up[::-1]

    def link_of(self, frame: str) -> str:
        """The link that a frame's name means: a link's own, or the one behind a joint. Raises `RobotError`."""
        found = [j.child for j in self.joints if j.name == frame]
        if frame not in self.links and not found:
            raise RobotError(
                f"{self.source} has no link or joint {frame!r}; expected one of its frames as --tip, e.g. {self.ends(())}: mend --tip"
            )
        return frame if frame in self.links else found[0]

    def ends(self, held: Collection[str]) -> str:
        """The tree's last links, those behind most joints first, for a sentence."""
        found = [
            (sum(j.kind != "fixed" and j.name not in held for j in self.to(link)), link)
            for link in self.links
            if not self.below(link)
        ]
        found = [x for x in found if x[0]] or found  # to frames of the base no chain leads
        return ", ".join(f"{link} ({count} joints)" for count, link in sorted(found, key=lambda x: -x[0])[:6])


def outline(root: ET.Element, source: str) -> Outline:
    """The tree of a URDF's ``root`` element. Raises `RobotError` for what is no tree."""
    joints = tuple(_joint(e, source) for e in root.findall("joint"))
    links = tuple(str(e.get("name")) for e in root.findall("link"))
    above: dict[str, Joint] = {}
    for j in joints:
        for link in (j.parent, j.child):
            if link not in links:
                raise RobotError(
                    f"{source}: joint {j.name} names link {link}, which is not there; expected one of its links: mend it"
                )
        if j.child in above:
            raise RobotError(
                f"{source}: joint {j.name} closes a loop: link {j.child} hangs on joint {above[j.child].name} already; expected a "
                "serial arm, each link on one joint: take the joint out, or describe an arm without the loop"
            )
        above[j.child] = j
    bases = [link for link in links if link not in above]
    for j in joints:  # climbing from a joint of a ring never ends
        link, seen = j.parent, {j.child}
        while link in above and link not in seen:
            seen.add(link)
            link = above[link].parent
        if link in seen:
            raise RobotError(
                f"{source}: joint {j.name} is in a loop of links; expected a serial arm from one base link: mend the URDF"
            )
    if len(bases) != 1:
        raise RobotError(f"{source} has {len(bases)} base links ({', '.join(sorted(bases))}); expected one tree: mend the URDF")
    for e in root.findall("link"):
        _check_mass(e, source)
    return Outline(str(root.get("name") or "robot"), links, joints, bases[0], source)


def _joint(e: ET.Element, source: str) -> Joint:
    name, parent, child, mimic = e.get("name", "?"), e.find("parent"), e.find("child"), e.find("mimic")
    if parent is None or child is None:
        raise RobotError(f"{source}, joint {name} lacks <parent> or <child>; expected both: mend the URDF")
    follows = "" if mimic is None else mimic.get("joint", "?")
    return Joint(name, e.get("type", "?"), str(parent.get("link")), str(child.get("link")), follows)


def _check_mass(link: ET.Element, source: str) -> None:
    mass = link.find("inertial/mass")
    value = "0" if mass is None else mass.get("value", "0")
    if value.strip().startswith("-") and float(value) < 0:
        raise RobotError(
            f"{source}, link {link.get('name')}: mass {value} is negative; expected a finite, non-negative number: mend it"
        )


def check_joints(tree: Outline, locked: Collection[str], tip: str | None) -> list[str]:
    """Joints that stand still: those ``locked``, and with a ``tip`` named all that are not on the way to it.

    Raises `RobotError` with the name of each joint that moves and that no arm of stopset has: one that slides, one that follows.
    """
    names = {j.name for j in tree.joints}
    if not set(locked) <= names:
        strange = ", ".join(sorted(set(locked) - names))
        moves = ", ".join(j.name for j in tree.joints if j.kind != "fixed")
        raise RobotError(f"{tree.source} has no joint {strange} to lock; expected some of {moves}: mend --lock")
    chain = tree.joints if tip is None else tree.to(tip)
    for j in chain:
        if j.kind == "fixed" or j.name in locked:
            continue
        why = f"follows joint {j.follows} (mimic)" if j.follows else f"is {j.kind}"
        if j.follows or j.kind not in TURNS:
            others = [o.name for o in chain if o.name not in locked and (o.follows or o.kind not in (*TURNS, "fixed"))]
            raise RobotError(
                f"{tree.source}: joint {j.name} {why}; expected joints that turn by themselves: lock what stands still "
                f"(--lock {','.join(others)}), or name the arm's last link with --tip where it is beside the arm"
            )
    turning = {j.name for j in chain if j.kind != "fixed" and j.name not in locked}
    return [j.name for j in tree.joints if j.kind != "fixed" and j.name not in turning]


def last_link(tree: Outline, last: str, held: Collection[str]) -> str:
    """The flange behind the joint ``last``: along the first joints of the description that stand still, to the end."""
    link = next(j.child for j in tree.joints if j.name == last)
    while still := [j for j in tree.below(link) if j.kind == "fixed" or j.name in held]:
        link = still[0].child
    return link


def notes_of(tree: Outline, held: Sequence[str], locked: Collection[str], end: str) -> list[str]:
    """What is to be said of joints that stand at zero."""
    beside = [name for name in held if name not in locked]
    out = [f"the URDF's joints {', '.join(beside)} are beside the chain to {end} and taken to stand at zero"] if beside else []
    if locked:
        out.append(f"the URDF's joints {_few(sorted(locked))} are taken to stand at zero")
    return out


def _few(names: Sequence[str], most: int = 6) -> str:
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")
