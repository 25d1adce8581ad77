"""One pass over recordings: what they offer, what is missing for identification, what is wrong."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from stopset.effects.selection import usual_friction
from stopset.errors import RecordingError
from stopset.offline.campaign.independence import Ends, independent_motions
from stopset.offline.inspect import findings_torque
from stopset.offline.inspect.contradiction import MOST_TRIALS, contradictions, of_trials, sums_of
from stopset.offline.inspect.finding import Finding
from stopset.offline.inspect.findings_clock import clock, held, polled
from stopset.offline.inspect.findings_signals import readings, saturation, unrepeated, velocity
from stopset.offline.inspect.inertia import Momentum
from stopset.offline.inspect.jolts import Jolt, found, jolts
from stopset.offline.inspect.mounting import mounting
from stopset.offline.inspect.needs import Inventory, Need, needs
from stopset.offline.inspect.order import exchanged
from stopset.offline.inspect.tally import MOVING, SignalSums
from stopset.offline.inspect.units import UnitSample, degrees
from stopset.offline.nominal import low_pass
from stopset.offline.nominal.delay import estimate_delay
from stopset.offline.nominal.nominal import solve_nominal
from stopset.offline.nominal.normal_equations import NormalEquations, accumulate
from stopset.offline.nominal.prior import prior_of
from stopset.offline.nominal.scale import rubbing, torque_scales
from stopset.progress import Progress, counted, silent
from stopset.recording import Recording, SuiteKey, read_meta, stream_recordings
from stopset.recording.repetition import POWERED
from stopset.recording.types import Meta
from stopset.robot import Robot
from stopset.types import Array


@dataclass(frozen=True, slots=True)
class Inspection:
    """The answer about one file: ``offers`` (plain data), ``missing`` for identification, ``findings``.

    ``refused``: the reader's sentence when the file's content cannot be taken at all.
    """

    path: str
    offers: dict[str, Any]
    missing: tuple[Need, ...]
    findings: tuple[Finding, ...]
    refused: str | None = None

    @property
    def wrong(self) -> bool:
        """Whether something is wrong that identification should not be run over."""
        return self.refused is not None or any(f.severity == "error" for f in self.findings)

    def as_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return {
            "file": self.path,
            **self.offers,
            "missing": [{"part": m.part, "lacking": m.lacking, "do": m.do} for m in self.missing],
            "findings": [
                {"kind": f.kind, "severity": f.severity, "joint": f.joint, "seen": f.seen, "expected": f.expected, "do": f.do,
                 "value": f.value if f.value is None or np.isfinite(f.value) else None}
                for f in self.findings
            ],
            "refused": self.refused,
            "usable": not self.wrong,
        }  # fmt: skip


@dataclass(slots=True)
class _Campaign:
    """Counts by phase, kept while the trials stream by."""

    tally: SignalSums
    momentum: Momentum | None = None  # of compensated torque, where the robot is known
    trials: dict[str, int] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    suites: dict[SuiteKey, int] = field(default_factory=dict)  # trials of each
    torques: dict[SuiteKey, Array] = field(default_factory=dict)  # of one trial of each suite under power
    ends: dict[SuiteKey, Ends] = field(default_factory=dict)  # of these suites
    slowest: np.ndarray = field(default_factory=lambda: np.zeros(0))  # (n,) lowest speed in motion that lasted
    channels: set[str] = field(default_factory=set)
    sample: UnitSample = field(default_factory=UnitSample)
    seen: dict[bytes, str] = field(default_factory=dict)  # labels of moving trials by fingerprint
    jolts: list[Jolt] = field(default_factory=list)
    robot: Robot | None = None  # of motor torque, where it is known
    by_trial: dict[str, NormalEquations] = field(default_factory=dict)  # what long trials say, each by itself
    heard: list[Recording] = field(default_factory=list)  # the first moving trials, of about a minute together

    def add(self, r: Recording) -> None:
        if r.phase != "static" and sum(float(x.t[-1] - x.t[0]) for x in self.heard) < low_pass.SECONDS:
            self.heard.append(r)
        if r.phase != "static" and np.ptp(r.q) > 0.0:
            self.seen[r.fingerprint] = r.label
        self.tally.add(r)
        self.sample.add(r)
        self.jolts += jolts(r)
        if self.momentum is not None:
            self.momentum.add(r)
        self.trials[r.phase] = self.trials.get(r.phase, 0) + 1
        self.seconds[r.phase] = self.seconds.get(r.phase, 0.0) + float(r.t[-1] - r.t[0])
        if self.robot is not None and len(self.by_trial) < MOST_TRIALS and (data := sums_of(self.robot, r)) is not None:
            self.by_trial[r.label] = data
        if r.phase in POWERED and len(r.t) >= 3:
            ends = Ends.of(r)
            self.torques.setdefault(r.suite_key, r.tau)
            self.ends[r.suite_key] = self.ends[r.suite_key].until(ends) if r.suite_key in self.ends else ends
        self.suites[r.suite_key] = self.suites.get(r.suite_key, 0) + 1
        for name in ("temp", "current", "q_link", "stop_trigger"):
            if getattr(r, name) is not None:
                self.channels.add(name)
        if r.phase != "static":
            speed = np.where(np.abs(r.dq) > MOVING, np.abs(r.dq), np.nan)
            counted = np.isfinite(speed).sum(axis=0) > 20
            low = np.array([np.nanpercentile(speed[:, j], 10) if counted[j] else np.inf for j in range(speed.shape[1])])
            self.slowest = np.minimum(self.slowest, low) if len(self.slowest) else low

    def watch(self, stream: Iterator[Recording]) -> Iterator[Recording]:
        for r in stream:
            self.add(r)
            yield r

    def phases(self) -> dict[str, dict[str, Any]]:
        """By phase; what moves under power in motions that are independent, as `identify` counts them, whatever their suites are."""
        out: dict[str, dict[str, Any]] = {}
        for phase, trials in self.trials.items():
            mine = [count for (_, p, *_), count in self.suites.items() if p == phase]
            torques = {s: x for s, x in self.torques.items() if s[1] == phase}
            motions = len(set(independent_motions(torques, self.ends).values())) if torques else len(mine)
            out[phase] = {
                "trials": trials, "motions": motions, "most_trials_per_motion": max(mine),
                "seconds": round(self.seconds[phase], 3),
            }  # fmt: skip
        return out


def inspect_recordings(paths: Sequence[str | Path], robot: Robot | None = None, progress: Progress = silent) -> list[Inspection]:
    """Inspect each file; with ``robot`` torque is also held against its rigid-body model (unit, sign, delay).

    ``progress`` is given every trial that is read, and what is asked of them.

    Raises `RecordingError` for files that are no recordings at all; content that the reader refuses becomes ``refused``.
    """
    found = [_inspect(Path(p), robot, progress) for p in paths]
    names = [Path(p).name for p in paths]
    more = _copies(names, [trials for _, trials, _ in found])
    if robot is not None:
        progress("what the recordings say of the arm, held against each other")
        disagree = contradictions(robot, names, [None if i.wrong else data for i, _, data in found])
        more = [[*a, *b] for a, b in zip(more, disagree, strict=True)]
    return [replace(i, findings=(*i.findings, *extra)) for (i, _, _), extra in zip(found, more, strict=True)]


def _copies(names: Sequence[str], files: Sequence[dict[bytes, str]]) -> list[list[Finding]]:
    """Per file, its trials that an earlier one holds, number for number; ``files``: labels of their moving trials by fingerprint."""
    out: list[list[Finding]] = [[] for _ in names]
    for k, trials in enumerate(files):
        for name, earlier in zip(names[:k], files[:k], strict=False):
            same = [label for numbers, label in trials.items() if numbers in earlier]
            if same:
                more = f" and {len(same) - 1} more" if len(same) > 1 else ""
                out[k].append(Finding(
                    "copy", "error", None, f"{same[0]}{more} are in {name}, too, number for number", "each motion once",
                    "leave one out: a motion that is counted twice would vouch for itself", float(len(same)),
                ))  # fmt: skip
    return out


def _inspect(path: Path, robot: Robot | None, progress: Progress) -> tuple[Inspection, dict[bytes, str], NormalEquations | None]:
    meta = read_meta(path)
    joints = robot.joints if robot is not None else meta.joints
    compensated = meta.effort == "compensated_torque"
    campaign = _Campaign(SignalSums(len(joints)), Momentum(robot) if robot is not None and compensated else None)
    campaign.robot = None if compensated else robot
    data: NormalEquations | None = None
    refused = None
    try:
        stream = campaign.watch(counted(stream_recordings(path, robot), None, f"{path.name}: trials read", progress))
        if robot is not None:
            data = accumulate(robot, stream, usual_friction(), compensated=compensated)
        else:
            for _ in stream:
                pass
    except RecordingError as e:
        refused = " ".join(str(e).split())
    progress(f"{path.name}: signals, stamps and torque")
    found = _findings(campaign, joints, meta, robot, data)
    # of a file that breaks off before its first trial nothing is known, what it lacks neither
    phases = campaign.phases()
    missing = () if refused and not campaign.trials else tuple(_missing(campaign, phases, meta, robot))
    return Inspection(str(path), _offers(campaign, phases, meta, joints), missing, tuple(found), refused), campaign.seen, data


def _findings(
    campaign: _Campaign, joints: Sequence[str], meta: Meta, robot: Robot | None, data: NormalEquations | None
) -> list[Finding]:
    t = campaign.tally
    speeds = velocity(t, joints, meta)
    stamps = clock(t, meta, dq_sound=all(f.kind in ("velocity_derived", "clock_scale", "dq_scale") for f in speeds))
    if any(f.kind == "dropped_samples" for f in stamps):  # stamps made up for fewer samples run slow by that alone
        speeds = [f for f in speeds if f.kind != "clock_scale"]
    out = [*stamps, *speeds, *readings(t, joints), *saturation(t, joints, meta)]
    if t.trials == 0:
        return out
    out += [*unrepeated(campaign.suites), *findings_torque.spikes(t.spikes, joints), *polled(*t.polled), *held(t.held)]
    if not any(f.severity == "error" for f in out):  # stamps and readings that are wrong tear speeds apart
        out += [*found(campaign.jolts, joints), *findings_torque.torque_peaks(t.peaks, joints)]
    sign = findings_torque.torque_sign(t, joints, compensated=meta.effort == "compensated_torque")
    if robot is not None:
        out += findings_torque.torque_limits(t, joints, robot.torque_limit)
    if robot is None or data is None:
        out += sign
    elif in_degrees := degrees(campaign.sample, robot) if meta.effort != "compensated_torque" else []:
        return out + in_degrees  # nothing else that rests on positions can be told
    else:
        # made-up stamps tear accelerations apart: what rests on them would be one more wrong claim
        torn = any(f.severity == "error" for f in stamps)
        if not torn and meta.effort != "compensated_torque" and (order := exchanged(robot, campaign.heard)) is not None:
            names = [joints[k] for k in order.joints]
            return out + findings_torque.misplaced(names, order.better, motion=order.motion)  # nothing else can be said of torque
        scales = torque_scales(robot, data) if campaign.momentum is None else campaign.momentum.scales()
        hangs = None if torn or sign or meta.effort == "compensated_torque" else mounting(robot, campaign.heard)
        if hangs is not None:  # whatever else the rigid body would say rests on gravity
            out += findings_torque.mounted(hangs.gravity, hangs.angle, robot.chain.gravity)
        else:
            out += _torque(robot, data, (*scales, t.turns), meta, sign, torn=torn)
        if robot is campaign.robot and not torn and not any(f.severity == "error" for f in out):
            out += of_trials(robot, campaign.by_trial)
        if meta.effort != "compensated_torque" and not torn:
            out += findings_torque.torque_smoothed(low_pass.recorded_low_pass(robot, campaign.heard))
    return out + [Finding("metadata", "note", None, w, "metadata in the file", "add them") for w in meta.warnings]


def _torque(
    robot: Robot, data: NormalEquations, seen: tuple[Array, Array, Array], meta: Meta, sign: list[Finding], *, torn: bool
) -> list[Finding]:
    """Torque held against the robot's own model: sign and unit, and where these are right, the delay; ``seen``: see `against_model`."""
    compensated = meta.effort == "compensated_torque"
    right = findings_torque.RIGHT_TORN if torn or compensated else findings_torque.RIGHT
    against = against_model(robot, meta, right, *seen)
    blamed = {f.joint for f in against}
    out = [*against, *(f for f in sign if f.joint not in blamed)]
    if torn or any(f.severity == "error" for f in against) or (sign and compensated):
        return out
    delay = estimate_delay(data, prior_of(robot))
    if (
        delay.beyond and not compensated
    ):  # torque that belongs to another moment seems turned, and what else is said of it is none of it
        return findings_torque.torque_beyond(delay.beyond)
    out += [] if compensated else findings_torque.pushed(rubbing(robot, data), robot.joints)
    if out:
        return out
    least = findings_torque.DELAY_COMPENSATED if compensated else findings_torque.DELAY
    off = 1.0 if compensated or not data.rows_moving.any() else solve_nominal(robot, data).off
    return findings_torque.description(off) + findings_torque.torque_delay(
        delay.common, delay.common_std, delay.joint, delay.std, delay.hold * 2, robot.joints, least
    )


