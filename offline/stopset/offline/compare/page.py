"""The comparison as a page: the answer, what leaves the sets, errors, what they depend on, tubes, Table II, ranked motions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from stopset.artifact import Model, UncertaintySets
from stopset.offline.compare.compare import Comparison, inputs
from stopset.offline.compare.dependence import SAME, Explained, explained, partial_residual, strongest_first
from stopset.offline.compare.tubes import chosen, left, tubes
from stopset.offline.compare.verdict import above, by_failure, failing, in_full, verdict
from stopset.offline.conform.bands import narrower
from stopset.offline.report.arm import WIDE, drawn_arm, telling_pose
from stopset.offline.report.guarantee import guarantee
from stopset.offline.report.page import COLOURS, Page
from stopset.offline.report.thin import spread
from stopset.sets import Box
from stopset.types import Array

COLUMNS = 10  # of the heat-map
VISIBLE = 0.02  # of a bar: what is less stands on none
DOTS = 1000  # of a partial residual
LISTED = 50  # violations


def page(model: Model, found: Comparison, paths: Sequence[str | Path], shares: Explained | None = None) -> Page:
    """The report of ``stopset compare``; ``shares``: what the error depends on, where that is known already."""
    out = Page(f"{model.robot.name}: model and measurements", model, paths)
    said = verdict(found)
    drawn = chosen(model, found)
    out.verdict(said.text, said.kind)
    out.next(said.next)
    for sentence in (*found.said, *found.unsound[1:], *found.left_out):
        out.text(f"{sentence}.")
    left(out, model, drawn)
    _errors(out, model, found)
    _heat_map(out, model, shares or explained(model, inputs(model, found.trials, found.survey, model.powered.dt), found.survey))
    tubes(out, model, drawn)
    guarantee(out, model)
    with out.fold("Identified sets (the paper's Table II)"):
        _table2(out, model)
    _violations(out, found)
    with out.fold("Motions ranked by misfit"):
        _ranking(out, model, found)
    with out.fold("Domain of validity"):
        _domain(out, model, found)
    return out


def bars(found: Comparison) -> go.Figure:
    """Torque error of each joint over what its repetitions differ by, the one that fails most first.

    What the abstraction makes simpler stands on top: the model knows it, so it is no failure.
    """
    rows = by_failure(found)
    names = [j for j, _ in rows]
    full, whole = [in_full(r) for _, r in rows], [r["torque_rmse"] for _, r in rows]
    rest = [max(w - f, 0.0) if f is not None and w is not None else None for f, w in zip(full, whole, strict=True)]
    floor = go.Scatter(
        name="repeatability floor", x=names, y=[r["torque_rmse_floor"] for _, r in rows], mode="markers",
        marker={"symbol": "line-ew", "size": 40, "line": {"width": 3, "color": COLOURS[1]}},
    )  # fmt: skip
    figure = go.Figure([go.Bar(name="torque error", x=names, y=full, marker_color=COLOURS[0])])
    if any(r and f and r > VISIBLE * f for r, f in zip(rest, full, strict=True)):
        simpler = {"color": "#dfe7ee", "line": {"color": COLOURS[0], "width": 1}}
        figure.add_trace(go.Bar(name="what the abstraction leaves out, in U", x=names, y=rest, marker=simpler))
    figure.add_trace(floor)
    figure.update_yaxes(title_text="torque RMS [N m]", rangemode="tozero")
    figure.update_layout(barmode="stack", height=300, legend={"orientation": "h", "y": 1.02, "yanchor": "bottom"})
    return figure


def _errors(out: Page, model: Model, found: Comparison) -> None:
    out.heading("Errors per joint, the one that fails most first")
    rows = by_failure(found)
    fails = failing(found)
    with out.beside():
        out.figure(bars(found))
        out.picture(
            drawn_arm(model, telling_pose(model), views=WIDE[:1], marked=fails),
            f"Where the model fails most: {fails[0]}."
            if fails
            else "No joint errs more than its repetitions differ, as far as they tell.",
        )
    head = [
        "joint",
        "torque RMS [N m]",
        "in full [N m]",
        "repeatability floor [N m]",
        "times the floor",
        "velocity RMS [rad/s]",
        "position RMS [rad]",
    ]
    keys = ("velocity_rmse", "position_rmse")
    out.table(
        head,
        [[j, r["torque_rmse"], in_full(r), r["torque_rmse_floor"], above(r), *(r[k] for k in keys)] for j, r in rows],
        "Torque is averaged over 0.2 s; velocity and position are those of the open-loop prediction from each trial's start. "
        "In full is the model with all it knows; what the abstraction leaves out besides is in U. "
        "The floor is the scatter between repetitions of the same torques: no model without a new variable gets below it.",
    )


def _heat_map(out: Page, model: Model, shares: Explained) -> None:
    out.heading("What the torque error depends on")
    worst = [j for j in np.argsort(-shares.share.max(axis=1))[:3] if shares.share[j].max() > SAME]
    if not worst:
        out.text("No variable explains anything of it, or these recordings are too short to tell.")
        return
    order = strongest_first(shares)[:COLUMNS]
    names = [shares.variables[k] for k in order]
    out.shares(
        model.joints, names, shares.share[:, order],
        "Percent of each joint's squared torque error that each variable alone explains on stretches it was not fitted to",
    )  # fmt: skip
    panels = make_subplots(rows=1, cols=len(worst), subplot_titles=[model.joints[j] for j in worst])
    for column, j in enumerate(worst, start=1):
        p = partial_residual(shares, int(j))
        keep = spread(p.x, p.y, DOTS)
        dots = go.Scatter(
            x=p.x[keep], y=p.y[keep], mode="markers", marker={"size": 3, "opacity": 0.4, "color": COLOURS[0]}, showlegend=False
        )
        law = go.Scatter(x=p.line[:, 0], y=p.line[:, 1], mode="lines+markers", line={"color": COLOURS[1]}, showlegend=False)
        panels.add_trace(dots, row=1, col=column)
        panels.add_trace(law, row=1, col=column)
        panels.update_xaxes(title_text=p.variable + (f"<br>(less what {p.other} explains)" if p.other else ""), row=1, col=column)
    panels.update_yaxes(title_text="partial residual [N m]", row=1, col=1)
    panels.update_layout(height=360)
    out.figure(
        panels,
        "Torque error over the variable that explains most of it, less what the next best variable explains; line: mean within "
        "twelfths. For the joints where one variable explains most.",
        270 * len(worst),
    )


def _table2(out: Page, model: Model) -> None:
    n = model.n
    seen: list[str] = []
    for name, s in model.sets.items():
        twin = next((k for k in seen if _same(s, model.sets[k])), None)
        if twin is not None:
            out.text(f"{name} ({_scope(s.conform)}): the same sets as {twin}, to what is printed.")
            continue
        seen.append(name)
        rows = [
            [j, *(f"[{b.lo[i]:.4g}, {b.hi[i]:.4g}]" for b, i in ((s.X0, k), (s.X0, n + k), (s.U, k), (s.V, k), (s.V, n + k)))]
            for k, j in enumerate(model.joints)
        ]
        head = ["joint", "X0: q [rad]", "X0: dq [rad/s]", "U [N m]", "V: q [rad]", "V: dq [rad/s]"]
        out.table(
            head,
            rows,
            f"{name}: {_scope(s.conform)}, {s.windows} windows, margin {s.margin:.2f}, U widths {s.U.width.sum():.2f} N m",
        )
    bands = narrower(model)
    if bands:
        out.table(
            [
                "temperature band",
                "mean of the joints",
                "position tube [rad]",
                "of the whole's",
                "U widths [N m]",
                "of the whole's",
            ],
            [
                [b.band, b.at, b.tube, None if b.tube_share is None else f"{b.tube_share:.0%}", b.torque, f"{b.torque_share:.0%}"]
                for b in bands
            ],
            "How much narrower the sets are where the temperature is known (mean width of the position tube, and of U, summed over joints)",
        )
    active = [a for a in model.powered.active if a.bound.startswith("U")]
    out.table(
        ["bound", "fixed by", "from [s]", "age [s]", "state"],
        [[a.bound, a.recording, a.start_s, a.age_s, a.state] for a in active],
        "Which recording, time and joint fix each bound (before the margin)",
    )


def _scope(conform: str) -> str:
    return "all states" if conform == "all" else "position only"


def _same(a: UncertaintySets, b: UncertaintySets) -> bool:
    """Whether the sets of two cases differ by less than a thousandth of their widths."""
    pairs = ((a.X0, b.X0), (a.U, b.U), (a.V, b.V))
    return all(np.all(np.abs(x - y) <= 1e-3 * p.width) for p, o in pairs for x, y in ((p.lo, o.lo), (p.hi, o.hi)))


def _violations(out: Page, found: Comparison) -> None:
    if not found.violations:
        return
    worst = sorted(found.violations, key=lambda v: -v.relative)[:LISTED]
    of = f"the worst {LISTED} of {len(found.violations)}" if len(found.violations) > LISTED else f"{len(worst)}"
    with out.fold(f"Violations: {of}"):
        out.table(
            ["recording", "state", "side", "from [s]", "age [s]", "excess", "unit", "excess / half-width"],
            [[v.recording, v.state, v.side, v.start_s, v.age_s, v.excess, v.unit, v.relative] for v in worst],
        )


def _known(model: Model, joint: str) -> float:
    row = model.errors.get(joint, {})
    return row.get("torque_rmse_floor") or row.get("torque_rmse") or 1.0


def _ranking(out: Page, model: Model, found: Comparison) -> None:
    # without repetitions here, what the identification's own repetitions showed, or its error
    floor = np.array([row["torque_rmse_floor"] or _known(model, j) for j, row in found.figures.items()])
    motions: dict[int, list[Array]] = {}
    for row in found.rows:
        if np.isfinite(row.torque_rms).all():  # a stretch shorter than what is averaged over tells none
            motions.setdefault(row.motion, []).append(row.torque_rms)
    mean = {m: np.sqrt(np.mean(np.square(v), axis=0)) for m, v in motions.items()}
    ranked = sorted(mean, key=lambda m: -float(np.max(mean[m] / floor)))
    rows = [
        [f"motion {m}", len(motions[m]), model.joints[int(np.argmax(mean[m] / floor))], *mean[m].tolist()] for m in ranked[:20]
    ]
    out.table(
        ["", "trials", "worst joint", *(f"{j} [N m]" for j in model.joints)],
        rows,
        "RMS torque error per motion, worst against the floor first",
    )


def _domain(out: Page, model: Model, found: Comparison) -> None:
    d, seen = model.domain, found.survey
    rows = [
        [j, *(_range(b, k) for b in (d.q, seen.q, d.dq, seen.dq, d.u, d.temp, seen.temp))] for k, j in enumerate(model.joints)
    ]
    out.table(
        ["joint", "q [rad]", "measured here", "dq [rad/s]", "measured here", "u [N m]", "temperature [°C]", "measured here"],
        rows,
        "Hull of what identification saw, and of these recordings; outside the first: not covered",
    )


def _range(b: Box | None, k: int) -> str:
    return "–" if b is None else f"[{b.lo[k]:.3f}, {b.hi[k]:.3f}]"
