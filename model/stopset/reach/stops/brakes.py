"""The brakes of a model as stops count with them."""

from __future__ import annotations

import numpy as np

from stopset.artifact import Brakes, Model
from stopset.sets import Box

BRAKE_TOLERANCE = 0.30  # relative half-width of a data sheet's brake torque where it states none


def brakes_of(model: Model) -> Brakes | None:
    """The model's brakes, else the data sheet's with its tolerance; None if a torque or a delay is not known at all."""
    if model.brakes is not None:
        return model.brakes
    drives = model.robot.drives
    torque = np.array([d.brake_torque for d in drives])
    delay = np.array([d.brake_delay for d in drives])
    rise = np.array([d.brake_rise for d in drives])
    if not (np.all(np.isfinite(torque)) and np.all(np.isfinite(delay)) and np.all(np.isfinite(rise))):
        return None
    tolerance = np.array([d.brake_tolerance for d in drives])
    tolerance = np.where(np.isfinite(tolerance), tolerance, BRAKE_TOLERANCE)
    return Brakes(
        torque=Box.of(torque * (1 - tolerance), torque * (1 + tolerance)),
        delay=Box.of(delay[:, 0], delay[:, 1]),
        rise=Box.of(rise[:, 0], rise[:, 1]),
        source="data sheet",
    )
