"""What the user chooses for an identification."""

from __future__ import annotations

from dataclasses import dataclass, fields

from stopset.artifact import Model
from stopset.errors import ModelFileError

HORIZON = 5.0  # [s] the paper's test suites are "up to 5 seconds long" (sec. V-B)


@dataclass(frozen=True, slots=True)
class Settings:
    """What the user chose; its hash, with the constants of the algorithm (`constants`), goes into the model file (trap P18)."""

    model: int = 1
    order: int | None = None
    effects: tuple[str, ...] = ()
    conform: str = "all"
    windows: str = "sliding"
    margin: float | None = None
    horizon: float = HORIZON
    bands: int = 0  # temperature bands beside the whole; 0: none
    shape: str = "box"  # or "zonotope": of the torque set
    mixed: bool = False  # recordings of several conditions are taken as one
    friction: str = "evidence"  # laws beside Coulomb and viscous are chosen by held-out error; "plain": none but those asked for
    friction_among: tuple[str, ...] | None = None  # laws (``effect:joint``) that the evidence may choose among; None: any
    friction_retained: tuple[str, ...] = ()  # those of them that stay whatever the evidence says
    ladder: bool = False  # the next abstraction is tried where the sets of the linear model say too little


def settings_of(model: Model) -> Settings:
    """The settings a model was identified with. Raises `ModelFileError` for settings that this stopset does not have."""
    stored = dict(model.provenance.get("settings", {}))
    for name in ("effects", "friction_retained"):
        stored[name] = tuple(stored.get(name, ()))
    if stored.get("friction_among") is not None:
        stored["friction_among"] = tuple(stored["friction_among"])
    stored.setdefault("friction", "plain")  # models older than the choice had none
    try:
        return Settings(**stored)
    except TypeError as e:
        unknown = ", ".join(sorted(stored.keys() - {f.name for f in fields(Settings)}))
        raise ModelFileError(
            f"the model was identified with settings that this stopset does not have ({unknown}); expected those of its version: "
            "identify again"
        ) from e
