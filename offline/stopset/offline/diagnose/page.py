"""The diagnosis as a page: verdict, ranking, parameters, what the data cannot tell, what to do next."""

from __future__ import annotations

import plotly.graph_objects as go

from stopset.artifact import Model
from stopset.offline.diagnose.diagnosis import QUIET, RESTLESS, Diagnosis
from stopset.offline.report import Page, number

WORDS = {
    "missing": "These effects are missing from the model, best first.",
    "none": "No effect of the catalogue is missing: what is left is noise and the usual scatter of friction.",
    "unknown": "Something is missing that no effect of the catalogue explains.",
}


def page(model: Model, found: Diagnosis, against: str) -> Page:
    """A self-contained page of one diagnosis."""
    out = Page(f"Diagnosis of {model.robot.name}")
    out.verdict(f"{found.verdict}: {WORDS[found.verdict]}", "good" if found.verdict == "none" else "bad")
    out.text(f"{found.trials} trials, {found.rows} rows, measured against the {against}.")
    if found.ranked:
        out.heading("Missing effects")
        out.table(
            ("effect", "joint", "score", "error before", "error after", "unit", "look at"),
            [(r.effect, " + ".join(r.joints) or "whole arm", r.score, r.error_before, r.error_after, r.unit, r.look_at)
             for r in found.ranked],
            _caption(found),
        )  # fmt: skip
        out.figure(
            _bars(found),
            "Error of its joint before and after each effect. A shifted mass or inertia that a fit takes up hardly changes it.",
        )
        rows = []
        for r in found.ranked:
            out.text(f"{r.label}: {r.says}")
            rows += [
                (r.label, k, p.value, "searched" if p.std is None else number(p.std), p.unit) for k, p in r.parameters.items()
            ]
        out.table(("effect", "parameter", "value", "standard deviation", "unit"), rows)
    if found.rivals:
        out.heading("What these recordings hardly separate")
        out.table(("rivals",), [(" / ".join(group),) for group in found.rivals])
    if found.depends_on:
        out.heading("What is left depends on")
        out.text(", ".join(found.depends_on))
    if found.next_experiment:
        out.heading("Next experiment")
        out.text(found.next_experiment)
    if found.excess:
        out.heading("Per joint")
        out.table(
            ("joint", "leftover variance over sensor noise", "scatter of friction from trial to trial"),
            [(j, x, found.friction_scatter[j]) for j, x in found.excess.items()],
            f"A healthy joint stays below {QUIET} and {RESTLESS}.",
        )
    if found.not_identifiable:
        out.heading("Not identifiable from these recordings")
        for line in found.not_identifiable:
            out.text(line)
    return out


def _caption(found: Diagnosis) -> str:
    """What the table's score and errors are; simulated trials are judged by position, everything else by torque."""
    if found.ranked[0].unit == "rad":
        return (
            "Score: twice the log likelihood ratio, each held-out trial counted once. Errors: RMS position error of the open-loop "
            "simulation on repetitions the fit has not seen."
        )
    return "Score: twice the log Bayes factor. Errors: RMS on motions the fit has not seen; each row follows those above it."


def _bars(found: Diagnosis) -> go.Figure:
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
    figure.update_layout(height=160 + 50 * len(names), legend={"traceorder": "reversed"})
    return figure
