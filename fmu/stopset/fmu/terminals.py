"""Terminals and icon of a unit (FMI 3): which variables belong to one plug, and what tools show for it.

Source: FMI 3.0.1 standard, 2.4.9 (terminals and icons).
"""

from __future__ import annotations

import struct
import xml.etree.ElementTree as ET
import zlib
from collections.abc import Sequence

from stopset.fmu.variables import Variable, Variables

# terminal -> groups of variables, and what it is for; members are in the order of the joints
TERMINALS = {
    "drive": (("TAU",), "torque of every joint"),
    "sensors": (("Q_MEASURED", "DQ_MEASURED", "TEMP", "MEASURED"), "the measured arm"),
    "motion": (("Q", "DQ"), "the nominal motion"),
    "bounds": (("Q_LO", "Q_HI", "DQ_LO", "DQ_HI", "AGE", "COVERED"), "where a measured state can be"),
    "verdict": (("CONFORMANT", "VERDICT", "VIOLATED_JOINT"), "whether the measured arm is where the model says"),
    "stop": (
        ("STOP", "EVALUATE_STOP", "STOP_TIME", "STOP_ANGLE", "STOP_FORWARD", "STOP_BACK", "STOP_CERTIFIED", "STOP_END_STOP"),
        "request of a stop, and the bounds of one",
    ),
    "path": (
        ("PATH_ROW", "PATH_RATE", "PATH_STOP_TIME", "PATH_STOP_CERTIFIED", "PATH_STOP_END_STOP"),
        "a stop along the programmed path",
    ),
}
SIZE = 96  # pixels of the icon
# of the icon, as shares of its size: an arm of two links, and the line it must not cross
LINKS = ((0.20, 0.85, 0.35, 0.35), (0.35, 0.35, 0.70, 0.30))
WALL = (0.88, 0.10, 0.88, 0.90)
INK, STOP, PAPER = (38, 50, 56), (211, 47, 47), (255, 255, 255)


def terminals(variables: Variables) -> str:
    """terminalsAndIcons.xml."""
    root = ET.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    picture = ET.SubElement(root, "GraphicalRepresentation")
    square = {"x1": "-100", "y1": "-100", "x2": "100", "y2": "100"}
    ET.SubElement(picture, "CoordinateSystem", square, suggestedScalingFactorTo_mm="0.1")
    ET.SubElement(picture, "Icon", square)
    every = ET.SubElement(root, "Terminals")
    for name, (groups, what) in TERMINALS.items():
        members = [v for group in groups for v in variables if v.group == group]
        if members:
            terminal = ET.SubElement(every, "Terminal", name=name, matchingRule="bus", description=what)
            for v in members:
                ET.SubElement(terminal, "TerminalMemberVariable", variableName=v.name, memberName=v.name, variableKind=kind(v))
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def kind(v: Variable) -> str:
    """What goes through that pin."""
    return "signal" if v.causality in ("input", "output") else "local"


def icon() -> bytes:
    """A PNG of `SIZE` pixels a side."""
    rows = bytearray()
    for y in range(SIZE):
        rows.append(0)  # no filter
        for x in range(SIZE):
            here = ((x + 0.5) / SIZE, (y + 0.5) / SIZE)
            rows += bytes(STOP if near(here, WALL, 0.03) else INK if any(near(here, k, 0.055) for k in LINKS) else PAPER)
    head = struct.pack(">2I5B", SIZE, SIZE, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + _chunk(b"IHDR", head) + _chunk(b"IDAT", zlib.compress(bytes(rows), 9)) + _chunk(b"IEND", b"")


def near(point: Sequence[float], line: Sequence[float], width: float) -> bool:
    """Whether a point is no farther than ``width`` from a line between two places."""
    x, y, a, b = point[0] - line[0], point[1] - line[1], line[2] - line[0], line[3] - line[1]
    along = min(1.0, max(0.0, (x * a + y * b) / (a * a + b * b)))
    return (x - along * a) ** 2 + (y - along * b) ** 2 <= width**2


def _chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
