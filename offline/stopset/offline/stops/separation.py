"""Separation distance: every term on the table, none of them assumed for the user.

ISO/TS 15066:2016, 5.5.4:  S = S_h + S_r + S_s + C + Z_d + Z_r,  S_h = v_h (T_r + T_s),  S_r = v_r T_r.
ISO 13855:2010:            S = K T + C,  T = t1 + t2.
ISO 13855:2024:            S = K T + D_DS + Z,  T the overall response time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from stopset.errors import NotCovered

ASKED = {
    "v_h": "speed of the person towards the robot, v_h [m/s] (1.6 if it is not measured)",
    "T_r": "reaction time from the person's detection to the stop request at the drives, T_r [s]",
    "C": "intrusion distance of the protective device, C [m]",
    "Z_d": "position uncertainty of the person, Z_d [m]",
    "Z_r": "position uncertainty of the robot, Z_r [m]",
    "D_DS": "reach over, through or round the protective device, D_DS [m]",
    "Z": "supplemental distance, Z [m]",
}


@dataclass(frozen=True, slots=True)
class Separation:
    """A distance [m] and the terms it is the sum of: (symbol, value, unit, what it is); ``category``: of the stop;
    ``extrapolated``: whether its stops are bounded beyond what recordings have seen."""

    standard: str
    distance: float
    terms: tuple[tuple[str, float, str, str], ...]
    category: str = ""
    extrapolated: bool = False


def _complete(given: Mapping[str, float | None], needed: tuple[str, ...]) -> dict[str, float]:
    missing = [ASKED[k] for k in needed if given.get(k) is None]
    if missing:
        raise NotCovered(f"a separation distance needs every term; missing: {'; '.join(missing)}: give them")
    values = {k: float(given[k]) for k in needed}  # type: ignore[arg-type]
    bad = [k for k, v in values.items() if not 0.0 <= v < float("inf")]
    if bad:
        raise NotCovered(f"{bad[0]} = {values[bad[0]]}; expected a finite number of at least 0 in SI units")
    return values


def protective_separation(
    stop_time: float, stop_distance: float, robot_speed: float, given: Mapping[str, float | None]
) -> Separation:
    """ISO/TS 15066 from our bounds (``stop_time`` T_s [s], ``stop_distance`` S_s [m], ``robot_speed`` v_r [m/s]) and the user's
    terms. Raises `NotCovered` naming every term that was not given."""
    g = _complete(given, ("v_h", "T_r", "C", "Z_d", "Z_r"))
    S_h, S_r = g["v_h"] * (g["T_r"] + stop_time), robot_speed * g["T_r"]
    terms = (
        ("v_h", g["v_h"], "m/s", "speed of the person, given"),
        ("T_r", g["T_r"], "s", "reaction time, given"),
        ("T_s", stop_time, "s", "stopping time, bound"),
        ("v_r", robot_speed, "m/s", "largest speed of tool or link ends during the stop, bound"),
        ("S_h", S_h, "m", "v_h (T_r + T_s)"),
        ("S_r", S_r, "m", "v_r T_r"),
        ("S_s", stop_distance, "m", "stopping distance of tool or link ends, bound"),
        ("C", g["C"], "m", "intrusion distance, given"),
        ("Z_d", g["Z_d"], "m", "position uncertainty of the person, given"),
        ("Z_r", g["Z_r"], "m", "position uncertainty of the robot, given"),
    )
    return Separation("ISO/TS 15066:2016, 5.5.4", S_h + S_r + stop_distance + g["C"] + g["Z_d"] + g["Z_r"], terms)


def approach_distance(stop_time: float, given: Mapping[str, float | None]) -> Separation:
    """ISO 13855:2010, S = K T + C, with K = v_h, t1 = T_r given and t2 our bound. Raises `NotCovered` as above."""
    g = _complete(given, ("v_h", "T_r", "C"))
    total = g["T_r"] + stop_time
    terms = (
        ("K", g["v_h"], "m/s", "approach speed, given"),
        ("t1", g["T_r"], "s", "response time of the protective device and controls, given"),
        ("t2", stop_time, "s", "stopping time of the robot, bound"),
        ("C", g["C"], "m", "intrusion distance, given"),
    )
    return Separation("ISO 13855:2010", g["v_h"] * total + g["C"], terms)


def approach_distance_2024(stop_time: float, given: Mapping[str, float | None]) -> Separation:
    """ISO 13855:2024, S = K T + D_DS + Z, with K = v_h and T = T_r given + our stopping time. Raises `NotCovered` as above."""
    g = _complete(given, ("v_h", "T_r", "D_DS", "Z"))
    terms = (
        ("K", g["v_h"], "m/s", "approach speed, given"),
        ("T_r", g["T_r"], "s", "response time of the protective device and controls, given"),
        ("T_s", stop_time, "s", "stopping time of the robot, bound"),
        ("D_DS", g["D_DS"], "m", "distance of the protective device, given"),
        ("Z", g["Z"], "m", "supplemental distance, given"),
    )
    return Separation("ISO 13855:2024", g["v_h"] * (g["T_r"] + stop_time) + g["D_DS"] + g["Z"], terms)