def against_model(
    robot: Robot, meta: Meta, right: tuple[float, float], scale: Array, std: Array, turns: Array | None = None
) -> list[Finding]:
    """Torque that is by a unit or a sign apart from what the robot needs: ``scale`` (n,) measured over modelled, ``std`` its error,
    ``turns``: what torque does where joints turn round, as `SignalSums` counts it.

    ``right``: between which scales all may be payload, drive gain and errors of the description.
    """
    gear = np.array([d.gear_ratio for d in robot.drives])
    by = dict(zip(meta.joints, meta.torque_constant, strict=True)) if meta.torque_constant is not None else {}
    constant = np.array([by.get(j, np.nan) for j in robot.joints])
    if shares := findings_torque.torque_shares(scale, std, robot.joints, robot.torque_limit):
        return shares
    found = findings_torque.torque_scale(scale, std, robot.joints, gear, constant, right)
    rises = (
        {j for j, sure in zip(robot.joints, findings_torque.rises(turns), strict=True) if sure} if turns is not None else set()
    )
    return [findings_torque.balanced(f) if f.kind == "wrong_sign" and f.joint in rises else f for f in found]


def _missing(campaign: _Campaign, phases: dict[str, dict[str, Any]], meta: Meta, robot: Robot | None) -> list[Need]:
    paired = sum(1 for (_, phase, *_), count in campaign.suites.items() if phase == "static" and count >= 2)
    top = np.abs(campaign.tally.range_dq).max(axis=1)
    n = campaign.tally.n
    low = campaign.slowest if len(campaign.slowest) == n else np.full(n, np.inf)
    repeats = max((c for (_, p, *_), c in campaign.suites.items() if p == "open_loop"), default=0)
    motions = phases["open_loop"]["motions"] if "open_loop" in phases else 0
    limit = robot.dq_limit if robot is not None and np.isfinite(robot.dq_limit).all() else None
    return needs(Inventory(
        phases=phases, paired_poses=paired, speed=np.column_stack([low, top]), limit=limit,
        temperature="temp" in campaign.channels, effort=meta.effort, repeats=repeats, motions=motions,
    ))  # fmt: skip


