"""Reference motions for a campaign: point to point, Fourier, straight runs before a stop, creeping into a pose."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from stopset.robot import Robot
from stopset.types import Array

HARMONICS = 5


class Trajectory(NamedTuple):
    """A reference, (K, n) each: [rad, rad/s, rad/s^2]."""

    q: Array
    dq: Array
    ddq: Array


class Space(NamedTuple):
    """Where a campaign moves: box of joint angles (n, 2) [rad], top speed (n,) [rad/s], acceleration (n,) [rad/s^2]."""

    box: Array
    speed: Array
    acceleration: Array


def space_of(robot: Robot) -> Space:
    """The middle of the joint ranges, at most 1.6 rad (shoulder and elbow 1.2) to a side, and at most 1.2 rad/s."""
    n = robot.n
    limits = np.clip(np.nan_to_num(robot.q_limit, posinf=2 * np.pi, neginf=-2 * np.pi), -2 * np.pi, 2 * np.pi)
    wide = limits[:, 1] - limits[:, 0] <= 0.0
    limits[wide] = [-np.pi, np.pi]
    centre = np.clip(0.0, limits[:, 0] + 0.2, limits[:, 1] - 0.2)
    side = np.full(n, 1.6)
    side[1:3] = 1.2
    lo = np.maximum(centre - side, limits[:, 0] + 0.1 * (limits[:, 1] - limits[:, 0]))
    hi = np.minimum(centre + side, limits[:, 1] - 0.1 * (limits[:, 1] - limits[:, 0]))
    speed = np.minimum(np.where(robot.dq_limit > 0, robot.dq_limit, 1.2), 1.2)
    return Space(np.column_stack([lo, hi]), speed, 4.0 * speed)


def pose(space: Space, rng: np.random.Generator, share: float = 1.0) -> Array:
    """(n,) a random pose in the middle ``share`` of the box."""
    middle, half = space.box.mean(axis=1), 0.5 * np.ptp(space.box, axis=1)
    return np.asarray(middle + share * half * rng.uniform(-1, 1, len(middle)))


def point_to_point(space: Space, duration: float, speed: float, period: float, rng: np.random.Generator) -> Trajectory:
    """Trapezoidal moves of all joints at their own pace between random poses; ``speed``: share of the top speed."""
    K, n = round(duration / period), len(space.speed)
    rates = np.zeros((K, n))
    q0 = pose(space, rng)
    here, k = q0.copy(), round(0.1 / period)
    while k < K:
        there, slowest = pose(space, rng), 0.75
        if speed < 0.6:  # slow moves stay near, so that a recording holds several reversals, and cover a decade of speed
            there = np.clip(here + rng.uniform(-0.5, 0.5, n), space.box[:, 0], space.box[:, 1])
            slowest = 0.15
        top = space.speed * speed * rng.uniform(slowest, 1.0, n)
        ramp = np.maximum(top / space.acceleration, 0.08)
        distance = np.abs(there - here)
        top = np.minimum(top, distance / ramp)
        length = np.where(top > 0, distance / np.maximum(top, 1e-9) + ramp, 0.0)
        t = np.arange(round((length.max() + 0.15) / period)) * period
        profile = np.clip(np.minimum(t[:, None] / ramp, (length - t[:, None]) / ramp), 0.0, 1.0)
        rows = profile[: K - k] * (top * np.sign(there - here))
        rates[k : k + len(rows)] = rows
        here = here + profile.sum(axis=0) * period * top * np.sign(there - here)
        k += len(rows)
    return _from_rates(q0, _smooth(rates, round(0.1 / period)), period)


def fourier(space: Space, duration: float, speed: float, period: float, rng: np.random.Generator) -> Trajectory:
    """A sum of five sines per joint, scaled to ``speed`` of the top speed and into the box."""
    n = len(space.speed)
    t = np.arange(round(duration / period)) * period
    base = 2 * np.pi * (0.09 if speed < 0.6 else 0.14) * rng.uniform(0.9, 1.1, n)
    w = np.outer(np.arange(1, HARMONICS + 1), base)  # (H, n)
    a = rng.normal(size=w.shape) / np.sqrt(np.arange(1, HARMONICS + 1))[:, None]
    phase = rng.uniform(0, 2 * np.pi, w.shape)
    angle = t[:, None, None] * w + phase
    q, dq, ddq = (a * np.sin(angle)).sum(1), (a * w * np.cos(angle)).sum(1), (-a * w * w * np.sin(angle)).sum(1)
    room = np.ptp(space.box, axis=1)
    scale = np.minimum(space.speed * speed / np.abs(dq).max(axis=0), 0.98 * room / np.ptp(q, axis=0))
    scale = np.minimum(scale, space.acceleration / np.abs(ddq).max(axis=0))
    lo, hi = space.box[:, 0] - scale * q.min(axis=0), space.box[:, 1] - scale * q.max(axis=0)
    return Trajectory(scale * q + rng.uniform(lo, hi), scale * dq, scale * ddq)


def from_rest(motion: Trajectory, period: float, rise: float = 0.3) -> Trajectory:
    """The same motion set off smoothly from standstill: its own time starts slowly over ``rise`` seconds."""
    K = len(motion.q)
    pace = np.clip(np.arange(K) * period / rise, 0.0, 1.0)
    pace = pace * pace * (3.0 - 2.0 * pace)
    clock = np.concatenate([[0.0], np.cumsum(0.5 * (pace[1:] + pace[:-1]))])
    rate = np.gradient(pace, period)
    q, dq, ddq = (np.column_stack([np.interp(clock, np.arange(K), c) for c in x.T]) for x in motion)
    return Trajectory(q, dq * pace[:, None], ddq * pace[:, None] ** 2 + dq * rate[:, None])


def run_up(space: Space, duration: float, period: float, rng: np.random.Generator) -> Trajectory:
    """Straight at constant speeds, as before a stop: some joints fast, some slow, some still."""
    n = len(space.speed)
    share = np.where(rng.random(n) < 0.5, rng.uniform(0.3, 1.0, n), rng.uniform(0.0, 0.45, n))
    rate = space.speed * share * rng.choice([-1.0, 1.0], n)
    t = np.arange(round(duration / period)) * period
    return Trajectory(pose(space, rng, 0.75) + np.outer(t, rate), np.tile(rate, (len(t), 1)), np.zeros((len(t), n)))


def ramp_down(motion: Trajectory, tick: int, ramp: float, hold: float, period: float) -> Trajectory:
    """``motion`` up to ``tick``, then all joints to rest in ``ramp`` seconds (fixed time), then ``hold`` seconds."""
    t = np.arange(round((ramp + hold) / period)) * period
    q0, v0 = motion.q[tick], motion.dq[tick]
    s = np.clip(t, 0.0, ramp)[:, None]
    q, dq = q0 + v0 * (s - s * s / (2 * ramp)), v0 * (1.0 - s / ramp)
    ddq = np.where(t[:, None] < ramp, -v0 / ramp, 0.0)
    return Trajectory(*(np.vstack([a[:tick], b]) for a, b in zip(motion, (q, dq, ddq), strict=True)))


def creep(target: Array, direction: Array, period: float) -> Trajectory:
    """Slowly into ``target`` from one side and stay: after it, friction holds the pose with nearly all it has.

    The reference dies away over more than the controller's own time, so the joint never swings back.
    """
    away, run, still = 0.06, 0.8, 0.06
    t = np.arange(round((run + still) / period)) * period
    x = np.clip(t / run, 0.0, 1.0)
    s, ds, dds = (1 - x) ** 3, -3 * (1 - x) ** 2 / run, 6 * (1 - x) / run**2
    displacement = -away * direction
    return Trajectory(target + np.outer(s, displacement), np.outer(ds, displacement), np.outer(dds, displacement))


def _from_rates(q0: Array, dq: Array, period: float) -> Trajectory:
    q = q0 + np.vstack([np.zeros((1, len(q0))), np.cumsum(0.5 * (dq[1:] + dq[:-1]), axis=0)]) * period
    return Trajectory(q, dq, np.gradient(dq, period, axis=0))


def _smooth(x: Array, width: int) -> Array:
    """Moving average, so that the acceleration of a trapezoid does not jump."""
    window = np.full(max(width, 1), 1.0 / max(width, 1))
    return np.column_stack([np.convolve(c, window)[: len(c)] for c in x.T])
