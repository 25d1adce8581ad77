"""The whole campaign: excitation, PTP slow and fast, static poses, open-loop suites, stops, and what each part tells.

Source: Liu & Althoff (2018), sec. V-B (38 random PTP motions, four start points each, 15 repetitions, up to 5 s).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from stopset.effects.selection import usual_friction
from stopset.errors import StopsetError
from stopset.offline.nominal.expect import expected_covariance
from stopset.offline.nominal.nominal import Nominal, solve_nominal
from stopset.offline.nominal.normal_equations import NormalEquations, accumulate
from stopset.offline.nominal.prior import Prior, prior_of
from stopset.offline.nominal.unidentifiable import determined
from stopset.offline.plan.excitation import Series, excitations
from stopset.offline.plan.motion import MotionLimits, PlannedMotion, envelope, violations
from stopset.offline.plan.poses import static_poses
from stopset.offline.plan.ptp import ptp, random_goals
from stopset.progress import Progress, silent
from stopset.recording.types import Recording
from stopset.robot import Robot
from stopset.types import Array

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
class PlanPart:
    """One kind of experiment: its motions, how often each is driven, seconds in all, and what it identifies."""

    name: str
    phase: str
    identifies: str
    motions: tuple[PlannedMotion, ...]
    repeats: int
    seconds: float
    determines: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Plan:
    """A designed campaign; ``suites`` and ``stops``: rows of the schedules; ``gaps``: what today's data leave open."""

    robot: Robot
    wishes: Wishes
    parts: tuple[PlanPart, ...]
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
    progress: Progress = silent,
) -> Plan:
    """Design all experiments for ``robot``; with ``recordings`` also what these leave undetermined; ``progress`` is given each step.

    Raises `RobotError` for a robot without speed limits or whose torque limits cannot hold it.
    """
    _check(wishes)
    rng = np.random.default_rng(wishes.seed)
    data = None if recordings is None else accumulate(robot, recordings, usual_friction())
    e = envelope(robot, wishes.speed, wishes.torque, wishes.floor)
    progress("static poses")
    poses = static_poses(robot, e, wishes.poses, rng)
    progress("excitation")
    waves, condition, blind = excitations(
        robot, e, Series(wishes.excitations, wishes.period, wishes.rate, wishes.evaluations), rng, progress
    )
    goals = random_goals(robot, e, wishes.motions, rng)
    fast = []
    for k, (a, b) in enumerate(pairwise(goals)):
        progress(f"PTP motion {k + 1} of {len(goals) - 1}", k / (len(goals) - 1))
        fast.append(ptp(robot, e, a, b, wishes.rate))
    slow = [p.slower(1 / wishes.slow) for p in fast[: max(1, min(8, len(fast)))]]
    suites, stops = _suites(fast, wishes), _stops(robot, fast, wishes)
    parts = _parts(poses, waves, slow, fast, suites, stops, wishes)
    progress("what each part tells")
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


def _suites(fast: Sequence[PlannedMotion], w: Wishes) -> tuple[dict[str, float], ...]:
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


def _stops(robot: Robot, fast: Sequence[PlannedMotion], w: Wishes) -> tuple[dict[str, float], ...]:
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
    poses: Array, waves: Sequence[PlannedMotion], slow: Sequence[PlannedMotion], fast: Sequence[PlannedMotion],
    suites: Sequence[dict[str, float]], stops: Sequence[dict[str, float]], w: Wishes,
) -> tuple[PlanPart, ...]:  # fmt: skip
    def seconds(paths: Sequence[PlannedMotion]) -> float:
        return sum(p.duration for p in paths)

    open_loop = sum((s["end_s"] - s["start_s"]) * s["repeats"] for s in suites)
    halting = sum((s["trigger_s"] + 1.0) * s["repeats"] for s in stops)
    return (
        PlanPart("static", "static", "gravity; Coulomb friction of both directions from the difference", (), 1, 6.0 * 2 * len(poses)),
        PlanPart("excitation", "closed_loop", "link inertias, rotor inertias, delay", tuple(waves), 2, 2 * seconds(waves)),
        PlanPart("ptp_slow", "closed_loop", "Coulomb and load-dependent friction, Stribeck, hysteresis, ripple",
             tuple(slow), 1, seconds(slow)),
        PlanPart("ptp_fast", "closed_loop", "viscous and cubic friction, rotor inertias; the torques of the open-loop suites",
             tuple(fast), 1, seconds(fast)),
        PlanPart("open_loop", "open_loop", f"uncertainty sets X0, U, V_y ({len(suites)} suites, {len(fast)} independent motions)",
             (), w.repeats, open_loop),
        PlanPart("stops", "stop0 stop1", "brake delay, rise and torque; sets of STOP 0 and STOP 1", (), 3, halting),
    )  # fmt: skip


def _poses_as_recordings(robot: Robot, poses: Array) -> list[Recording]:
    out = []
    t: Array = 0.004 * np.arange(4, dtype=np.float64)
    for k, q in enumerate(poses):
        for trial, direction in enumerate((1.0, -1.0)):
            rows = np.tile(q, (4, 1))
            out.append(Recording("static", k, trial, 0, t, rows, 0 * rows, direction * np.ones_like(rows)))
    return out


def _outlook(
    robot: Robot, e: MotionLimits, parts: Sequence[PlanPart], poses: Array, data: NormalEquations | None, nominal: Nominal | None
) -> tuple[tuple[PlanPart, ...], tuple[dict[str, Any], ...]]:
    """What each part would tell alone, and each parameter's standard error now, and after the campaign."""
    prior = prior_of(robot)
    guess = np.where(np.isfinite(e.tau), NOISE * e.tau, 0.5)
    sigma = guess if nominal is None else np.where(np.isfinite(nominal.rms), nominal.rms, guess)
    total = data
    out = []
    for part in parts:
        if part.name == "static":
            mine = accumulate(robot, _poses_as_recordings(robot, poses), usual_friction())
        else:
            mine = accumulate(robot, (m.recording(part.phase, k, 0, robot) for k, m in enumerate(part.motions)), usual_friction())
        if part.motions or part.name == "static":
            total = mine if total is None else total + mine
            determines = _determines(robot, mine, prior, sigma)
            part = PlanPart(part.name, part.phase, part.identifies, part.motions, part.repeats, part.seconds, determines)
        out.append(part)
    assert total is not None
    after = expected_covariance(total, prior, sigma)
    now = None if data is None else expected_covariance(data, prior, sigma)
    return tuple(out), _parameters(robot, total, prior, now, after)


def _determines(robot: Robot, data: NormalEquations, prior: Prior, sigma: Array) -> dict[str, Any]:
    """Base parameters whose error at least halves, and the mean expected errors of rotor and friction."""
    n = robot.n
    C = expected_covariance(data, prior, sigma)
    count, of = determined(robot, prior.precision, C, HALVED)
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
    for k, (name, unit) in enumerate(zip(total.layout.names(), total.layout.units(), strict=True)):
        rows.append(
            {
                "parameter": name,
                "unit": unit,
                "before": float(f"{before[k]:.4g}") if k < 11 * n else None,
                "now": None if now is None else float(f"{np.sqrt(now[k, k]):.4g}"),
                "after": float(f"{np.sqrt(after[k, k]):.4g}"),
            }
        )
    return tuple(rows)
