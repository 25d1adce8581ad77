"""What URDF files in use leave out and their standard asks for: pinocchio's parser refuses, or takes a body as nothing, without it."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np

from stopset.types import Array

FREE = 1e300  # stands for a limit that is not given, where the parser takes no infinity
TURNING = ("revolute", "continuous")
PRODUCTS = ("ixy", "ixz", "iyz")


def complete(root: ET.Element) -> list[str]:
    """Write into ``root`` products of inertia that are missing as zero and limits that are missing, or of speed or effort zero, as none;
    tells which joints."""
    for inertia in root.iterfind("link/inertial/inertia"):
        for product in PRODUCTS:
            inertia.attrib.setdefault(product, "0")
    without: dict[str, list[str]] = {}
    for joint in root.iterfind("joint[@type='revolute']"):
        limit = joint.find("limit")
        if limit is None:
            limit = ET.SubElement(joint, "limit")
        for name, free in (("lower", -FREE), ("upper", FREE), ("velocity", FREE), ("effort", FREE)):
            if name not in limit.attrib:
                limit.set(name, repr(free))
                without.setdefault(joint.get("name", "?"), []).append(name)
    for joint in root.iterfind("joint"):  # an arm that can't move at all was not recorded: tools write 0 where nobody said
        limit = joint.find("limit")
        for name in ("velocity", "effort"):
            if limit is not None and joint.get("type") in TURNING and _is_zero(limit.get(name)):
                limit.set(name, repr(FREE))
                without.setdefault(joint.get("name", "?"), []).append(name)
    return [f"the URDF gives joint {j} no {', '.join(names)} limit; taken as unlimited" for j, names in without.items()]


def _is_zero(text: str | None) -> bool:
    try:
        return text is not None and float(text) == 0.0
    except ValueError:
        return False  # the parser says what is wrong with it


def limits(values: Array) -> Array:
    """Numbers that pinocchio read, infinite where none was given."""
    return np.where(np.abs(values) >= FREE, np.copysign(np.inf, values), values)
