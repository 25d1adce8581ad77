"""The drive data sheet (``robot.json``): what each joint's motor, gear and brake are said to be, and where gravity points."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stopset.errors import RobotError
from stopset.types import Array

STANDARD_GRAVITY = 9.81  # [m/s^2] as in most URDF tools; the data sheet's "gravity" overrides it
ON_EARTH = (9.5, 10.1)  # [m/s^2], rounded numbers too; else none, of an arm that is balanced or floats
LATEST = 2.0  # [s] no brake begins or rises later: it was stated in milliseconds
STRONGEST = 20.0  # times its drive's torque limit: no brake holds more, it was stated in N mm


@dataclass(frozen=True, slots=True)
class Drive:
    """What a drive's data sheet says of one joint; ``nan`` where it says nothing. All link side, SI."""

    gear_ratio: float = float("nan")
    rotor_inertia: float = float("nan")  # k_r^2 I_m [kg m^2], reflected to the link side
    torque_limit: float = float("nan")  # [N m]
    brake_torque: float = float("nan")  # nominal dynamic torque [N m]
    brake_delay: tuple[float, float] = (float("nan"), float("nan"))  # current off -> torque starts to rise [s]
    brake_rise: tuple[float, float] = (float("nan"), float("nan"))  # torque rise [s]
    brake_tolerance: float = float("nan")  # relative half-width of the torque interval


_KNOWN = {
    "gear_ratio", "motor_inertia_kgm2", "reflected_motor_inertia_kgm2", "torque_limit_Nm", "brake_torque_nominal_Nm",
    "brake_delay_s", "brake_rise_s", "brake_tolerance", "source",
}  # fmt: skip


def drives_of(joints: Sequence[str], sheet: Mapping[str, Any]) -> tuple[tuple[Drive, ...], tuple[str, ...]]:
    """The drives of ``joints``, and what of the sheet was not understood. Raises `RobotError`."""
    notes: list[str] = []
    return tuple(_drive(joint, sheet, notes) for joint in joints), tuple(notes)


def gravity_of(sheet: Mapping[str, Any], source: str) -> Array:
    """(3,) [m/s^2] in the base frame. Raises `RobotError`."""
    try:
        gravity = np.array(sheet.get("gravity", [0.0, 0.0, -STANDARD_GRAVITY]), float)
    except (TypeError, ValueError):
        gravity = np.array([])
    size = float(np.linalg.norm(gravity))
    if gravity.shape != (3,) or not (size == 0.0 or ON_EARTH[0] <= size <= ON_EARTH[1]):
        raise RobotError(
            f"robot.json of {source}: gravity is {sheet['gravity']}; expected three numbers [m/s^2], {ON_EARTH[0]:g} to {ON_EARTH[1]:g} "
            "together, or three zeros where nothing weighs on the arm: give it in the base frame"
        )
    return gravity


def _drive(joint: str, sheet: Mapping[str, Any], notes: list[str]) -> Drive:
    rows = sheet.get("joints", {})
    if not isinstance(rows, Mapping):
        raise RobotError(f"robot.json: joints is {rows!r}; expected an object with an entry for each joint by its name")
    row = rows.get(joint, {})
    if not isinstance(row, Mapping):
        raise RobotError(f"robot.json: the entry of joint {joint} is {row!r}; expected an object")
    unknown = set(row) - _KNOWN
    if unknown:
        notes.append(f"robot.json: {joint}: {', '.join(sorted(unknown))} ignored")

    def number(key: str) -> float:
        value = row.get(key, float("nan"))
        if isinstance(value, bool) or not isinstance(value, (int, float)) or value < 0:
            raise RobotError(f"robot.json: {joint}.{key} is {value!r}; expected a non-negative number")
        return float(value)

    def interval(key: str) -> tuple[float, float]:
        value = row.get(key)
        if value is None:
            return (float("nan"), float("nan"))
        numbers = isinstance(value, list) and len(value) == 2 and not any(isinstance(x, (bool, str)) or x is None for x in value)
        if not (numbers and 0 <= value[0] <= value[1] <= LATEST):
            raise RobotError(f"robot.json: {joint}.{key} is {value!r}; expected [lo, hi] in seconds, at most {LATEST:g}")
        return (float(value[0]), float(value[1]))

    gear = number("gear_ratio")
    reflected = number("motor_inertia_kgm2") * gear**2
    if not np.isfinite(reflected):
        reflected = number("reflected_motor_inertia_kgm2")
    limit, brake, tolerance = number("torque_limit_Nm"), number("brake_torque_nominal_Nm"), number("brake_tolerance")
    if brake > STRONGEST * limit > 0.0:
        raise RobotError(
            f"robot.json: {joint}.brake_torque_nominal_Nm is {brake:g} where torque_limit_Nm is {limit:g}; expected at most {STRONGEST:g} "
            "times as much: give both in N m on the link's side of the gear"
        )
    if tolerance >= 1.0:
        raise RobotError(
            f"robot.json: {joint}.brake_tolerance is {tolerance:g}; expected a share below 1: 0.3 where the torque is known within 30 %"
        )
    return Drive(
        gear_ratio=gear, rotor_inertia=reflected, torque_limit=limit, brake_torque=brake, brake_delay=interval("brake_delay_s"),
        brake_rise=interval("brake_rise_s"), brake_tolerance=tolerance,
    )  # fmt: skip
