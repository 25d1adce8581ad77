"""The whole campaign: excitation, PTP slow and fast, static poses, open-loop suites, stops, and what each part tells.

Source: Liu & Althoff (2018), sec. V-B (38 random PTP motions, four start points each, 15 repetitions, up to 5 s).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from stopset.errors import StopsetError
from stopset.files import write_text
from stopset.offline.nominal.expect import expected_covariance
from stopset.offline.nominal.gram import NormalEquations, accumulate
from stopset.offline.nominal.nominal import Nominal, solve_nominal
from stopset.offline.nominal.prior import Prior, Tolerance, prior_of
from stopset.offline.nominal.unknown import told
from stopset.offline.plan.excitation import excitations
from stopset.offline.plan.motion import Envelope, Path, envelope, violations
from stopset.offline.plan.poses import APPROACH, static_poses
from stopset.offline.plan.ptp import ptp, random_goals
from stopset.recording.types import Array, Recording
from stopset.robot import Robot

FRICTION = ("coulomb", "viscous", "cubic_viscous", "load_coulomb")
HALVED = 0.25  # of the variance: a parameter's error is at least halved
STARTS = (0.1, 0.3, 0.5, 0.7)  # of a motion's duration: four start points per motion
LONGEST = 5.0  # [s] of an open-loop trial
NOISE = 0.01  # of the torque limit per filtered sample, where no data say better
SPEEDS = (33, 66, 100)  # per cent of the fast motions, for stops
PARTS = ("static", "excitation", "ptp_slow", "ptp_fast", "open_loop", "stops")


@dataclass(frozen=True, slots=True)
class Wishes:
    """What the campaign should be: counts, shares of the limits, sampling rate [Hz], seed of all random choices."""

    motions: int = 38
    repeats: int = 15
    poses: int = 60
    excitations: int = 3
    period: float = 20.0  # [s] of one excitation
    speed: float = 0.9
    torque: float = 0.7
    slow: float = 0.15  # of the fast motions' speed
    floor: float | None = None  # [m]
    rate: float = 250.0
    evaluations: int = 400
    seed: int = 0


@dataclass(frozen=True, slots=True)
class Part:
    """One kind of experiment: its motions, how often each is driven, seconds in all, and what it identifies."""

    name: str
    phase: str
    identifies: str
    motions: tuple[Path, ...]
    repeats: int
    seconds: float
    tells: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Plan:
    """A designed campaign; ``suites`` and ``stops``: rows of the schedules; ``gaps``: what today's data leave open."""

    robot: Robot
    wishes: Wishes
    parts: tuple[Part, ...]
    poses: Array
    suites: tuple[dict[str, float], ...]
    stops: tuple[dict[str, float], ...]
    condition: float
    condition_random: float
    outlook: tuple[dict[str, Any], ...]
    gaps: tuple[str, ...] | None
    warnings: tuple[str, ...]


