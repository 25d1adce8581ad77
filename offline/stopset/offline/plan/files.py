"""A plan written down: motions and schedules as CSV, everything as JSON, the table for people."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from stopset.files import write_text
from stopset.offline.plan.design import NOISE, Plan, PlanPart
from stopset.offline.plan.motion import PlannedMotion
from stopset.offline.plan.poses import APPROACH


def write_plan(plan: Plan, out: Path) -> list[Path]:
    """Write the motions as CSV, the schedules, ``plan.json`` and the table ``plan.md``; returns what was written.

    Raises `OutputError` when the folder cannot be written.
    """
    joints = plan.robot.joints
    files: dict[str, str] = {"static.csv": _static_csv(plan)}
    for part in plan.parts:
        if part.motions:
            files[f"{part.name}.csv"] = _motions_csv(part.motions, joints)
    fast = next(p for p in plan.parts if p.name == "ptp_fast").motions
    files["open_loop_suites.csv"] = _suites_csv(plan.suites, fast, joints)
    files["stops.csv"] = _table_csv([{**s, "joint": joints[int(s["joint"])]} for s in plan.stops])
    files["plan.json"] = json.dumps(as_dict(plan), indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    files["plan.md"] = summary(plan)
    for name, text in files.items():
        write_text(out / name, text)
    return [out / name for name in files]


def as_dict(plan: Plan) -> dict[str, Any]:
    """Plain data: parts, outlook, gaps, schedules."""
    return {
        "robot": plan.robot.name, "wishes": asdict(plan.wishes),
        "parts": [
            {"name": p.name, "phase": p.phase, "identifies": p.identifies, "motions": len(p.motions), "repeats": p.repeats,
             "seconds": round(p.seconds, 1), "tells": p.determines}
            for p in plan.parts
        ],
        "condition": {"excitation": float(f"{plan.condition:.4g}"), "random": float(f"{plan.condition_random:.4g}")},
        "static_poses": len(plan.poses), "suites": list(plan.suites), "stops": list(plan.stops),
        "parameters": list(plan.outlook), "undetermined_today": None if plan.gaps is None else list(plan.gaps),
        "warnings": list(plan.warnings),
    }  # fmt: skip


def count(plan: Plan, part: PlanPart) -> int:
    """How many different motions, poses, suites or stops a part has."""
    schedules = {"static": len(plan.poses), "open_loop": len(plan.suites), "stops": len(plan.stops)}
    return schedules.get(part.name, len(part.motions))


def summary(plan: Plan) -> str:
    """The table for people (Markdown)."""
    lines = [
        f"# Experiments for {plan.robot.name}",
        "",
        "| part | motions | repeats | minutes | identifies | base parameters with half the error | rotor ± | F_c ± |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for p in plan.parts:
        t = p.determines
        base = f"{t['base_parameters_halved']} of {t['base_parameters']}" if t else "-"
        rotor = f"{t['rotor_std_percent']:.2g} %" if t and t["rotor_std_percent"] is not None else "-"
        dry = f"{t['F_c_std_Nm']:.2g} N m" if t and t["F_c_std_Nm"] is not None else "-"
        lines.append(
            f"| {p.name} | {count(plan, p)} | {p.repeats} | {p.seconds / 60:.1f} | {p.identifies} | {base} | {rotor} | {dry} |"
        )
    minutes = sum(p.seconds for p in plan.parts) / 60
    lines += ["", f"{minutes:.0f} minutes of motion in all, moving to start points not counted. "
              f"Condition number of the excitation's regressor: {plan.condition:.1f} "
              f"(random motions: {plan.condition_random:.1f}).", "",
              "Expected errors are for " + ("the torque residual of today's data." if plan.gaps is not None else
              f"a torque residual of {NOISE:.0%} of each torque limit, close to a real UR10e's; with --data it is that of your arm."),
              ""]  # fmt: skip
    if plan.gaps is not None:
        lines += ["## What today's data leave undetermined", "", *([f"- {g}" for g in plan.gaps] or ["- nothing"]), ""]
    lines += ["## Before you run it", "", *[f"- {w}" for w in plan.warnings], "",
              f"Static poses: approach each from {APPROACH} rad below and above, all joints, then hold two seconds.",
              ""]  # fmt: skip
    return "\n".join(lines)


def _motions_csv(paths: Sequence[PlannedMotion], joints: Sequence[str]) -> str:
    head = "suite,trial,t," + ",".join(f"{s}_{j}" for s in ("q", "dq", "ddq") for j in joints)
    blocks = [head]
    for k, p in enumerate(paths):
        table = np.column_stack([p.t, p.q, p.dq, p.ddq])
        blocks += [f"{k},0," + ",".join(f"{x:.6g}" for x in row) for row in table]
    return "\n".join(blocks) + "\n"


def _static_csv(plan: Plan) -> str:
    joints = plan.robot.joints
    lines = ["suite,trial,step," + ",".join(f"q_{j}" for j in joints)]
    for k, q in enumerate(plan.poses):
        for trial, side in enumerate((-1, 1)):
            for step, at in (("approach", q + side * APPROACH), ("hold", q)):
                lines.append(f"{k},{trial},{step}," + ",".join(f"{x:.6g}" for x in at))
    return "\n".join(lines) + "\n"


def _suites_csv(suites: Sequence[dict[str, float]], fast: Sequence[PlannedMotion], joints: Sequence[str]) -> str:
    rows: list[dict[str, Any]] = []
    for s in suites:
        p = fast[int(s["motion"])]
        k = min(round(s["start_s"] / float(p.t[1])), len(p.t) - 1)
        start = {f"q_{j}": f"{x:.6g}" for j, x in zip(joints, p.q[k], strict=True)}
        rows.append({**s, **start, **{f"dq_{j}": f"{x:.6g}" for j, x in zip(joints, p.dq[k], strict=True)}})
    return _table_csv(rows)


def _table_csv(rows: Sequence[dict[str, Any]]) -> str:
    return "\n".join([",".join(rows[0]), *(",".join(str(v) for v in r.values()) for r in rows)]) + "\n"
