"""The diagnosis as a page: verdict, ranking, parameters, what the data cannot tell, what to do next."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from stopset.artifact import Model
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.answer import Diagnosis, Ranked
from stopset.offline.nominal.nominal import taken_out_in_words
from stopset.offline.report.arm import WIDE, drawn_arm, telling_pose
from stopset.offline.report.page import COLOURS, Page, number
from stopset.types import Array
from stopset.words import many

WORDS = {
    "none": "none: No effect of the catalogue is missing: what is left is noise and the usual scatter of friction.",
    "unknown": "unknown: Something is missing that no effect explains that a model takes.",
}


def page(model: Model, found: Diagnosis, against: str, data: Sequence[str | Path] = ()) -> Page:
    """A self-contained page of one diagnosis: the answer, one picture, what to do; then the numbers, folded."""
    out = Page(f"Diagnosis of {model.robot.name}", model, data)
    out.verdict(_answer(found), "good" if found.verdict == "none" else "bad")
    out.next(_next(found))
    if found.ranked:
        joints = list(dict.fromkeys(j for r in found.ranked for j in r.joints))
        with out.beside():
            out.figure(
                ranking(found),
                "Error of its joint before and after each effect. A shifted mass or inertia that a fit takes up hardly changes it.",
            )
            out.picture(
                drawn_arm(model, telling_pose(model), views=WIDE[:1], marked=joints),
                f"Where something is missing: {', '.join(joints)}."
                if joints
                else "What is missing belongs to no joint, but to the whole arm.",
            )
    for note in found.notes:
        out.text(f"{note[0].upper()}{note[1:]}.")
    for x in found.taken_out:
        out.text(f"Taken out beforehand: {taken_out_in_words(x)}.")
    for r in found.alternatives:
        out.text(f"{_place(r)[0].upper()}{_place(r)[1:]} may as well be {' or '.join(r.one_of[1:])}: {r.alike}.")
    for c in found.changed if found.verdict == "missing" else ():
        out.text(f"Also changed since identification: {c.says}")
    _partials(out, found)
    if found.ranked:
        _ranked(out, found)
    if found.rivals:
        out.heading("What these recordings hardly separate")
        out.points([" from ".join(group) for group in found.rivals])
    if found.depends_on:
        out.heading("What is left depends on")
        out.text(", ".join(found.depends_on))
    if found.structure:
        out.text(f"{found.structure.says[0].upper()}{found.structure.says[1:]}.")
    if found.excess:
        with out.fold("What is left at each joint"):
            out.table(
                ("joint", "leftover variance over sensor noise", "scatter of friction from trial to trial"),
                [(j, x, found.friction_scatter[j]) for j, x in found.excess.items()],
                f"A healthy joint stays below {limit.QUIET} and {limit.FRICTION_SCATTER}.",
            )
    if found.not_identifiable:
        with out.fold(f"Not identifiable from these recordings: {len(found.not_identifiable)} effects"):
            out.table(
                ("effect", "joints", "why", "what would show it"),
                [(b.effect, ", ".join(b.joints) or "all", b.why, b.experiment) for b in found.not_identifiable],
                "An effect of its usual size (a third of the joint's friction, if nothing else is known) would not be claimed here.",
            )
    out.text(f"{many(found.trials, 'trial')}, {found.rows} rows, measured against the {against}.")
    return out


def _answer(found: Diagnosis) -> str:
    """The verdict, and of the best effect what it takes off the error at its own joint."""
    if not found.ranked:
        return WORDS.get(found.verdict, f"{found.verdict}.")
    first, *more = found.ranked
    share = f" ({first.error_after / first.error_before - 1:+.0%})" if first.error_before else ""
    then = f" Then {', '.join(map(_place, more))}." if more else ""
    fall = f"{first.error_before:.3g} → {first.error_after:.3g} {first.unit}{share}"
    return f"{found.verdict}: {_place(first)}, held-out error{first.whose} {fall}.{then}"


def _place(r: Ranked) -> str:
    """An effect and where it is, in words."""
    return f"{r.effect.replace('_', ' ')} at {' + '.join(r.joints)}" if r.joints else r.effect.replace("_", " ")


def _next(found: Diagnosis) -> str:
    first = next((r for r in found.ranked if r.change is None), None)
    todo = [f"`stopset add M {first.label} --data ... --out M2`, then `stopset compare M2`"] if first else []
    if found.ranked and not first:
        todo.append("`stopset identify` from recordings of today: every model has what changed, at another level")
    if found.next_experiment:
        todo.append(found.next_experiment.rstrip("."))
    if not todo:
        todo.append(
            "nothing to add" if found.verdict == "none" else "look at the arm: what is left is no effect that is known here"
        )
    return ". ".join(todo) + "."


def _ranked(out: Page, found: Diagnosis) -> None:
    out.heading("Missing effects")
    for r in found.ranked:
        out.text(f"{r.label}: {r.says}")
    out.table(
        ("effect", "joint", "score", "error before", "error after", "unit", "look at"),
        [(r.effect, " + ".join(r.joints) or "whole arm", round(r.score), r.error_before, r.error_after, r.unit, r.look_at)
         for r in found.ranked],
        _caption(found),
    )  # fmt: skip
    with out.fold("Parameters of the effects"):
        rows = [
            (r.label, k, p.value, "searched" if p.std is None else number(p.std), p.unit)
            for r in found.ranked
            for k, p in r.parameters.items()
        ]
        out.table(("effect", "parameter", "value", "standard deviation", "unit"), rows)


def _partials(out: Page, found: Diagnosis) -> None:
    """Two panels per claim: the partial residual against the effect's column, and what is left once the effect is in."""
    drawn = [(r, r.points) for r in found.ranked if r.points is not None]
    if not drawn:
        return
    out.heading("What each effect explains")
    for r, p in drawn:
        figure = make_subplots(rows=1, cols=2, shared_yaxes=True, subplot_titles=("without the effect", "with it"))
        ends = np.array([p.x.min(), p.x.max()])
        for column, (y, line) in enumerate(((p.without, p.slope * ends), (p.left, 0.0 * ends)), start=1):
            dots = go.Scatter(
                x=_round(p.x),
                y=_round(y),
                mode="markers",
                marker={"size": 4, "opacity": 0.35, "color": COLOURS[0]},
                showlegend=False,
            )
            law = go.Scatter(
                x=_round(ends), y=_round(line), mode="lines", line={"color": COLOURS[1], "width": 2}, showlegend=False
            )
            figure.add_trace(dots, row=1, col=column)
            figure.add_trace(law, row=1, col=column)
            figure.update_xaxes(title_text=p.axis, row=1, col=column)
        figure.update_yaxes(title_text=f"torque of {p.joint} [N m]", row=1, col=1)
        figure.update_layout(height=330)
        out.figure(
            figure,
            f"{r.label}: what the whole model leaves plus the effect's own torque, and what it leaves; line: the effect.",
            500,
        )