def design(
    robot: Robot,
    wishes: Wishes,
    recordings: Iterable[Recording] | None = None,
    progress: Callable[[str], None] = lambda what: None,
) -> Plan:
    """Design all experiments for ``robot``; with ``recordings`` also what these leave undetermined.

    Raises `RobotError` for a robot without speed limits or whose torque limits cannot hold it.
    """
    _check(wishes)
    rng = np.random.default_rng(wishes.seed)
    e = envelope(robot, wishes.speed, wishes.torque, wishes.floor)
    progress("static poses")
    poses = static_poses(robot, e, wishes.poses, rng)
    progress("excitation")
    waves, condition, blind = excitations(robot, e, wishes.excitations, wishes.period, wishes.rate, wishes.evaluations, rng)
    goals = random_goals(robot, e, wishes.motions, rng)
    fast = []
    for k, (a, b) in enumerate(pairwise(goals)):
        progress(f"PTP motion {k + 1} of {len(goals) - 1}")
        fast.append(ptp(robot, e, a, b, wishes.rate))
    slow = [p.slower(1 / wishes.slow) for p in fast[: max(1, min(8, len(fast)))]]
    suites, stops = _suites(fast, wishes), _stops(robot, fast, wishes)
    parts = _parts(poses, waves, slow, fast, suites, stops, wishes)
    progress("what each part tells")
    data = None if recordings is None else accumulate(robot, recordings, FRICTION)
    nominal = None if data is None else solve_nominal(robot, data)
    parts, outlook = _outlook(robot, e, parts, poses, data, nominal)
    warnings = [f"{p.name} {k + 1}: {v}" for p in parts for k, m in enumerate(p.motions) for v in violations(robot, e, m)]
    if len(goals) - 1 < wishes.motions:
        warnings.append(f"only {len(goals) - 1} of {wishes.motions} PTP motions stay above the floor")
    if len(poses) < wishes.poses:
        warnings.append(f"only {len(poses)} of {wishes.poses} static poses can be held and stay above the floor")
    warnings.append("collisions with itself and the cell are not checked: run every motion in simulation and slowly first")
    gaps = None if nominal is None else nominal.undetermined
    return Plan(robot, wishes, parts, poses, suites, stops, condition, blind, outlook, gaps, tuple(warnings))


def _check(w: Wishes) -> None:
    for name, value, low, high in (
        ("motions", w.motions, 1, 10_000), ("repeats", w.repeats, 1, 1000), ("poses", w.poses, 1, 1500),
        ("excitations", w.excitations, 1, 50), ("speed", w.speed, 0.01, 1.0), ("torque", w.torque, 0.01, 1.0),
        ("rate", w.rate, 20, 10_000), ("period", w.period, 5, 600),
    ):  # fmt: skip
        if not low <= value <= high:
            raise StopsetError(f"--{name} is {value:g}; expected {low:g} to {high:g}: choose within")


def _suites(fast: Sequence[Path], w: Wishes) -> tuple[dict[str, float], ...]:
    """Four start points per motion; the torques are those recorded closed-loop from there to the end, at most 5 s."""
    rows: list[dict[str, float]] = []
    for m, p in enumerate(fast):
        for share in STARTS:
            start = share * p.duration
            rows.append(
                {"suite": len(rows), "motion": m, "start_s": round(start, 4), "end_s": round(min(p.duration, start + LONGEST), 4),
                 "repeats": w.repeats}
            )  # fmt: skip
    return tuple(rows)


def _stops(robot: Robot, fast: Sequence[Path], w: Wishes) -> tuple[dict[str, float], ...]:
    """For each joint the motion in which it is fastest, at three speeds, both categories, triggered at its peak."""
    rows: list[dict[str, float]] = []
    for j in range(robot.n):
        m = int(np.argmax([np.abs(p.dq[:, j]).max() for p in fast]))
        k = int(np.argmax(np.abs(fast[m].dq[:, j])))
        for percent in SPEEDS:
            for category in (0, 1):
                rows.append(
                    {"category": category, "suite": 2 * j + category, "motion": m, "joint": j, "speed_percent": percent,
                     "trigger_s": round(float(fast[m].t[k]) * 100 / percent, 4), "repeats": 3}
                )  # fmt: skip
    return tuple(rows)


