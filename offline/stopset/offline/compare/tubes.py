"""Pictures of predicted sets over measurements (the paper's Fig. 4), and of what leaves them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import plotly.graph_objects as go
from plotly.colors import sample_colorscale
from plotly.subplots import make_subplots

from stopset.artifact import Model, UncertaintySets
from stopset.offline.compare.compare import Comparison, Violation, inputs
from stopset.offline.report.page import Page
from stopset.offline.report.thin import extremes, hulls
from stopset.reach.flowpipe import DeviationTube, deviation_tube
from stopset.reach.nonlinear import predicted_tube
from stopset.reach.predict import predict
from stopset.recording import Recording, SuiteKey, suite_label
from stopset.types import Array

POINTS = 120  # per drawn line
TRIALS = 8  # drawn per suite
SUITES = 4
VIOLATIONS = 6  # drawn, the worst first
AFTER = 0.6  # how much longer than until its violation a prediction is drawn, as a share of that
SCALE = "RdYlBu_r"  # blue: first or cold, red: last or hot


@dataclass(frozen=True, slots=True)
class Drawn:
    """What there is to draw: trials of the longest suites with their inputs, and the trials with the worst violations."""

    suites: dict[SuiteKey, list[tuple[Recording, Array]]]
    violations: list[tuple[Violation, Recording, Array]]


def chosen(model: Model, found: Comparison) -> Drawn:
    """The longest suites of each motion, at most `SUITES`, at most `TRIALS` trials each; in one pass with the worst violations."""
    longest: dict[SuiteKey, int] = {}
    for r in found.survey.sample:
        longest[r.suite_key] = max(longest.get(r.suite_key, 0), len(r.t))
    best: dict[int, SuiteKey] = {}
    for key in sorted(longest, key=lambda k: -longest[k]):
        best.setdefault(found.survey.motion[key], key)
    out: dict[SuiteKey, list[tuple[Recording, Array]]] = {
        k: [] for k in sorted(best.values(), key=lambda k: -longest[k])[:SUITES]
    }
    worst = {v.recording: v for v in sorted(found.violations, key=lambda v: -v.relative)[:VIOLATIONS]}
    seen = []
    for _, r, u in inputs(model, found.trials, found.survey, model.powered.dt):
        if r.suite_key in out and len(out[r.suite_key]) < TRIALS:
            out[r.suite_key].append((r, u))
        if r.label in worst:
            seen.append((worst[r.label], r, u))
    return Drawn(out, sorted(seen, key=lambda x: -x[0].relative))


def tubes(out: Page, model: Model, drawn: Drawn) -> None:
    """The tube from each trial's start, one figure per suite; all but the first folded away."""
    out.heading("Predicted sets over measurements")
    first, *more = [trials for trials in drawn.suites.values() if trials] or [[]]
    if first:
        _suite(out, model, first)
    if more:
        with out.fold(f"Of {len(more)} more motion{'s' * (len(more) != 1)}"):
            for trials in more:
                _suite(out, model, trials)


def _suite(out: Page, model: Model, trials: list[tuple[Recording, Array]]) -> None:
    first = trials[0][0]
    by = "temperature" if first.temp is not None else "order of the trials"
    caption = (
        f"{suite_label(first.suite_key)}, {len(trials)} trial{'s' * (len(trials) != 1)}, coloured by {by} (blue first or cold, "
        "red last or hot), predicted from each trial's start. Grey: all states conformant; dark: position only."
    )
    out.figure(_tube_figure(model, trials), caption, 160 * model.n)


