"""What the user chooses for an identification."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass

from stopset.offline.identify.constants import constants

HORIZON = 5.0  # [s] the paper's test suites are "up to 5 seconds long" (sec. V-B)


@dataclass(frozen=True, slots=True)
class Settings:
    """What the user chose; its hash, with the constants of the algorithm, goes into the model file (trap P18)."""

    model: int = 1
    order: int | None = None
    effects: tuple[str, ...] = ()
    conform: str = "all"
    windows: str = "sliding"
    margin: float | None = None
    horizon: float = HORIZON
    bands: int = 0  # temperature bands beside the whole; 0: none
    shape: str = "box"  # or "zonotope": of the torque set
    friction: str = (
        "evidence"  # laws beside Coulomb and viscous are chosen by held-out error; or "plain": none but those asked for
    )

    @property
    def sha256(self) -> str:
        # what was not asked for leaves the hash of earlier models as it was
        later = {"bands": 0, "shape": "box", "friction": "plain"}
        kept = {k: v for k, v in asdict(self).items() if k not in later or v != later[k]} | constants()
        return hashlib.sha256(json.dumps(kept, sort_keys=True).encode()).hexdigest()
