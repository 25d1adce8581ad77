"""The comparison as a page: tubes over measurements (the paper's Fig. 4), Table II, errors, violations, ranked motions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from plotly.colors import sample_colorscale
from plotly.subplots import make_subplots

from stopset.artifact import Model, UncertaintySets
from stopset.offline.compare.compare import Comparison, inputs
from stopset.offline.compare.dependence import explained, partial_residual
from stopset.offline.compare.verdict import verdict
from stopset.offline.conform.bands import narrower
from stopset.offline.report.page import COLOURS, Page
from stopset.reach.flowpipe import Tube, deviation_tube, predict
from stopset.reach.nonlinear import predicted_tube
from stopset.recording import Recording, SuiteKey, suite_label
from stopset.sets import Box
from stopset.types import Array

POINTS = 240  # per drawn line
TRIALS = 24  # drawn per suite
SUITES = 4
SCALE = "RdYlBu_r"  # blue: first or cold, red: last or hot


def page(model: Model, found: Comparison, paths: Sequence[str | Path]) -> Page:
    """The report of ``stopset compare``."""
    out = Page(f"{model.robot.name}: model and measurements")
    said = verdict(found)
    out.verdict(said.text, said.kind)
    out.text(model.guarantee.text)
    _errors(out, found)
    _tubes(out, model, found, paths)
    _heat_map(out, model, found, paths)
    _table2(out, model)
    _violations(out, found)
    _ranking(out, model, found)
    _domain(out, model, found)
    return out


def _errors(out: Page, found: Comparison) -> None:
    out.heading("Errors per joint")
    head = ["joint", "torque RMS [N m]", "repeatability floor [N m]", "velocity RMS [rad/s]", "position RMS [rad]"]
    keys = ("torque_rmse", "torque_rmse_floor", "velocity_rmse", "position_rmse")
    out.table(head, [[j, *(row[k] for k in keys)] for j, row in found.figures.items()])
    out.text(
        "Torque is averaged over 0.2 s; velocity and position are those of the open-loop prediction from each trial's start. "
        "The floor is the scatter between repetitions of the same torques: no model without a new variable gets below it."
    )


def _chosen(model: Model, found: Comparison, paths: Sequence[str | Path]) -> dict[SuiteKey, list[tuple[Recording, Array]]]:
    """The longest suites of each motion, at most `SUITES`, at most `TRIALS` trials each."""
    groups: dict[SuiteKey, list[tuple[Recording, Array]]] = {}
    for r in found.survey.sample:
        groups.setdefault(r.suite_key, [])
    longest = {key: max(len(r.t) for r in found.survey.sample if r.suite_key == key) for key in groups}
    best: dict[int, SuiteKey] = {}
    for key in sorted(groups, key=lambda k: -longest[k]):
        best.setdefault(found.survey.motion[key], key)
    wanted = sorted(best.values(), key=lambda k: -longest[k])[:SUITES]
    out: dict[SuiteKey, list[tuple[Recording, Array]]] = {k: [] for k in wanted}
    for _, r, u in inputs(model, paths, found.survey, model.powered.dt):
        if r.suite_key in out and len(out[r.suite_key]) < TRIALS:
            out[r.suite_key].append((r, u))
    return out


def _tubes(out: Page, model: Model, found: Comparison, paths: Sequence[str | Path]) -> None:
    out.heading("Predicted sets over measurements")
    for trials in _chosen(model, found, paths).values():
        if trials:
            first = trials[0][0]
            by = "temperature" if trials[0][0].temp is not None else "order of the trials"
            count = f"{len(trials)} trial{'s' * (len(trials) != 1)}"
            caption = (
                f"{suite_label(first.suite_key)}, {count}, coloured by {by} (blue first or cold, red last or hot). "
                "Grey: all states conformant; dark: position only. Crosses: where a recording leaves the sets most, of a prediction "
                "that may have started later."
            )
            out.figure(_tube_figure(model, trials, found), caption, 160 * model.n)


def _band(figure: go.Figure, t: Array, lo: Array, hi: Array, row: int, column: int, colour: str, name: str) -> None:
    figure.add_trace(
        go.Scatter(
            x=np.concatenate([t, t[::-1]]).round(4), y=np.concatenate([hi, lo[::-1]]).round(6), fill="toself", fillcolor=colour,
            line={"width": 0}, hoverinfo="skip", name=name, showlegend=False,
        ),
        row=row, col=column,
    )  # fmt: skip


def _tube_figure(model: Model, trials: list[tuple[Recording, Array]], found: Comparison) -> go.Figure:
    n, dt = model.n, model.powered.dt
    figure = make_subplots(rows=2, cols=n, shared_xaxes=True, subplot_titles=model.joints, vertical_spacing=0.06)
    first, u = max(trials, key=lambda p: len(p[0].t))
    x0 = np.mean([np.concatenate([r.q[0], r.dq[0]]) for r, _ in trials], axis=0)
    for sets, colour in _cases(model):
        last = min(len(first.t), round(sets.horizon / sets.dt) + 1)
        if model.abstraction.linear:
            tube = deviation_tube(model.abstraction, sets)
        else:  # another tube along every motion; the picture takes the one from the mean start
            path = predict(model.abstraction, dt, x0, u[:last])
            a, b = predicted_tube(model.abstraction, sets, x0, u[: last - 1])
            tube = Tube(np.asarray(dt * np.arange(last)), a - path, b - path)
        nominal = predict(model.abstraction, dt, x0, u[:last])
        # each trial is held against the prediction from its own measured start; one picture takes the hull of the
        # starts
        starts = np.array(
            [
                predict(model.abstraction, dt, np.concatenate([r.q[0], r.dq[0]]), w[:last])[:last]
                for r, w in trials
                if len(w) >= last
            ]
        )
        lo, hi = (starts.min(0), starts.max(0)) if len(starts) else (nominal, nominal)
        keep = np.unique(np.linspace(0, last - 1, POINTS).astype(int))
        for j in range(n):
            for row, i in ((1, j), (2, n + j)):
                if np.isfinite(tube.hi[0, i]):
                    _band(
                        figure,
                        keep * dt,
                        (lo[keep, i] + tube.lo[keep, i]),
                        (hi[keep, i] + tube.hi[keep, i]),
                        row,
                        j + 1,
                        colour,
                        sets.conform,
                    )
    shade = _shades([r for r, _ in trials])
    for (r, _), colour in zip(trials, shade, strict=True):
        keep = np.unique(np.linspace(0, len(r.t) - 1, POINTS).astype(int))
        for j in range(n):
            for row, y in ((1, r.q[:, j]), (2, r.dq[:, j])):
                figure.add_trace(
                    go.Scatter(
                        x=(r.t[keep] - r.t[0]).round(4), y=y[keep].round(5), mode="lines", line={"width": 1, "color": colour},
                        name=r.label, showlegend=False,
                    ),
                    row=row, col=j + 1,
                )  # fmt: skip
    _crosses(figure, model, [r for r, _ in trials], found)
    figure.update_yaxes(title_text="q [rad]", row=1, col=1)
    figure.update_yaxes(title_text="dq [rad/s]", row=2, col=1)
    figure.update_xaxes(title_text="t [s]", row=2)
    figure.update_layout(height=520)
    return figure


def _crosses(figure: go.Figure, model: Model, trials: list[Recording], found: Comparison) -> None:
    """Where drawn recordings leave the sets most."""
    drawn = {r.label: r for r in trials}
    names = [f"{s}_{j}" for s in ("q", "dq") for j in model.joints]
    for v in found.violations:
        if v.recording not in drawn or v.state not in names:
            continue
        r, i = drawn[v.recording], names.index(v.state)
        at = v.start_s + v.age_s
        y = np.interp(at, r.t - r.t[0], np.hstack([r.q, r.dq])[:, i])
        mark = {"symbol": "x", "size": 10, "color": "black", "line": {"width": 1, "color": "white"}}
        row, column = divmod(i, model.n)
        cross = go.Scatter(
            x=[round(at, 4)], y=[round(float(y), 5)], mode="markers", marker=mark, name=v.recording, showlegend=False
        )
        figure.add_trace(cross, row=row + 1, col=column + 1)


def _cases(model: Model) -> list[tuple[UncertaintySets, str]]:
    """All states in light grey, then position only in dark grey."""
    by_case = {s.conform: s for name, s in model.sets.items() if name.startswith("powered") and s.temp is None}
    shades = (("all", "rgba(150,150,150,0.35)"), ("position", "rgba(80,80,80,0.35)"))
    return [(by_case[case], colour) for case, colour in shades if case in by_case]


def _shades(trials: list[Recording]) -> list[str]:
    value = np.array([float(r.temp.mean()) if r.temp is not None else float(r.place) for r in trials])
    span = max(float(np.ptp(value)), 1e-12)
    return [str(c) for c in sample_colorscale(SCALE, ((value - value.min()) / span).tolist())]


def _heat_map(out: Page, model: Model, found: Comparison, paths: Sequence[str | Path]) -> None:
    out.heading("What the torque error depends on")
    shares = explained(model, inputs(model, paths, found.survey, model.powered.dt), found.survey)
    order = np.argsort(-shares.share.max(axis=0))[:16]
    names = [shares.variables[k] for k in order]
    figure = go.Figure(
        go.Heatmap(
            z=100 * shares.share[:, order], x=names, y=model.joints, colorscale="Blues", zmin=0, zmax=100,
            text=np.round(100 * shares.share[:, order]).astype(int), texttemplate="%{text}", colorbar={"title": "%"},
        )
    )  # fmt: skip
    figure.update_layout(height=120 + 34 * model.n)
    figure.update_yaxes(autorange="reversed")
    caption = "Percent of each joint's squared torque error that each variable alone explains on stretches it was not fitted to."
    out.figure(figure, caption)
    worst = np.argsort(-shares.share.max(axis=1))[:3]
    panels = make_subplots(rows=1, cols=len(worst), subplot_titles=[model.joints[j] for j in worst])
    for column, j in enumerate(worst, start=1):
        p = partial_residual(shares, int(j))
        keep = np.unique(np.linspace(0, len(p.x) - 1, 1500).astype(int))
        dots = go.Scatter(
            x=p.x[keep].round(4), y=p.y[keep].round(4), mode="markers", marker={"size": 3, "opacity": 0.4, "color": COLOURS[0]},
            showlegend=False,
        )  # fmt: skip
        law = go.Scatter(
            x=p.line[:, 0].round(4), y=p.line[:, 1].round(4), mode="lines+markers", line={"color": COLOURS[1]}, showlegend=False
        )
        panels.add_trace(dots, row=1, col=column)
        panels.add_trace(law, row=1, col=column)
        panels.update_xaxes(title_text=p.variable + (f"<br>(less what {p.other} explains)" if p.other else ""), row=1, col=column)
    panels.update_yaxes(title_text="partial residual [N m]", row=1, col=1)
    panels.update_layout(height=360)
    out.figure(
        panels,
        "Torque error over the variable that explains most of it, less what the next best variable explains; line: mean within "
        "twelfths. For the three joints where one variable explains most.",
    )


def _table2(out: Page, model: Model) -> None:
    out.heading("Identified sets (the paper's Table II)")
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
    if found.violations:
        out.heading("Violations")
        worst = sorted(found.violations, key=lambda v: -v.relative)[:50]
        out.table(
            ["recording", "state", "side", "from [s]", "age [s]", "excess", "unit", "excess / half-width"],
            [[v.recording, v.state, v.side, v.start_s, v.age_s, v.excess, v.unit, v.relative] for v in worst],
        )


def _known(model: Model, joint: str) -> float:
    row = model.errors.get(joint, {})
    return row.get("torque_rmse_floor") or row.get("torque_rmse") or 1.0


def _ranking(out: Page, model: Model, found: Comparison) -> None:
    out.heading("Motions ranked by misfit")
    # without repetitions here, what the identification's own repetitions showed, or its error
    floor = np.array([row["torque_rmse_floor"] or _known(model, j) for j, row in found.figures.items()])
    motions: dict[int, list[Array]] = {}
    for row in found.rows:
        motions.setdefault(row.motion, []).append(row.torque_rms)
    mean = {m: np.sqrt(np.nanmean(np.square(v), axis=0)) for m, v in motions.items()}
    ranked = sorted(mean, key=lambda m: -float(np.nanmax(mean[m] / floor)))
    rows = [
        [f"motion {m}", len(motions[m]), model.joints[int(np.nanargmax(mean[m] / floor))], *mean[m].tolist()] for m in ranked[:20]
    ]
    out.table(
        ["", "trials", "worst joint", *(f"{j} [N m]" for j in model.joints)],
        rows,
        "RMS torque error per motion, worst against the floor first",
    )


def _domain(out: Page, model: Model, found: Comparison) -> None:
    out.heading("Domain of validity")
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