def _round(x: Array) -> list[float]:
    """Four digits of the range are more than the eye sees, and keep the page small."""
    digits = 4 - int(np.floor(np.log10(max(float(np.max(np.abs(x))), 1e-12))))
    return [float(v) for v in np.round(x, digits)]


def _caption(found: Diagnosis) -> str:
    """What the table's score and errors are; simulated trials are judged by position, everything else by torque."""
    if found.ranked[0].unit == "rad":
        return (
            "Score: twice the log likelihood ratio, each held-out trial counted once. Errors: RMS position error of the open-loop "
            "simulation on repetitions the fit has not seen."
        )
    return "Score: twice the log Bayes factor. Errors: RMS on motions the fit has not seen; each row follows those above it."


def ranking(found: Diagnosis) -> go.Figure:
    """Held-out error of each effect's joint before and after it, on an axis from zero."""
    ranked = found.ranked[::-1]
    names = [r.label for r in ranked]
    figure = go.Figure(
        [
            go.Bar(name="after", x=[r.error_after for r in ranked], y=names, orientation="h", marker_color="#2a6f97"),
            go.Bar(name="before", x=[r.error_before for r in ranked], y=names, orientation="h", marker_color="#b8c4ce"),
        ]
    )
    figure.update_xaxes(title=f"held-out error [{ranked[0].unit}]", rangemode="tozero")
    figure.update_yaxes(automargin=True)
    figure.update_layout(
        height=160 + 50 * len(names), legend={"traceorder": "reversed", "orientation": "h", "y": 1.02, "yanchor": "bottom"}
    )
    return figure
