"""The stop tables as a PDF for the safety file."""

from __future__ import annotations

from collections.abc import Sequence

from stopset.artifact import Model
from stopset.offline.report.page import DISCLAIMER
from stopset.offline.report.pdf import PICTURE, Document, Plot
from stopset.offline.stops.measured import Measured
from stopset.offline.stops.separation import Separation
from stopset.offline.stops.shown import (
    NAMES,
    QUANTITIES,
    axis_name,
    extrapolations,
    joints_of,
    lines,
    of_category,
    poses,
    seen,
    terms,
    up,
    worst,
)  # fmt: skip
from stopset.offline.stops.table import StopRow, holding


def build_pdf(
    model: Model,
    rows: Sequence[StopRow],
    assumptions: Sequence[str],
    measured: Sequence[Measured],
    separations: Sequence[Separation],
) -> bytes:
    """The PDF file: what the page says, on paper."""
    doc = Document(
        f"Stops of {model.robot.name}", "Monitoring aid, not a safety function. Bounds hold for the stated assumptions only."
    )
    doc.heading(f"Stops of {model.robot.name}", 16.0)
    doc.text(f"Model {model.sha256[:16] or 'unsaved'}. {model.guarantee.text}")
    doc.text(DISCLAIMER)
    beyond = extrapolations(rows)
    if beyond:
        doc.text(beyond)
    doc.heading("Worst stops")
    head = ("category", "axis", "time s", "angle rad", "TCP m", "proved")
    doc.table(head, list(worst(rows)), (2, 3, 1.2, 1.2, 1.2, 1.5))
    doc.text("Upper bounds from the stop request to rest, over all rows, rounded up. No number where a row is not proved.")
    for sentence in holding(model, rows):
        doc.text(sentence[0].upper() + sentence[1:] + ".")
    for standard, columns, table in terms(separations):
        doc.heading(f"Separation distance, {standard}")
        doc.table(columns, table, (0.8, *(1.5 for _ in columns[1:-2]), 0.8, 5))
    for category in dict.fromkeys(r.category for r in rows):
        drawn = [j for j in joints_of(rows, category) if lines(rows, category, j, "time_s")]
        if drawn:
            doc.heading(NAMES[category], keep=PICTURE)
        for joint in drawn:
            doc.plots([
                Plot(f"{axis_name(joint)}, full extension", lines(rows, category, joint, quantity),
                     seen(measured, model, category, joint, quantity), "speed [rad/s]", title)
                for quantity, title in QUANTITIES
            ])  # fmt: skip
    if measured:
        doc.text("Crosses are measured stops, of any pose and payload.")
    doc.heading("What the numbers rest on")
    for a in assumptions:
        doc.text(a)
    for category in dict.fromkeys(r.category for r in rows):
        doc.heading(f"Every row of {NAMES[category]}", keep=60.0)
        doc.table(
            ("axis", "speed %", "kg", "ext. %", "time s", "angle rad", "TCP m", "remark"),
            [_cells(r) for r in of_category(rows, category)], (2.4, 1, 0.8, 0.8, 1.1, 1.3, 1.1, 6),
        )  # fmt: skip
    columns, table = poses(rows, model)
    if table:
        doc.heading("Test poses")
        doc.table(columns, table, (1.6, 0.6, 0.7, *(1.4 for _ in model.joints)), 6.0)
    return doc.bytes()


def _cells(r: StopRow) -> list[str]:
    numbers = ["-" if v is None else up(v, 4) for v in (r.time_s, r.angle_rad, r.tcp_m)]
    return [axis_name(r.joint), f"{r.speed_percent:.0f}", f"{r.payload:.3g}", f"{r.extension_percent:.0f}", *numbers, r.why]
