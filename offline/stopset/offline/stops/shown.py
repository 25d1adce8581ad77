"""What the page and the PDF of stop tables show, drawn from the rows: curves, worst stops, terms, test poses."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from stopset.artifact import Model
from stopset.offline.stops.directions import NOT_COVERED
from stopset.offline.stops.measured import Measured
from stopset.offline.stops.separation import Separation
from stopset.offline.stops.table import StopRow
from stopset.reach.stops import Category

NAMES: dict[Category, str] = {
    "0": "STOP 0: power off, brakes close",
    "1": "STOP 1, nominal: the ramp works, then power off",
    "1 guaranteed": "STOP 1, guaranteed: the ramp fails, then power off",
    "2": "STOP 2: the ramp works, power stays on",
}
QUANTITIES = (("time_s", "time [s]"), ("angle_rad", "angle [rad]"))
Curve = tuple[str, list[float], list[float]]


def axis_name(joint: str) -> str:
    """The axis, or how many at once."""
    count = joint.count("+") + 1
    return joint if count == 1 else f"{count} axes at once"


def lines(rows: Sequence[StopRow], category: Category, joint: str, what: str) -> list[Curve]:
    """One line per payload over speed, at the largest extension."""
    mine = [r for r in rows if r.category == category and r.joint == joint]
    far = max((r.extension_percent for r in mine), default=0.0)
    out = []
    for kg in sorted({r.payload for r in mine}):
        points = sorted(
            (abs(r.speed), getattr(r, what)) for r in mine
            if r.payload == kg and r.extension_percent == far and getattr(r, what) is not None
        )  # fmt: skip
        if points:
            out.append((f"{kg:.3g} kg", [p[0] for p in points], [p[1] for p in points]))
    return out


def over_speed(rows: Sequence[StopRow], category: Category, what: str) -> list[Curve]:
    """One line per payload over the speed [%]: the worst axis at the largest extension, up to where all axes have a number."""
    mine = [r for r in rows if r.category == category]
    out = []
    for kg in sorted({r.payload for r in mine}):
        points: list[tuple[float, float]] = []
        for speed in sorted({r.speed_percent for r in mine}):
            values = [getattr(r, what) for r in mine if r.payload == kg and r.speed_percent == speed]
            if not values or any(v is None for v in values):
                break
            points.append((speed, max(values)))
        if points:
            out.append((f"{kg:.3g} kg", [p[0] for p in points], [p[1] for p in points]))
    return out


def answered(rows: Sequence[StopRow]) -> str:
    """How many stops are proved, and the longest of them; nothing shorter than a row without a number is called the longest."""
    proved, beyond = sum(r.certified for r in rows), extrapolations(rows)
    rest = "" if proved == len(rows) else f"; {beyond}" if beyond else "; the others show no number, but the reason"
    groups = [[r for r in rows if r.category == category] for category in dict.fromkeys(r.category for r in rows)]
    whole = [mine for mine in groups if all(r.certified and r.tcp_m is not None and r.time_s is not None for r in mine)]
    longest = "; ".join(
        f"STOP {mine[0].category} within {up(max(r.time_s or 0.0 for r in mine), 3)} s and {up(max(r.tcp_m or 0.0 for r in mine), 3)} m of the flange"
        for mine in whole
    )
    said = [f"{proved} of {len(rows)} stops proved for the assumptions below{rest}."]
    said += [f"At rest after a {longest}."] if longest else []
    if any(NOT_COVERED in r.why for mine in whole for r in mine):
        said.append("Directions in which no recording is as fast are not covered.")
    return " ".join(said)


def refusals(rows: Sequence[StopRow]) -> dict[str, int]:
    """Every remark of the rows once, numbered in the order of the rows."""
    said = dict.fromkeys(part for r in rows for part in remarks(r))
    return {part: k for k, part in enumerate(said, 1)}


def remarks(row: StopRow) -> list[str]:
    """What a row says of itself, one thing at a time."""
    return [part for part in row.why.split("; ") if part]


def seen(
    measured: Sequence[Measured], model: Model, category: Category, joint: str, what: str
) -> tuple[list[float], list[float]]:
    """Measured stops of that axis and category."""
    mine = [m for m in measured if m.category == category and model.joints[m.joint] == joint]
    return [abs(m.speed) for m in mine], [m.time if what == "time_s" else abs(m.angle) for m in mine]


def joints_of(rows: Sequence[StopRow], category: Category) -> list[str]:
    """The axes of a category, single ones first."""
    return sorted(dict.fromkeys(r.joint for r in rows if r.category == category), key=lambda j: ("+" in j, j))


def of_category(rows: Sequence[StopRow], category: Category) -> list[StopRow]:
    """A category's rows, axis by axis."""
    axes = joints_of(rows, category)
    return sorted((r for r in rows if r.category == category), key=lambda r: axes.index(r.joint))


