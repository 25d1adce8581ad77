"""What a stop bound says."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Category = Literal["0", "1", "1 guaranteed", "2"]
CATEGORIES: tuple[Category, ...] = ("0", "1", "1 guaranteed", "2")


@dataclass(frozen=True, slots=True)
class StopBound:
    """Upper bounds of one stop, from the stop request to rest, all joints at once; None where nothing can be proved.

    ``time``: (n,) [s] until joint i rests for good; ``forward``, ``back``: (n,) [rad] largest displacement in + and -
    direction, both >= 0; ``speed``: (n,) [rad/s] largest speed on the way; ``tcp``: [m] largest displacement of the tool
    centre point; ``tcp_speed`` [m/s]; ``tcp_box``: (3, 2) [m] its displacement in base coordinates; ``links``: (n,) [m]
    displacement of each link's outer end; ``holding_margin``: (n,) [N m] brake and friction torque left over when
    holding, negative or nan where the arm is not held; ``certified``: whether the numbers are proved for the stated
    assumptions; ``why``: one sentence, always filled when not certified.
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
    holding_margin: Array | None = None
    assumptions: tuple[str, ...] = ()

    @property
    def angle(self) -> Array | None:
        """(n,) [rad] the larger of ``forward`` and ``back``."""
        if self.forward is None or self.back is None:
            return None
        return np.maximum(self.forward, self.back)
