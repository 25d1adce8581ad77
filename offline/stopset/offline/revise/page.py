"""The waterfall of revisions as a page: what each added effect took off each error, down to the repeatability floor."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from stopset.artifact import Model
from stopset.offline.report.page import COLOURS, Page
from stopset.offline.revise.judge import Judged
from stopset.offline.revise.revise import Revised

FIGURES = (
    ("held_out_torque_rmse", "torque error on held-out data [N m]"),
    ("held_out_position_rmse", "open-loop position error on held-out data [rad]"),
    ("sum_U_width", "sum of U widths [N m]"),
    ("sum_U_width_without_margin", "sum of U widths without margin [N m]"),
    ("stop0_angle", "STOP 0 angle bound at full speed [rad]"),
)


def page(model: Model) -> Page:
    """The report of ``stopset history``."""
    out = Page(f"{model.robot.name}: history of the model")
    _history(out, model)
    return out


def tried(model: Model, done: Revised) -> Page:
    """The report of ``stopset add``: what was tried on held-out data, then the history of ``model``."""
    out = Page(f"{model.robot.name}: {', '.join(j.name for j in done.judged)} tried")
    for j in done.judged:
        out.verdict(f"{j.name} {_outcome(j)}.", "bad" if j.why else "good")
    out.text(f"Judged on {done.judged_on}.")
    rows = [
        (j.name, title, j.before[key], j.after[key])
        for j in done.judged
        for key, title in FIGURES
        if key in j.before and key in j.after
    ]
    out.table(("effect", "figure", "before", "after"), rows)
    _history(out, model)
    return out


def _outcome(j: Judged) -> str:
    if j.why:
        return f"is refused: {j.why}"
    return f"is added ({j.enters})" + ("" if j.helps else ", though it does not lower the error on held-out data")


def _history(out: Page, model: Model) -> None:
    """Waterfalls and the table of revisions."""
    floor = [row.get("torque_rmse_floor") for row in model.errors.values()]
    level = float(np.sqrt(np.mean([f**2 for f in floor]))) if floor and all(f is not None for f in floor) else None
    for key, title in FIGURES:
        names, values = _chain(model, key)
        if len(values) > 1:
            out.heading(title[0].upper() + title[1:])
            out.figure(_waterfall(names, values, level if key == "held_out_torque_rmse" else None))
    out.heading("Revisions")
    keys = [k for k, _ in FIGURES]
    out.table(
        ["revision", "added", *(t for _, t in FIGURES), "note"],
        [[r.number, r.added or "first identification", *(r.after.get(k) for k in keys), r.note] for r in model.revisions],
    )
    out.text(model.guarantee.text)


def _chain(model: Model, key: str) -> tuple[list[str], list[float]]:
    names: list[str] = []
    values: list[float] = []
    for r in model.revisions:
        if not values and key in r.before:
            names.append("before")
            values.append(r.before[key])
        if key in r.after:
            names.append(r.added or "first identification")
            values.append(r.after[key])
    return names, values


def _waterfall(names: list[str], values: list[float], floor: float | None) -> go.Figure:
    steps = np.diff(values).tolist()
    figure = go.Figure(
        go.Waterfall(
            x=[*names, "now"], y=[values[0], *steps, values[-1]], measure=["absolute", *["relative"] * len(steps), "total"],
            text=[f"{v:.3g}" for v in [values[0], *steps, values[-1]]], decreasing={"marker": {"color": COLOURS[2]}},
            increasing={"marker": {"color": COLOURS[1]}}, totals={"marker": {"color": COLOURS[0]}},
        )
    )  # fmt: skip
    if floor is not None:
        figure.add_hline(
            y=floor, line_dash="dot", annotation_text="repeatability floor", annotation_bgcolor="rgba(255,255,255,0.8)",
            annotation_position="bottom right",
        )  # fmt: skip
    figure.update_layout(height=360, showlegend=False)
    return figure