def worst(rows: Sequence[StopRow]) -> Iterator[tuple[str, ...]]:
    """Per category and axis: the longest time, angle and TCP way of all rows, and how many are proved or extrapolated."""
    for category in dict.fromkeys(r.category for r in rows):
        every = [r for r in rows if r.category == category]
        if not any(r.answered for r in every):
            yield category, "all axes", "-", "-", "-", f"0 of {len(every)}"
            continue
        for joint in joints_of(rows, category):
            mine = [r for r in rows if r.category == category and r.joint == joint]
            good = [r for r in mine if r.answered]
            beyond = sum(bool(r.extrapolated) for r in mine)
            proved = f"{sum(r.certified for r in mine)} of {len(mine)}"
            if len(good) == len(mine):
                numbers = [up(max(x), d) for x, d in (
                    ([r.time_s or 0.0 for r in good], 3), ([r.angle_rad or 0.0 for r in good], 3), ([r.tcp_m or 0.0 for r in good], 3)
                )]  # fmt: skip
            else:
                numbers = ["-", "-", "-"]
            yield category, axis_name(joint), *numbers, f"{proved}, {beyond} EXTRAPOLATED" if beyond else proved


def extrapolations(rows: Sequence[StopRow]) -> str:
    """One sentence where rows have numbers beyond what recordings have seen, else empty."""
    said = list(dict.fromkeys(r.extrapolated.split(":")[0].split(",")[0] for r in rows if r.extrapolated))
    count = sum(bool(r.extrapolated) for r in rows)
    return (
        f"{' and '.join(said)}: {count} of {len(rows)} rows have numbers that no recording supports; not certified"
        if said
        else ""
    )


def up(x: float, digits: int) -> str:
    """A bound, printed rounded up."""
    return f"{np.ceil(x * 10**digits - 1e-9) / 10**digits:.{digits}f}"


def terms(separations: Sequence[Separation]) -> Iterator[tuple[str, tuple[str, ...], list[tuple[str, ...]]]]:
    """For each standard: its name, the head and the rows of a table of terms with one column per category."""
    for standard in dict.fromkeys(s.standard for s in separations):
        mine = [s for s in separations if s.standard == standard]
        rows: list[tuple[str, ...]] = []
        for k, (symbol, _, unit, what) in enumerate(mine[0].terms):
            rows.append((symbol, *(up(s.terms[k][1], 4) for s in mine), unit, what))
        rows.append(("S", *(up(s.distance, 3) for s in mine), "m", "separation distance, rounded up"))
        heads = (f"STOP {s.category}{' EXTRAPOLATED' if s.extrapolated else ''}" for s in mine)
        yield standard, ("term", *heads, "unit", "what"), rows


def poses(rows: Sequence[StopRow], model: Model) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Head and rows of the test poses, one for each axis, payload and extension."""
    known = {}
    for r in rows:
        if r.pose:
            known[r.joint, r.payload, r.extension_percent] = r.pose
    table = [
        (axis_name(j), f"{kg:.3g}", f"{e:.0f}", *(f"{x:.3f}" for x in pose)) for (j, kg, e), pose in sorted(known.items())
    ]  # fmt: skip
    return ("axis", "kg", "ext. %", *(f"{j} [rad]" for j in model.joints)), table
