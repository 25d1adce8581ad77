"""Model files of older versions, which hold a robot's description and not the arm: it is read here once more."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from stopset.artifact import Model, store
from stopset.robot.arm import Arm


def load_model(path: str | Path) -> Model:
    """Read a model file of this version or an older one. Raises `ModelFileError` with one sentence."""
    return store.load_model(path, _read)


def _read(urdf: str, sheet: Mapping[str, Any]) -> Arm:
    from stopset.offline.description.read import described  # pinocchio is for older files only

    return described(urdf, sheet, "the model's URDF", None)
