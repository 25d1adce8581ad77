"""The stop tables as a page with pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from stopset.artifact import Model
from stopset.offline.report.arm import drawn_arm
from stopset.offline.report.page import COLOURS, Page
from stopset.offline.stops.directions import NOT_COVERED
from stopset.offline.stops.measured import Measured
from stopset.offline.stops.separation import Separation
from stopset.offline.stops.shown import (
    NAMES,
    QUANTITIES,
    answered,
    axis_name,
    extrapolations,
    joints_of,
    lines,
    of_category,
    over_speed,
    poses,
    refusals,
    remarks,
    seen,
    terms,
    up,
    worst,
)  # fmt: skip
from stopset.offline.stops.table import StopRow, farthest, holding
from stopset.reach.stops import Category

DASHES = ("solid", "dash", "dot", "dashdot")  # of categories
HEAD = ("axis", "speed %", "payload kg", "extension %", "time s", "angle rad", "TCP m", "remark")


def build_page(
    model: Model, rows: Sequence[StopRow], assumptions: Sequence[str], measured: Sequence[Measured],
    separations: Sequence[Separation],
) -> Page:  # fmt: skip
    """The page: answer, one picture, what to do, worst stops, separation; then pictures, assumptions, every row, folded."""
    page = Page(f"Stops of {model.robot.name}", model)
    number = refusals(rows)
    page.verdict(answered(rows), "good" if all(r.certified for r in rows) else "")
    page.next(_next(rows, number))
    with page.beside():
        _overview(page, rows)
        _worst_pose(page, model, rows)
    page.heading("Worst stops")
    page.table(("category", "axis", "time s", "angle rad", "TCP m", "proved"), list(worst(rows)))
    page.text("Upper bounds from the stop request to rest, over all rows, rounded up. No number where a row is not proved.")
    if number:
        page.heading("What the rows say")
        page.points([f"[{index}] {why}" for why, index in number.items()])
    for sentence in holding(model, rows):
        page.text(sentence[0].upper() + sentence[1:] + ".")
    for standard, head, table in terms(separations):
        page.heading(f"Separation distance, {standard}")
        page.table(head, table)
    if measured:
        _measured_part(page, measured, model)
    page.heading("What the numbers rest on")
    page.points([sentence[0].upper() + sentence[1:] for sentence in assumptions])
    for category in dict.fromkeys(r.category for r in rows):
        _pictures(page, model, rows, measured, category)
        with page.fold(f"{NAMES[category]}: every row"):
            _rows(page, of_category(rows, category), number)
    with page.fold("Test poses"):
        page.table(*poses(rows, model))
    return page


def _next(rows: Sequence[StopRow], number: Mapping[str, int]) -> str:
    if extrapolations(rows):
        return "do not certify from the extrapolated rows; record motions at those speeds and payloads and identify again."
    refused = [r for r in rows if not r.certified]
    if refused:
        why = dict.fromkeys(f"[{number[part]}]" for r in refused for part in remarks(r) if NOT_COVERED not in part)
        return f"{len(refused)} of {len(rows)} rows have no number; {' '.join(why) or 'the remarks'} below say what is missing."
    return "measure stops at these poses (ISO 10218-1, annex B) and hold them against the bounds with `stopset stops --data`."


def _rows(page: Page, rows: Sequence[StopRow], number: Mapping[str, int]) -> None:
    """Every row of a category; a refusal that all of them share, once."""
    if len({r.why for r in rows}) == 1 and not any(r.answered for r in rows):
        page.text(f"None of {len(rows)} rows has a number: {_marks(rows[0], number)}.")
    else:
        page.table(HEAD, [_cells(r, number) for r in rows])


def _cells(r: StopRow, number: Mapping[str, int]) -> list[object]:
    numbers = ["-" if x is None else up(x, 4) for x in (r.time_s, r.angle_rad, r.tcp_m)]
    return [axis_name(r.joint), r.speed_percent, r.payload, r.extension_percent, *numbers, _marks(r, number)]


def _marks(r: StopRow, number: Mapping[str, int]) -> str:
    return " ".join(f"[{number[part]}]" for part in remarks(r))


def _overview(page: Page, rows: Sequence[StopRow]) -> None:
    """Distance and time over speed: one line per payload and category, the worst axis, full extension."""
    from plotly.subplots import make_subplots

    figure = make_subplots(1, 2, subplot_titles=("distance of the flange [m]", "time to rest [s]"))
    drawn = False
    for k, category in enumerate(dict.fromkeys(r.category for r in rows)):
        for m, what in enumerate(("tcp_m", "time_s"), 1):
            for p, (name, speeds, values) in enumerate(over_speed(rows, category, what)):
                line = {"color": COLOURS[p % len(COLOURS)], "dash": DASHES[k % len(DASHES)]}
                figure.add_scatter(
                    x=speeds, y=values, mode="lines+markers", line=line, name=f"STOP {category}, {name}", legendgroup=f"{category} {name}",
                    showlegend=m == 1, row=1, col=m,
                )  # fmt: skip
                drawn = True
    if not drawn:
        return
    figure.update_xaxes(title_text="speed [% of the largest]", rangemode="tozero")
    figure.update_yaxes(rangemode="tozero")
    figure.update_layout(height=400, legend={"orientation": "h", "y": -0.2}, margin={"t": 40})
    page.figure(
        figure,
        f"Upper bounds, the worst of all axes and extensions; a line ends where one has no number.{_beyond(rows)}",
        560,
    )


def _beyond(rows: Sequence[StopRow]) -> str:
    """What stands below a picture of rows with numbers that no recording supports."""
    return f" {beyond}." if (beyond := extrapolations(rows)) else ""


def _worst_pose(page: Page, model: Model, rows: Sequence[StopRow]) -> None:
    """The pose of the longest travel of the flange, and what the links sweep from there."""
    r = farthest(rows)
    if r is None:
        return
    bare = model.robot.arm.bare
    sweeps = "the links" if not bare else f"{'the links' if len(bare) == model.n else ', '.join(bare)}' axes"
    own = "" if not bare else "; their own size comes on top"
    page.picture(
        drawn_arm(model, np.asarray(r.pose), swept=r.swept, within=r.tcp_m or 0.0),
        f"Where the flange goes farthest: STOP {r.category}, {axis_name(r.joint)}, {r.speed_percent:.0f} % speed, {r.payload:.3g} kg, "
        f"within {up(r.tcp_m or 0.0, 3)} m of where it was{' (EXTRAPOLATED)' if r.extrapolated else ''}. Yellow: all that "
        f"{sweeps} can sweep from the stop request to rest{own}.",
    )


def _pictures(page: Page, model: Model, rows: Sequence[StopRow], measured: Sequence[Measured], category: Category) -> None:
    """Time and angle over speed, a row of two pictures for each axis, one line per payload."""
    from plotly.subplots import make_subplots

    joints = [
        j for j in joints_of(rows, category) if lines(rows, category, j, "time_s") or seen(measured, model, category, j, "")[0]
    ]
    if not joints:
        return
    titles = [f"{axis_name(j)}: {title}" for j in joints for _, title in QUANTITIES]
    figure = make_subplots(len(joints), 2, subplot_titles=titles, vertical_spacing=0.25 / len(joints) ** 1.1)
    names: set[str] = set()

    def once(name: str) -> dict[str, object]:
        first = name not in names
        names.add(name)
        return {"name": name, "legendgroup": name, "showlegend": first}

    for row, joint in enumerate(joints, 1):
        for column, (what, title) in enumerate(QUANTITIES, 1):
            for k, (name, a, b) in enumerate(lines(rows, category, joint, what)):
                figure.add_scatter(
                    x=a, y=b, mode="lines+markers", line={"color": COLOURS[k % len(COLOURS)]}, row=row, col=column, **once(name)
                )  # fmt: skip
            x, y = seen(measured, model, category, joint, what)
            if x:
                marker = {"color": "#1d2733", "symbol": "x", "size": 6}
                figure.add_scatter(x=x, y=y, mode="markers", marker=marker, row=row, col=column, **once("measured"))
            below = "speed [rad/s]" if row == len(joints) else None
            figure.update_xaxes(title_text=below, rangemode="tozero", row=row, col=column)
            figure.update_yaxes(title_text=title, rangemode="tozero", row=row, col=column)
    height = 140 + 270 * len(joints)
    legend = {"orientation": "h", "yref": "container", "y": 1.0, "yanchor": "top", "x": 0.0}  # above the pictures' titles
    figure.update_layout(height=height, margin={"t": 70}, legend=legend)
    with page.fold(f"{NAMES[category]}: time and angle of every axis over speed"):
        page.figure(
            figure, "Full extension; crosses are measured stops, of any pose and payload." if measured else "Full extension.", 560
        )


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
