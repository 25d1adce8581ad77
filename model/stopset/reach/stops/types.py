"""What a stop bound says."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from stopset.notebook import shown
from stopset.reach.stops.directed import PointSets
from stopset.types import Array

Category = Literal["0", "1", "1 guaranteed", "2"]
LAYERS = ("tube", "pieces", "energy", "ramp")  # one tube; several; one with the help of the kinetic energy; a ramp
CATEGORIES: tuple[Category, ...] = ("0", "1", "1 guaranteed", "2")


@dataclass(frozen=True, slots=True)
class StopBound:
    """Upper bounds of one stop, from the stop request to rest, all joints at once; None where nothing can be proved.

    Rest means for good: with the power off speed zero and the brakes holding, with a controlled stop every joint slower than its
    standstill speed (an assumption says which).

    ``time``: (n,) [s] until joint i rests for good; ``forward``, ``back``: (n,) [rad] largest displacement in + and -
    direction, both >= 0; ``speed``: (n,) [rad/s] largest speed on the way; ``tcp``: [m] largest displacement of the tool
    centre point; ``tcp_speed`` [m/s]; ``tcp_box``: (3, 2) [m] its displacement in base coordinates; ``links``: (n,) [m]
    displacement and ``link_speed`` (n,) [m/s] speed of each link's outer end; ``holding_margin``: (n,) [N m] brake and friction torque left over when
    holding, negative or nan where the arm is not held; ``certified``: whether the numbers are proved for the stated
    assumptions; ``why``: one sentence, always filled when not certified, and where the kinetic energy was needed;
    ``fallback``: STOP 2: what a STOP 0 adds if the standstill window is left, (rad, s), None where that is not proved;
    ``extrapolated``: where filled, the numbers hold for a state or payload that identification has not seen, as it says, and the
    bound is not certified; ``layer``: what proved it, see `LAYERS`; ``motion``: where to and how fast in a direction;
    ``end_stops``: joints that the bound leads to the end of their range: the numbers hold until one strikes there, not after;
    ``capsules``: (P, n, 7) [m] what each link sweeps (its axis, where its shape is not known), see `stopset.reach.stops.cartesian.swept_capsules`.
    """

    category: Category
    certified: bool
    why: str
    time: Array | None = None
    forward: Array | None = None
    back: Array | None = None
    speed: Array | None = None
    tcp: float | None = None
    tcp_speed: float | None = None
    tcp_box: Array | None = None
    links: Array | None = None
    link_speed: Array | None = None
    holding_margin: Array | None = None
    assumptions: tuple[str, ...] = ()
    layer: str = ""
    fallback: tuple[float, float] | None = None
    motion: PointSets | None = None
    capsules: Array | None = None
    extrapolated: str = ""
    end_stops: tuple[str, ...] = ()
    here: tuple[str, ...] = ()  # those of the assumptions that are about this state alone

    def _repr_html_(self) -> str:
        if self.time is None or self.forward is None or self.back is None:
            return shown(f"STOP {self.category}: no stop provable", self.why)
        rows = [(k + 1, t, f, b) for k, (t, f, b) in enumerate(zip(self.time, self.forward, self.back, strict=True))]
        distance = "not provable" if self.tcp is None else f"{self.tcp:.4g} m"
        said = f"Tool centre point: {distance}. {self.extrapolated or ('Certified for the stated assumptions.' if self.certified else '')} {self.why}"
        head = ("joint", "time [s]", "forward [rad]", "back [rad]")
        return shown(f"STOP {self.category}: upper bounds", " ".join(said.split()), head, rows)

    @property
    def angle(self) -> Array | None:
        """(n,) [rad] the larger of ``forward`` and ``back``."""
        if self.forward is None or self.back is None:
            return None
        return np.maximum(self.forward, self.back)

    def directed_speed(self, direction: ArrayLike) -> float | None:
        """[m/s] how fast the tool centre point can move in a direction of base coordinates during the stop."""
        return None if self.motion is None else self.motion.speed_along(np.asarray(direction, float))

    def directed_distance(self, direction: ArrayLike) -> float | None:
        """[m] how far the tool centre point can get in a direction of base coordinates."""
        return None if self.motion is None else self.motion.distance_along(np.asarray(direction, float))

    def speed_towards(self, place: ArrayLike) -> float | None:
        """[m/s] how fast the tool centre point can come closer to a place (3,) [m] in base coordinates."""
        return None if self.motion is None else self.motion.speed_towards(np.asarray(place, float))
