"""An inspection as a page: what is wrong, what is missing, what there is, joint by joint."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from stopset.offline.inspect.inspection import Inspection, inspect_recordings
from stopset.offline.report.page import COLOURS, Page
from stopset.robot import Robot
from stopset.words import many

SIGNALS = (("q", "q [rad]"), ("dq", "dq [rad/s]"), ("tau", "tau [N m]"))


def page(found: Sequence[Inspection], against: str | None) -> Page:
    """A self-contained page of several files; ``against``: name of the robot that torque was held against, if any."""
    out = Page("Inspection of recordings", data=[r.path for r in found])
    bad = [r.path for r in found if r.wrong]
    if bad:
        out.verdict(f"Do not identify from these as they are: {', '.join(bad)}", "bad")
    else:
        out.verdict("Nothing is wrong with these recordings that identification should not be run over.", "good")
    held = (
        f"Torque was held against the model of {against}."
        if against
        else "Without a robot, torque's unit and delay were not checked."
    )
    out.text(held)
    for r in found:
        _file(out, r)
    return out


def save(path: str | Path, recordings: Sequence[str | Path], robot: Robot | None) -> None:
    """Inspect ``recordings`` (against ``robot``, if given) and write the page to ``path``; raises `OutputError`."""
    page(inspect_recordings(recordings, robot), robot.name if robot is not None else None).save(path)


def _file(out: Page, r: Inspection) -> None:
    o = r.offers
    out.heading(r.path)
    if r.refused:
        out.verdict(r.refused, "bad")
    rate = f"{o['rate_hz']:.4g} Hz" if o["rate_hz"] else "unknown rate"
    out.text(
        f"{many(o['trials'], 'trial')}, {o['samples']} samples, {o['seconds']:.4g} s at {rate}; {o['effort']}, {o['velocity']} velocity, "
        f"{o['clock']} clock; channels {', '.join(o['channels'])}."
    )
    for cause in o["said"]:
        out.text(f"The monitor that wrote it took its violation for: {cause}.")
    order = {"error": 0, "warning": 1, "note": 2}
    if r.findings:
        out.table(
            ("what is wrong", "joint", "seen", "expected", "do"),
            [(f"{f.kind} ({f.severity})", f.joint or "all", f.seen, f.expected, f.do)
             for f in sorted(r.findings, key=lambda f: order[f.severity])],
        )  # fmt: skip
    else:
        out.text("Nothing is wrong with it.")
    if r.missing:
        out.table(("missing for identification", "what is lacking", "do"), [(m.part, m.lacking, m.do) for m in r.missing])
    else:
        out.text("Nothing is missing for identification.")
    if o["phases"]:
        out.table(
            ("phase", "trials", "motions", "most trials of a motion", "seconds"),
            [(name, p["trials"], p["motions"], p["most_trials_per_motion"], p["seconds"]) for name, p in o["phases"].items()],
        )
    if o["trials"]:
        out.figure(_ranges(r), "What each joint was driven through: lowest to highest value of each signal.", 560)


def _ranges(r: Inspection) -> go.Figure:
    joints = r.offers["joints"]
    figure = make_subplots(rows=1, cols=len(SIGNALS), subplot_titles=[title for _, title in SIGNALS], shared_yaxes=True)
    for column, (signal, _) in enumerate(SIGNALS, start=1):
        for k, (joint, x) in enumerate(joints.items()):
            low, high = x[signal] or (np.nan, np.nan)
            figure.add_trace(
                go.Bar(y=[joint], x=[high - low], base=[low], orientation="h", marker_color=COLOURS[k % len(COLOURS)], showlegend=False,
                       hovertemplate=f"{joint}: {low:.4g} to {high:.4g}<extra></extra>"),
                row=1, col=column,
            )  # fmt: skip
    figure.update_yaxes(autorange="reversed")
    figure.update_layout(height=160 + 34 * len(joints), bargap=0.45)
    return figure
