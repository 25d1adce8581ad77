"""Planned motions: sampled joint trajectories, and the checks every one of them passes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stopset.errors import RobotError
from stopset.recording.types import Recording
from stopset.robot import Robot
from stopset.robot.rigid import link_frames, torques
from stopset.types import Array


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """What planned motions stay within: ``q`` (n, 2) [rad], ``dq, tau`` (n,) [rad/s, N m]; ``floor`` [m]: no link origin
    nor the flange below this height, if given; ``friction`` (n,) [N m]: what friction may take of the torque."""

    q: Array
    dq: Array
    tau: Array
    friction: Array
    floor: float | None = None


@dataclass(frozen=True, slots=True)
class PlannedMotion:
    """A sampled motion: ``t`` (N,), ``q, dq, ddq`` (N, n)."""

    t: Array
    q: Array
    dq: Array
    ddq: Array

    @property
    def duration(self) -> float:
        return float(self.t[-1])

    def slower(self, factor: float) -> PlannedMotion:
        """The same way ``factor`` times slower, at the same sampling rate."""
        h = float(self.t[1])
        t = np.arange(0.0, self.duration * factor + 0.5 * h, h)
        old = self.t * factor

        def at(x: Array) -> Array:
            return np.column_stack([np.interp(t, old, c) for c in x.T])

        return PlannedMotion(t, at(self.q), at(self.dq) / factor, at(self.ddq) / factor**2)

    def recording(self, phase: str, suite: int, trial: int, robot: Robot) -> Recording:
        """As if it had been driven, torque from the rigid body: for asking what it would tell."""
        tau = torques(robot.chain, robot.pi, self.q, self.dq, self.ddq) + robot.rotor * self.ddq
        return Recording(phase, suite, trial, 0, self.t, self.q, self.dq, tau)


def envelope(robot: Robot, speed: float, torque: float, floor: float | None, margin: float = 0.05) -> MotionLimits:
    """Shares ``speed``, ``torque`` (0 to 1) of the robot's limits; joints without limits: one turn, and named as needed.

    Raises `RobotError` when the robot states no speed limit: none is invented.
    """
    if not np.isfinite(robot.dq_limit).all() or not (robot.dq_limit > 0).all():
        lacking = [j for j, v in zip(robot.joints, robot.dq_limit, strict=True) if not (np.isfinite(v) and v > 0)]
        raise RobotError(
            f"no speed limit for joint {', '.join(lacking)}; expected <limit velocity=...> in the URDF: experiments are not "
            "designed without one"
        )
    q = np.clip(np.where(np.isfinite(robot.q_limit), robot.q_limit, [-np.pi, np.pi]), -np.pi, np.pi)
    middle, half = q.mean(axis=1), 0.5 * (q[:, 1] - q[:, 0]) * (1 - margin)
    tau = np.where(np.isfinite(robot.torque_limit) & (robot.torque_limit > 0), robot.torque_limit, np.inf)
    # gears of this kind lose about a tenth of their rating to friction; measured friction replaces this guess
    friction = np.where(np.isfinite(tau), 0.15 * tau, 0.0)
    return MotionLimits(np.column_stack([middle - half, middle + half]), speed * robot.dq_limit, torque * tau, friction, floor)


def heights(robot: Robot, q: Array) -> Array:
    """(N,) lowest of the link origins (from the second on) and the flange [m], at rows of ``q`` (N, n)."""
    out = np.empty(len(q))
    for k, x in enumerate(q):
        R, o = link_frames(robot.chain, x)
        out[k] = min(float(o[1:, 2].min(initial=np.inf)), float((o[-1] + R[-1] @ robot.tip)[2]))
    return out


def torque_share(robot: Robot, e: MotionLimits, p: PlannedMotion) -> float:
    """Largest torque over what is allowed, friction included; 0 where no limit is known."""
    tau = np.abs(torques(robot.chain, robot.pi, p.q, p.dq, p.ddq) + robot.rotor * p.ddq) + e.friction
    return float((tau / e.tau).max())


def violations(robot: Robot, e: MotionLimits, p: PlannedMotion) -> list[str]:
    """Sentences for every limit the sampled motion leaves; empty when it is fine."""
    out = []
    if (p.q < e.q[:, 0] - 1e-9).any() or (p.q > e.q[:, 1] + 1e-9).any():
        out.append("leaves the position range")
    if (np.abs(p.dq) > e.dq * (1 + 1e-6)).any():
        out.append(f"speed {float((np.abs(p.dq) / e.dq).max()):.3f} of the allowed")
    share = torque_share(robot, e, p)
    if share > 1 + 1e-6:
        out.append(f"torque {share:.3f} of the allowed")
    if e.floor is not None and float(heights(robot, p.q[:: max(1, len(p.q) // 200)]).min()) < e.floor:
        out.append("goes below the floor")
    return out


def fitted(robot: Robot, e: MotionLimits, p: PlannedMotion) -> PlannedMotion:
    """The motion slowed down until speed and torque are inside; gravity alone too large raises `RobotError`."""
    speed = float((np.abs(p.dq) / e.dq).max())
    if speed > 1:
        p = p.slower(speed * 1.0001)
    for _ in range(40):
        if torque_share(robot, e, p) <= 1:
            return p
        p = p.slower(1.1)
    still = replace(p, dq=np.zeros_like(p.dq), ddq=np.zeros_like(p.ddq))
    raise RobotError(
        f"holding the arm takes {torque_share(robot, e, still):.2f} of the allowed torque, friction included; expected less "
        "than 1: correct the torque limits or allow a larger share (--torque)"
    )