def _parts(
    poses: Array, waves: Sequence[Path], slow: Sequence[Path], fast: Sequence[Path],
    suites: Sequence[dict[str, float]], stops: Sequence[dict[str, float]], w: Wishes,
) -> tuple[Part, ...]:  # fmt: skip
    def seconds(paths: Sequence[Path]) -> float:
        return sum(p.duration for p in paths)

    open_loop = sum((s["end_s"] - s["start_s"]) * s["repeats"] for s in suites)
    halting = sum((s["trigger_s"] + 1.0) * s["repeats"] for s in stops)
    return (
        Part("static", "static", "gravity; Coulomb friction of both directions from the difference", (), 1, 6.0 * 2 * len(poses)),
        Part("excitation", "closed_loop", "link inertias, rotor inertias, delay", tuple(waves), 2, 2 * seconds(waves)),
        Part("ptp_slow", "closed_loop", "Coulomb and load-dependent friction, Stribeck, hysteresis, ripple",
             tuple(slow), 1, seconds(slow)),
        Part("ptp_fast", "closed_loop", "viscous and cubic friction, rotor inertias; the torques of the open-loop suites",
             tuple(fast), 1, seconds(fast)),
        Part("open_loop", "open_loop", f"uncertainty sets X0, U, V_y ({len(suites)} suites, {len(fast)} independent motions)",
             (), w.repeats, open_loop),
        Part("stops", "stop0 stop1", "brake delay, rise and torque; sets of STOP 0 and STOP 1", (), 3, halting),
    )  # fmt: skip


def _poses_as_recordings(robot: Robot, poses: Array) -> list[Recording]:
    out = []
    t: Array = 0.004 * np.arange(4, dtype=np.float64)
    for k, q in enumerate(poses):
        for trial, way in enumerate((1.0, -1.0)):
            rows = np.tile(q, (4, 1))
            out.append(Recording("static", k, trial, 0, t, rows, 0 * rows, way * np.ones_like(rows)))
    return out


def _outlook(
    robot: Robot, e: Envelope, parts: Sequence[Part], poses: Array, data: NormalEquations | None, nominal: Nominal | None
) -> tuple[tuple[Part, ...], tuple[dict[str, Any], ...]]:
    """What each part would tell alone, and each parameter's standard error now, and after the campaign."""
    prior = prior_of(robot, Tolerance())
    guess = np.where(np.isfinite(e.tau), NOISE * e.tau, 0.5)
    sigma = guess if nominal is None else np.where(np.isfinite(nominal.rms), nominal.rms, guess)
    total = data
    out = []
    for part in parts:
        if part.name == "static":
            mine = accumulate(robot, _poses_as_recordings(robot, poses), FRICTION)
        else:
            mine = accumulate(robot, (m.recording(part.phase, k, 0, robot) for k, m in enumerate(part.motions)), FRICTION)
        if part.motions or part.name == "static":
            total = mine if total is None else total + mine
            tells = _tells(robot, mine, prior, sigma)
            part = Part(part.name, part.phase, part.identifies, part.motions, part.repeats, part.seconds, tells)
        out.append(part)
    assert total is not None
    after = expected_covariance(total, prior, sigma)
    now = None if data is None else expected_covariance(data, prior, sigma)
    return tuple(out), _parameters(robot, total, prior, now, after)


def _tells(robot: Robot, data: NormalEquations, prior: Prior, sigma: Array) -> dict[str, Any]:
    """Base parameters whose error at least halves, and the mean expected errors of rotor and friction."""
    n = robot.n
    C = expected_covariance(data, prior, sigma)
    count, of = told(robot, prior.precision, C, HALVED)
    std = np.sqrt(np.diag(C))
    names = data.layout.names()
    known = [k for k in range(n) if prior.mean[10 * n + k] > 0]
    rotor = [100 * std[10 * n + k] / prior.mean[10 * n + k] for k in known]
    return {
        "base_parameters_halved": count, "base_parameters": of,
        "rotor_std_percent": round(float(np.mean(rotor)), 3) if rotor else None,
        "F_c_std_Nm": round(float(np.mean([std[k] for k, x in enumerate(names) if x.endswith(".F_c")])), 4)
        if data.rows_moving.sum() else None,
        "F_v_std": round(float(np.mean([std[k] for k, x in enumerate(names) if x.endswith(".F_v")])), 4)
        if data.rows_moving.sum() else None,
    }  # fmt: skip


