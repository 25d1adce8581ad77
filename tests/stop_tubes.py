"""The tube of one stop by itself, as tight as one gets."""

from __future__ import annotations

from stopset.reach.stops.parts import ALL_PARTS, Parts
from stopset.reach.stops.setting import Setting
from stopset.reach.stops.start import Start
from stopset.reach.stops.tube import Tube
from stopset.reach.stops.tubes import KNOTS, Knots, march_box
from stopset.types import Array


def tube_of(
    setting: Setting, q: Array, dq: Array, q_radius: Array, dq_radius: Array, parts: Parts = ALL_PARTS, knots: Knots = KNOTS,
) -> Tube:  # fmt: skip
    """The STOP 0 tube from a box, as tight as one tube gets; it may not come to rest."""
    return march_box(setting, setting.plant, Start(q, dq, q_radius, dq_radius), parts, energetic=False, knots=knots)
