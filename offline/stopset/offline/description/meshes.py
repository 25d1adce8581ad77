"""Where a description's mesh files are on this machine."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path


def with_mesh_paths(root: ET.Element, folder: Path | None) -> tuple[str, dict[str, str]]:
    """The URDF's text with each collision mesh by its path here; links whose mesh is not here are left without, by name.

    ``folder``: of the URDF file.  ``package://NAME/...`` is looked for in the folders above it and in what ``ROS_PACKAGE_PATH`` and
    ``AMENT_PREFIX_PATH`` name; a path without a scheme is relative to the URDF.
    """
    lacking: dict[str, str] = {}
    for link in root.findall("link"):
        for picture in link.findall("visual"):
            link.remove(picture)
        meshes = [(c, m) for c in link.findall("collision") if (m := c.find("geometry/mesh")) is not None]
        for _, mesh in meshes:
            name = mesh.get("filename", "")
            found = next((p for p in _places(name, folder) if p.is_file()), None)
            if found is None:
                lacking[str(link.get("name"))] = name
            else:
                mesh.set("filename", str(found.resolve()))
        if link.get("name") in lacking:
            for collision in link.findall("collision"):
                link.remove(collision)
    return ET.tostring(root, encoding="unicode"), lacking


def _places(name: str, folder: Path | None) -> Iterator[Path]:
    scheme, _, rest = name.rpartition("://")
    above = [] if folder is None else [folder, *folder.resolve().parents]
    if scheme in ("package", "model"):
        listed = [Path(p) for p in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if p]
        listed += [Path(p) / "share" for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
        package, _, inside = rest.partition("/")
        for place in (*above, *listed):
            yield place / rest
            if place.name == package:
                yield place / inside
    elif scheme == "file" or rest.startswith("/"):
        yield Path(rest)
    elif not scheme and folder is not None:
        yield folder / rest