def _parameters(
    robot: Robot, total: NormalEquations, prior: Prior, now: Array | None, after: Array
) -> tuple[dict[str, Any], ...]:
    n = robot.n
    before = np.sqrt(np.diag(np.linalg.inv(prior.precision)))
    rows = []
    for k, name in enumerate(total.layout.names()):
        rows.append(
            {
                "parameter": name,
                "before": float(f"{before[k]:.4g}") if k < 11 * n else None,
                "now": None if now is None else float(f"{np.sqrt(now[k, k]):.4g}"),
                "after": float(f"{np.sqrt(after[k, k]):.4g}"),
            }
        )
    return tuple(rows)


def write_plan(plan: Plan, out: FilePath) -> list[FilePath]:
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
             "seconds": round(p.seconds, 1), "tells": p.tells}
            for p in plan.parts
        ],
        "condition": {"excitation": float(f"{plan.condition:.4g}"), "random": float(f"{plan.condition_random:.4g}")},
        "static_poses": len(plan.poses), "suites": list(plan.suites), "stops": list(plan.stops),
        "parameters": list(plan.outlook), "undetermined_today": None if plan.gaps is None else list(plan.gaps),
        "warnings": list(plan.warnings),
    }  # fmt: skip


def summary(plan: Plan) -> str:
    """The table for people (Markdown)."""
    lines = [
        f"# Experiments for {plan.robot.name}",
        "",
        "| part | motions | repeats | minutes | identifies | base parameters with half the error | rotor ± | F_c ± |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for p in plan.parts:
        t = p.tells
        count = (
            len(plan.poses)
            if p.name == "static"
            else len(plan.suites)
            if p.name == "open_loop"
            else len(plan.stops)
            if p.name == "stops"
            else len(p.motions)
        )
        base = f"{t['base_parameters_halved']} of {t['base_parameters']}" if t else "-"
        rotor = f"{t['rotor_std_percent']:.2g} %" if t and t["rotor_std_percent"] is not None else "-"
        dry = f"{t['F_c_std_Nm']:.2g} N m" if t and t["F_c_std_Nm"] is not None else "-"
        lines.append(f"| {p.name} | {count} | {p.repeats} | {p.seconds / 60:.1f} | {p.identifies} | {base} | {rotor} | {dry} |")
    minutes = sum(p.seconds for p in plan.parts) / 60
    lines += ["", f"{minutes:.0f} minutes of motion in all, moving to start points not counted. "
              f"Condition number of the excitation's regressor: {plan.condition:.1f} "
              f"(random motions: {plan.condition_random:.1f}).", ""]  # fmt: skip
    if plan.gaps is not None:
        lines += ["## What today's data leave undetermined", "", *([f"- {g}" for g in plan.gaps] or ["- nothing"]), ""]
    lines += ["## Before you run it", "", *[f"- {w}" for w in plan.warnings], "",
              f"Static poses: approach each from {APPROACH} rad below and above, all joints, then hold two seconds.",
              ""]  # fmt: skip
    return "\n".join(lines)


def _motions_csv(paths: Sequence[Path], joints: Sequence[str]) -> str:
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


def _suites_csv(suites: Sequence[dict[str, float]], fast: Sequence[Path], joints: Sequence[str]) -> str:
    rows: list[dict[str, Any]] = []
    for s in suites:
        p = fast[int(s["motion"])]
        k = min(round(s["start_s"] / float(p.t[1])), len(p.t) - 1)
        start = {f"q_{j}": f"{x:.6g}" for j, x in zip(joints, p.q[k], strict=True)}
        rows.append({**s, **start, **{f"dq_{j}": f"{x:.6g}" for j, x in zip(joints, p.dq[k], strict=True)}})
    return _table_csv(rows)


def _table_csv(rows: Sequence[dict[str, Any]]) -> str:
    return "\n".join([",".join(rows[0]), *(",".join(str(v) for v in r.values()) for r in rows)]) + "\n"