def _offers(campaign: _Campaign, phases: dict[str, dict[str, Any]], meta: Meta, joints: Sequence[str]) -> dict[str, Any]:
    t = campaign.tally

    def pair(x: np.ndarray) -> list[float] | None:
        return [float(f"{v:.6g}") for v in x] if np.isfinite(x).all() else None

    def number(x: float) -> float | None:
        return float(f"{x:.6g}") if np.isfinite(x) else None

    ranges = {
        joint: {
            "q": pair(t.range_q[j]), "dq": pair(t.range_dq[j]), "ddq_max": number(t.acceleration[j]), "tau": pair(t.range_tau[j]),
            "temp": pair(t.range_temp[j]), "resolution_q": number(t.resolution[j]),
        }
        for j, joint in enumerate(joints)
    }  # fmt: skip
    period = float(np.median(t.period)) if t.period else float("nan")
    return {
        "robot": meta.robot, "effort": meta.effort, "velocity": meta.velocity, "clock": meta.clock,
        "rate_hz": number(1 / period) if period > 0 else None, "jitter": number(max(t.jitter, default=float("nan"))),
        "trials": t.trials, "samples": t.samples, "seconds": round(t.seconds, 3), "phases": phases,
        "channels": ["q", "dq", "tau", *sorted(campaign.channels)], "joints": ranges, "said": list(meta.said),
    }  # fmt: skip
