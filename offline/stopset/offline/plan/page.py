"""A plan as a page: what to drive, what it will tell, what today's data leave open."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from stopset.offline.plan.design import Plan
from stopset.offline.plan.files import count
from stopset.offline.plan.motion import PlannedMotion
from stopset.offline.plan.poses import APPROACH
from stopset.offline.report.page import COLOURS, Page

DRAWN = 300  # points of a curve: more cannot be seen
SHOWN = 3  # motions of a part that are drawn, one after the other


def page(plan: Plan) -> Page:
    """A self-contained page of a designed campaign."""
    robot = plan.robot
    out = Page(f"Experiments for {robot.name}")
    minutes = sum(p.seconds for p in plan.parts) / 60
    out.verdict(f"{minutes:.0f} minutes of motion in {len(plan.parts)} parts; moving to start points is not counted.")
    for w in plan.warnings:
        out.verdict(f"{w[0].upper()}{w[1:]}.", "bad")
    out.next("drive the parts in this order and record them, then `stopset inspect`, then `stopset identify`.")
    out.heading("What to drive, and what it tells")
    rows = []
    for p in plan.parts:
        t = p.determines
        base = f"{t['base_parameters_halved']} of {t['base_parameters']}" if t else None
        rotor, dry = (t.get(k) for k in ("rotor_std_percent", "F_c_std_Nm"))
        rows.append((p.name, count(plan, p), p.repeats, p.seconds / 60, p.identifies, base, rotor, dry))
    out.table(
        (
            "part",
            "motions",
            "repeats",
            "minutes",
            "identifies",
            "base parameters with half the error",
            "rotor ± [%]",
            "F_c ± [N m]",
        ),
        rows,
    )
    out.text(
        f"Condition number of the excitation's regressor: {plan.condition:.1f}, of random motions {plan.condition_random:.1f}. "
        f"Static poses are approached from {APPROACH} rad below and above, all joints, and held two seconds."
    )
    if plan.gaps is not None:
        out.heading("What today's data leave undetermined")
        out.points(plan.gaps or ["nothing"])
    for part in plan.parts:
        if part.motions:
            out.heading(part.name)
            out.figure(_motions(part.motions[:SHOWN], robot.joints, robot.dq_limit), _caption(len(part.motions)))
    with out.fold(f"Stops: {len(plan.stops)}"):
        out.table(
            ("category", "joint", "speed %", "motion", "trigger [s]", "repeats"),
            [(int(s["category"]), robot.joints[int(s["joint"])], int(s["speed_percent"]), int(s["motion"]), s["trigger_s"],
              int(s["repeats"])) for s in plan.stops],
        )  # fmt: skip
    with out.fold(f"Standard error of every parameter: {len(plan.outlook)}"):
        out.table(
            ("parameter", "unit", "description alone", "with today's data", "after this campaign"),
            [(row["parameter"], row["unit"], row["before"], row["now"], row["after"]) for row in plan.outlook],
        )
    return out


def _caption(motions: int) -> str:
    first = "" if motions <= SHOWN else f" The first {SHOWN} of {motions}."
    return f"Positions, and speeds as a share of each joint's limit.{first}"


def _motions(paths: Sequence[PlannedMotion], joints: Sequence[str], limit: np.ndarray) -> go.Figure:
    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.06)
    for j, joint in enumerate(joints):
        start = 0.0
        for k, p in enumerate(paths):
            at = slice(None, None, -(-len(p.t) // DRAWN))
            line = {"color": COLOURS[j % len(COLOURS)], "width": 1.5}
            for row, y in ((1, p.q[at, j]), (2, p.dq[at, j] / limit[j])):
                figure.add_trace(
                    go.Scatter(x=start + p.t[at], y=y, name=joint, legendgroup=joint, line=line, showlegend=k == 0 and row == 1),
                    row=row, col=1,
                )  # fmt: skip
            start += p.duration + 0.5
    figure.update_yaxes(title_text="q [rad]", row=1, col=1)
    figure.update_yaxes(title_text="dq / limit", range=[-1, 1], row=2, col=1)
    figure.update_xaxes(title_text="t [s]", row=2, col=1)
    figure.update_layout(height=460, legend={"orientation": "h", "y": -0.2})
    return figure
