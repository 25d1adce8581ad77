"""Brakes as a data sheet has them, until stops were recorded."""

from __future__ import annotations

import numpy as np

from stopset.artifact import Brakes
from stopset.robot import Robot
from stopset.sets import Box


def assumed_brakes(robot: Robot) -> Brakes | None:
    """Brakes from the data sheet, as an assumption until stops were recorded; None where the sheet gives no torque.

    Delay [5, 100] ms and rise [5, 30] ms cover servo brakes with fast and slow suppression: vendors give up to 100 ms until
    a brake holds; torque +-30 % covers wear, oil and temperature.
    """
    drives = robot.drives
    nominal = np.array([d.brake_torque for d in drives])
    if not np.all(np.isfinite(nominal)):
        return None

    def interval(rows: list[tuple[float, float]], default: tuple[float, float]) -> Box:
        given = [r if np.isfinite(r).all() else default for r in rows]
        return Box.of([r[0] for r in given], [r[1] for r in given])

    tolerance = np.array([d.brake_tolerance if np.isfinite(d.brake_tolerance) else 0.3 for d in drives])
    return Brakes(
        torque=Box(nominal * (1 - tolerance), nominal * (1 + tolerance)),
        delay=interval([d.brake_delay for d in drives], (0.005, 0.1)),
        rise=interval([d.brake_rise for d in drives], (0.005, 0.03)),
        source="data sheet and assumed tolerances",
    )
