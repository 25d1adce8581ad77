"""One arm of a fleet: its folder, and what one worker finds out about it. Nothing here knows of a cluster."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stopset.artifact.store import model_of, model_text
from stopset.errors import StopsetError
from stopset.offline.description import load_robot
from stopset.offline.diagnose import diagnose_model
from stopset.offline.identify.pipeline import Settings, identify
from stopset.recording import read_recordings

URDF, LATER, DATA = "robot.urdf", "later", (".parquet", ".csv")


@dataclass(frozen=True, slots=True)
class ArmFolder:
    """Where an arm's files are: ``robot``, recordings to identify from, and ``later`` ones that the model is held against."""

    name: str
    robot: str
    data: tuple[str, ...]
    later: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class ArmAnswer:
    """What was found of one arm; ``error``: the sentence of why not, empty if all went well."""

    name: str
    model: str = ""  # text of the model file
    torque_width: float = 0.0  # sum of the widths of U [N m]
    diagnosis: dict[str, Any] | None = None
    error: str = ""

    @property
    def says(self) -> str:
        """In a few words."""
        if self.error or self.diagnosis is None:
            return f"not done: {self.error}"
        named = ", ".join(f"{r['effect']}{':' + r['joint'] if r['joint'] else ''}" for r in self.diagnosis["ranked_effects"][:3])
        return f"{self.diagnosis['verdict']}{': ' + named if named else ''}"


def _recordings(folder: Path) -> tuple[str, ...]:
    return tuple(str(p) for p in sorted(folder.glob("*")) if p.suffix in DATA) if folder.is_dir() else ()


def find_arms(folder: Path) -> list[ArmFolder]:
    """One arm per subfolder that holds a ``robot.urdf`` and recordings. Raises `StopsetError` where there is none."""
    if not folder.is_dir():
        raise StopsetError(f"{folder} is no folder; expected one with a subfolder per arm: name it")
    found = []
    for sub in sorted(p for p in folder.iterdir() if (p / URDF).is_file()):
        data = _recordings(sub)
        if not data:
            raise StopsetError(
                f"{sub} has a {URDF} and no recording; expected Parquet or CSV beside it: add some, or move it away"
            )
        found.append(ArmFolder(sub.name, str(sub / URDF), data, _recordings(sub / LATER)))
    if not found:
        raise StopsetError(f"{folder} holds no arm; expected subfolders with {URDF} and recordings: make one per arm")
    return found


def examined(arm: ArmFolder) -> ArmAnswer:
    """Identify one arm as ``stopset identify`` does, and diagnose it as ``stopset diagnose`` does on its later recordings,
    or on its own where there are none. A sentence for bad input is part of the answer: one arm does not stop the others."""
    return _answer_or_fault(arm.name, lambda: _examined(arm))


def _examined(arm: ArmFolder) -> ArmAnswer:
    found = identify(load_robot(arm.robot), list(arm.data), Settings(ladder=True))
    text = model_text(found.model)
    model = model_of(text.encode(), arm.robot)
    diagnosis, _ = diagnose_model(model, read_recordings(list(arm.later or arm.data), model.robot))
    return ArmAnswer(arm.name, text, float(model.powered.U.width.sum()), diagnosis.as_json())


def _answer_or_fault(name: str, work: Callable[[], ArmAnswer]) -> ArmAnswer:
    try:
        return work()
    except StopsetError as e:
        return ArmAnswer(name, error=" ".join(str(e).split()))
    except Exception as e:  # noqa: BLE001 - a defect at one arm is told as one, and the other ninety-nine are done
        return ArmAnswer(
            name, error=f"failed inside ({type(e).__name__} {e}); this is a defect of stopset, not this arm's fault: report it"
        )