def left(out: Page, model: Model, drawn: Drawn) -> None:
    """The worst violations, each beside the prediction that it leaves."""
    panels = [(v, r, u) for v, r, u in drawn.violations if v.state in _states(model)]
    if not panels:
        return
    columns = min(3, len(panels))
    rows = -(-len(panels) // columns)
    titles = [f"{v.state}<br>{v.recording}" for v, _, _ in panels]
    figure = make_subplots(rows=rows, cols=columns, subplot_titles=titles, vertical_spacing=0.3 / rows)
    for k, (v, r, u) in enumerate(panels):
        _left(figure, model, (v, r, u), (k // columns + 1, k % columns + 1))
    figure.update_annotations(font_size=11)
    figure.update_layout(height=110 + 250 * rows, margin={"t": 60})
    worst = panels[0][0]
    more = f" The worst {len(panels)} of {len(drawn.violations)} drawn." if len(drawn.violations) > len(panels) else ""
    out.figure(
        figure,
        f"Where recordings leave the set that was predicted from the measurement at the band's beginning (cross; {worst.recording}: "
        f"{worst.state} by {worst.excess:.3g} {worst.unit}).{more}",
        260 * columns,
    )


def _left(figure: go.Figure, model: Model, seen: tuple[Violation, Recording, Array], place: tuple[int, int]) -> None:
    v, r, u = seen
    sets, i = model.powered, _states(model).index(v.state)
    dt, x = sets.dt, np.hstack([r.q, r.dq])
    first, age = round(v.start_s / dt), round(v.age_s / dt)
    steps = min(max(age + 3, round((1 + AFTER) * age)), round(sets.horizon / dt), len(x) - 1 - first)
    if model.abstraction.linear:
        tube, path = (
            deviation_tube(model.abstraction, sets),
            predict(model.abstraction, dt, x[first], u[first : first + steps + 1]),
        )
        lo, hi = path[: steps + 1] + tube.lo[: steps + 1], path[: steps + 1] + tube.hi[: steps + 1]
    else:
        lo, hi = predicted_tube(model.abstraction, sets, x[first], u[first : first + steps])
    t: Array = np.arange(first, first + steps + 1, dtype=np.float64) * dt
    if np.isfinite(hi[:, i]).all():
        _band(figure, t, (lo[:, i], hi[:, i]), place, "rgba(150,150,150,0.45)", "predicted")
    around = slice(max(0, first - steps // 4), first + steps + 1)
    at = dt * np.arange(len(x))[around]
    line = {"width": 1.5, "color": "#0072b2"}
    row, column = place
    figure.add_trace(
        go.Scatter(x=at, y=x[around, i], mode="lines", line=line, name="measured", showlegend=False), row=row, col=column
    )
    mark = {"symbol": "x", "size": 11, "color": "#b3261e", "line": {"width": 1, "color": "white"}}
    point = go.Scatter(
        x=[dt * (first + age)], y=[x[first + age, i]], mode="markers", marker=mark, name=v.recording, showlegend=False
    )
    figure.add_trace(point, row=row, col=column)
    figure.update_xaxes(title_text="t [s]", row=row, col=column)
    figure.update_yaxes(title_text="q [rad]" if i < model.n else "dq [rad/s]", row=row, col=column)


def _states(model: Model) -> list[str]:
    return [f"{s}_{j}" for s in ("q", "dq") for j in model.joints]


def _band(figure: go.Figure, t: Array, ends: tuple[Array, Array], place: tuple[int, int], colour: str, name: str) -> None:
    keep, low, high = hulls(*ends, POINTS)
    figure.add_trace(
        go.Scatter(
            x=np.concatenate([t[keep], t[keep][::-1]]), y=np.concatenate([high, low[::-1]]), fill="toself", fillcolor=colour,
            line={"width": 0}, hoverinfo="skip", name=name, showlegend=False,
        ),
        row=place[0], col=place[1],
    )  # fmt: skip


def _tube_figure(model: Model, trials: list[tuple[Recording, Array]]) -> go.Figure:
    n, dt = model.n, model.powered.dt
    figure = make_subplots(rows=2, cols=n, shared_xaxes=True, subplot_titles=model.joints, vertical_spacing=0.06)
    for sets, colour in _cases(model):
        lo, hi = around(model, sets, trials)
        t: Array = np.arange(len(lo), dtype=np.float64) * dt
        for i in range(2 * n):
            if np.isfinite(hi[:, i]).all():
                _band(figure, t, (lo[:, i], hi[:, i]), (1 + i // n, 1 + i % n), colour, sets.conform)
    for (r, _), colour in zip(trials, _shades([r for r, _ in trials]), strict=True):
        for i, y in enumerate(np.hstack([r.q, r.dq]).T):
            keep = extremes(y, POINTS)
            line = go.Scatter(
                x=r.t[keep] - r.t[0], y=y[keep], mode="lines", line={"width": 1, "color": colour}, name=r.label, showlegend=False
            )
            figure.add_trace(line, row=1 + i // n, col=1 + i % n)
    figure.update_yaxes(title_text="q [rad]", row=1, col=1)
    figure.update_yaxes(title_text="dq [rad/s]", row=2, col=1)
    figure.update_xaxes(title_text="t [s]", row=2)
    figure.update_annotations(font_size=12)
    figure.update_layout(height=520)
    return figure


def around(model: Model, sets: UncertaintySets, trials: list[tuple[Recording, Array]]) -> tuple[Array, Array]:
    """Lower and upper edge (N, 2n) of what is predicted from the trials' starts, over the longest trial or the horizon.

    Each trial is held against the prediction from its own measured start; one picture takes the hull of the starts.
    """
    dt = model.powered.dt
    first, u = max(trials, key=lambda p: len(p[0].t))
    x0 = np.mean([np.concatenate([r.q[0], r.dq[0]]) for r, _ in trials], axis=0)
    last = min(len(first.t), round(sets.horizon / sets.dt) + 1)
    nominal = predict(model.abstraction, dt, x0, u[:last])[:last]
    if model.abstraction.linear:
        tube = deviation_tube(model.abstraction, sets)
    else:  # another tube along every motion; the picture takes the one from the mean start
        a, b = predicted_tube(model.abstraction, sets, x0, u[: last - 1])
        tube = DeviationTube(np.asarray(dt * np.arange(last)), a - nominal, b - nominal)
    starts = np.array(
        [predict(model.abstraction, dt, np.concatenate([r.q[0], r.dq[0]]), w[:last])[:last] for r, w in trials if len(w) >= last]
    )
    lo, hi = (starts.min(0), starts.max(0)) if len(starts) else (nominal, nominal)
    return lo + tube.lo[:last], hi + tube.hi[:last]


def _cases(model: Model) -> list[tuple[UncertaintySets, str]]:
    """All states in light grey, then position only in dark grey."""
    by_case = {s.conform: s for name, s in model.sets.items() if name.startswith("powered") and s.temp is None}
    shades = (("all", "rgba(150,150,150,0.35)"), ("position", "rgba(80,80,80,0.35)"))
    return [(by_case[case], colour) for case, colour in shades if case in by_case]


def _shades(trials: list[Recording]) -> list[str]:
    value = np.array([float(r.temp.mean()) if r.temp is not None else float(r.place) for r in trials])
    span = max(float(np.ptp(value)), 1e-12)
    return [str(c) for c in sample_colorscale(SCALE, ((value - value.min()) / span).tolist())]
