"""The waterfall of revisions as a page: what each added effect took off each error, down to the repeatability floor."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from stopset.artifact import Model, Revision
from stopset.offline.report.guarantee import guarantee
from stopset.offline.report.page import COLOURS, Page
from stopset.offline.revise.revise import Revised

FIGURES = (
    ("held_out_torque_rmse", "torque error on held-out data [N m]"),
    ("held_out_position_rmse", "open-loop position error on held-out data [rad]"),
    ("sum_U_width", "sum of U widths [N m]"),
    ("sum_U_width_without_margin", "sum of U widths without margin [N m]"),
    ("stop0_angle", "STOP 0 angle bound at full speed [rad]"),
)
SAME = 0.02  # of a figure: what differs by less is drawn once
# the scatter between repetitions that is under each figure
FLOORS = {"held_out_torque_rmse": "torque_rmse_floor", "held_out_position_rmse": "position_rmse_floor"}


def page(model: Model) -> Page:
    """The report of ``stopset history``."""
    out = Page(f"{model.robot.name}: history of the model", model)
    done = _last(model)
    out.verdict(*_said(done) if done else ("First identification: nothing was added to this model yet.",))
    if len(model.revisions) < 2:
        out.next(
            "`stopset compare` tells where this model fails, `stopset diagnose` which effect is missing, `stopset add` puts it in."
        )
    _history(out, model)
    return out


def tried(model: Model, done: Revised, data: Sequence[str | Path] = ()) -> Page:
    """The report of ``stopset add``: what became of each effect on held-out data; then the history of ``model``, which has those added."""
    out = Page(f"{model.robot.name}: {', '.join(j.name for j in done.judged)}", model, data)
    for j in done.judged:
        if j.why:
            out.verdict(f"{j.name} is refused: {j.why}.", "bad")
        elif not j.helps:
            out.verdict(f"{j.name} was forced in, though it does not lower the error on held-out data.", "bad")
        elif j.stays:
            out.verdict(f"{j.name}: {j.stays}.")
    revision = _last(model) if done.model is not None else None
    if revision is not None:
        what, tone = _said(revision)
        # of a law that the model has the error before is without it: that it fell is nothing that was done now
        out.verdict(what, tone if any(not j.why and not j.stays for j in done.judged) else "")
        out.next(
            "`stopset compare` on a recording that was not used here tells whether it holds there too, `stopset diagnose` what is still "
            "missing; `stopset stops` has the new bounds."
        )
    _history(out, model)
    with out.fold(f"Judged on {done.judged_on}"):
        rows = [
            (j.name, j.enters, title, j.before[key], j.after[key])
            for j in done.judged
            for key, title in FIGURES
            if key in j.before and key in j.after
        ]
        out.table(("effect", "enters", "figure over the arm", "before", "after"), rows)
    return out


def floors(model: Model) -> dict[str, dict[str, Any]]:
    """What no model gets below, by figure: the scatter of repetitions, of the ``arm`` (RMS over joints) and of its ``joints``.

    A figure without one is left out: repetitions tell nothing of sets and stops, nor of anything where nothing is repeated.
    """
    out = {}
    for figure, key in FLOORS.items():
        joints = {j: row.get(key) for j, row in model.errors.items()}
        known = [f for f in joints.values() if f is not None]
        if known and len(known) == len(joints):
            out[figure] = {"arm": float(np.sqrt(np.mean(np.square(known)))), "joints": joints}
    return out


def _history(out: Page, model: Model) -> None:
    """One picture of what all revisions did to every figure; the table folded."""
    if (figure := waterfalls(model)) is not None:
        out.figure(
            figure,
            "Each figure after each revision, from zero; 'without': the same recordings without what was added then; dotted: what "
            "repetitions of the same torques differ by, below which no model without a new variable gets. Of sets and stops they tell none.",
            950,
        )
    keys = [k for k, _ in FIGURES]
    with out.fold("Every revision"):
        out.table(
            ["revision", "added", *(t for _, t in FIGURES), "note"],
            [[r.number, r.added or "first identification", *(r.after.get(k) for k in keys), r.note] for r in model.revisions],
        )
    guarantee(out, model)


def _last(model: Model) -> Revision | None:
    """The last revision that added something."""
    return next((r for r in reversed(model.revisions) if r.added), None)


def _said(r: Revision) -> tuple[str, str]:
    """What a revision did, in a sentence that names its own joint before the arm; and whether both errors fell."""
    said = []
    for key, title in FIGURES:
        name = title.partition(" [")[0]
        for joint in own_joints(r.added):
            if (share := _change(r, f"{key}:{joint}")) is not None:
                said.append(f"{name} at {joint} {share}")
        if (share := _change(r, key)) is not None:
            said.append(f"{name} over the arm {share}")
    better = all(r.after.get(k, 0.0) <= r.before.get(k, np.inf) for k, _ in FIGURES[:2])
    what = f"Revision {r.number} adds {r.added}: {'; '.join(said[:4]) or 'no figure to compare'}."
    return what, "good" if better else ""


def own_joints(added: str) -> list[str]:
    """The joints of effects ``name[:joint[+joint]]``, as a revision names what it added; none for those of the whole arm."""
    found = [j for name in added.replace(",", " ").split() for j in name.partition(":")[2].split("+") if j]
    return list(dict.fromkeys(found))


def _change(r: Revision, key: str) -> str | None:
    before, after = r.before.get(key), r.after.get(key)
    return None if not before or after is None else f"{after / before - 1:+.0%}"


def _chain(model: Model, key: str) -> tuple[list[str], list[float]]:
    """The bars of a figure: after each revision, and before it where these recordings are others than its predecessor was shown."""
    names: list[str] = []
    values: list[float] = []
    for r in model.revisions:
        if key in r.before and not (values and np.isclose(r.before[key], values[-1], rtol=SAME)):
            names.append("without" if values else "before")
            values.append(r.before[key])
        if key in r.after:
            names.append(r.added or "first identification")
            values.append(r.after[key])
    return names, values


def waterfalls(model: Model) -> go.Figure | None:
    """All figures side by side, one bar per revision; None where nothing was added."""
    chains = ((key, title, *_chain(model, key)) for key, title in FIGURES)
    shown = [(key, title, names, values) for key, title, names, values in chains if len(values) > 1]
    if not shown:
        return None
    lowest = floors(model)
    figure = make_subplots(rows=1, cols=len(shown), subplot_titles=[t.replace(" [", "<br>[") for _, t, _, _ in shown])
    for k, (key, _, names, values) in enumerate(shown, 1):
        colours = [*["#b8c4ce"] * (len(values) - 1), COLOURS[0]]
        bars = go.Bar(
            x=list(range(len(values))), y=values, text=[f"{v:.3g}" for v in values], hovertext=names, marker_color=colours, showlegend=False,
        )  # fmt: skip
        figure.add_trace(bars, row=1, col=k)
        ticks = [n.replace(":", "<br>").replace("first identification", "first") for n in names]
        figure.update_xaxes(tickvals=list(range(len(values))), ticktext=ticks, row=1, col=k)
        if key in lowest:
            figure.add_hline(y=lowest[key]["arm"], line_dash="dot", row=1, col=k)
    figure.update_yaxes(rangemode="tozero")
    figure.update_annotations(font_size=11)
    figure.update_layout(height=360, margin={"t": 70})
    return figure
