"""The stop tables as a page with pictures, and as a PDF for the safety file."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stopset.artifact import Model
from stopset.offline.report import COLOURS, DISCLAIMER, Page
from stopset.offline.stops.measured import Measured
from stopset.offline.stops.pdf import Document
from stopset.offline.stops.separation import Separation
from stopset.offline.stops.table import Row
from stopset.reach.stops import Category

HEAD = ("category", "axis", "speed %", "payload kg", "extension %", "time s", "angle rad", "TCP m", "why not")
NAMES: dict[Category, str] = {
    "0": "STOP 0: power off, brakes close",
    "1": "STOP 1, nominal: the ramp works, then power off",
    "1 guaranteed": "STOP 1, guaranteed: the ramp fails, then power off",
    "2": "STOP 2: the ramp works, power stays on",
}


def _cells(r: Row) -> list[object]:
    return [r.category, r.joint, r.speed_percent, r.payload, r.extension_percent, r.time_s, r.angle_rad, r.tcp_m, r.why]


def _lines(rows: Sequence[Row], category: Category, joint: str, what: str) -> list[tuple[str, list[float], list[float]]]:
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
            out.append((f"{kg:g} kg", [p[0] for p in points], [p[1] for p in points]))
    return out


def _seen(
    measured: Sequence[Measured], model: Model, category: Category, joint: str, what: str
) -> tuple[list[float], list[float]]:
    mine = [m for m in measured if m.category == category and model.joints[m.joint] == joint]
    return [abs(m.speed) for m in mine], [m.time if what == "time_s" else abs(m.angle) for m in mine]


def build_page(
    model: Model, rows: Sequence[Row], assumptions: Sequence[str], measured: Sequence[Measured],
    separations: Sequence[Separation],
) -> Page:  # fmt: skip
    """The page: verdict, separation, pictures, measured stops, tables, assumptions."""
    import plotly.graph_objects as go

    page = Page(f"Stops of {model.robot.name}")
    proved = sum(r.certified for r in rows)
    page.verdict(
        f"{proved} of {len(rows)} stops proved for the assumptions below; the others show no number and the reason.",
        "good" if proved == len(rows) else "",
    )
    for s in separations:
        page.heading(f"Separation distance, {s.standard}: {s.distance:.3f} m")
        page.table(("term", "value", "unit", "what"), s.terms)
    for category in dict.fromkeys(r.category for r in rows):
        mine = [r for r in rows if r.category == category]
        page.heading(NAMES[category])
        for joint in dict.fromkeys(r.joint for r in mine):
            for quantity, title in (("time_s", "time [s]"), ("angle_rad", "angle [rad]")):
                curves = _lines(rows, category, joint, quantity)
                x, y = _seen(measured, model, category, joint, quantity)
                if not curves and not x:
                    continue
                figure = go.Figure()
                for k, (name, a, b) in enumerate(curves):
                    figure.add_scatter(x=a, y=b, name=name, mode="lines+markers", line={"color": COLOURS[k % len(COLOURS)]})
                if x:
                    figure.add_scatter(x=x, y=y, name="measured", mode="markers", marker={"color": "#1d2733", "symbol": "x"})
                figure.update_layout(
                    title=f"{joint}: {title} over speed, full extension", xaxis_title="speed [rad/s]", yaxis_title=title,
                    height=320,
                )  # fmt: skip
                page.figure(figure)
        page.table(HEAD, [_cells(r) for r in mine])
    if measured:
        _measured_part(page, measured, model)
    page.heading("What the numbers rest on")
    for sentence in assumptions:
        page.text(sentence)
    return page


def _measured_part(page: Page, measured: Sequence[Measured], model: Model) -> None:
    import plotly.graph_objects as go

    page.heading("Measured stops against their bounds")
    bounded = [m for m in measured if m.bound_angle is not None]
    page.text(
        "Each recorded stop, joint by joint, beside the bound from the state at its trigger; a point above the line would "
        "refute the model. Poses and payloads differ from the tables'."
    )
    figure = go.Figure()
    for j, name in enumerate(model.joints):
        mine = [m for m in bounded if m.joint == j]
        figure.add_scatter(
            x=[m.bound_angle for m in mine], y=[abs(m.angle) for m in mine], mode="markers", name=name,
            text=[m.label for m in mine], marker={"color": COLOURS[j % len(COLOURS)]},
        )  # fmt: skip
    top = max((m.bound_angle or 0.0 for m in bounded), default=1.0)
    figure.add_scatter(x=[0, top], y=[0, top], mode="lines", line={"color": "#8894a0"}, name="bound")
    figure.update_layout(xaxis_title="bound of the angle [rad]", yaxis_title="measured [rad]", height=420)
    page.figure(figure)


def build_pdf(
    model: Model, rows: Sequence[Row], assumptions: Sequence[str], measured: Sequence[Measured], separations: Sequence[Separation]
) -> bytes:
    """The same as a PDF."""
    doc = Document(f"Stops of {model.robot.name}", DISCLAIMER[:150])
    doc.heading(f"Stops of {model.robot.name}", 16.0)
    doc.text(f"Model {model.sha256[:16] or 'unsaved'}. {model.guarantee.text}")
    doc.text(DISCLAIMER)
    for s in separations:
        doc.heading(f"Separation distance, {s.standard}: {s.distance:.3f} m")
        doc.table(("term", "value", "unit", "what"), [[a, f"{b:.4g}", c, d] for a, b, c, d in s.terms], (1, 1, 1, 5))
    for category in dict.fromkeys(r.category for r in rows):
        mine = [r for r in rows if r.category == category]
        doc.heading(NAMES[category])
        for joint in dict.fromkeys(r.joint for r in mine):
            for quantity, title in (("time_s", "time [s]"), ("angle_rad", "angle [rad]")):
                curves, points = _lines(rows, category, joint, quantity), _seen(measured, model, category, joint, quantity)
                if curves:
                    doc.text(f"{joint}: {title} over speed, full extension; crosses are measured")
                    doc.plot(curves, points, "speed [rad/s]", title)
        table = [
            [r.joint, f"{r.speed_percent:.0f}", f"{r.payload:.3g}", f"{r.extension_percent:.0f}",
             *("-" if v is None else f"{np.ceil(v * 1e4) / 1e4:.4f}" for v in (r.time_s, r.angle_rad, r.tcp_m)), r.why]
            for r in mine
        ]  # fmt: skip
        doc.table(
            ("axis", "speed %", "kg", "ext. %", "time s", "angle rad", "TCP m", "why not"), table, (3, 1, 1, 1, 1.2, 1.4, 1.2, 6)
        )
    doc.heading("What the numbers rest on")
    for a in assumptions:
        doc.text(a)
    return doc.bytes()
