"""Try to break the bound of a failed ramp: speeds of each joint that vary as they like until power is taken, then a stop of the
nonlinear coupled arm, every half millisecond held against the bound."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from stop_sampling import ANGLE_ERROR, DT, SPEED_ERROR, Measured, draws
from stopset.reach.stops import Ramp, StopBound, StopBounds
from stopset.robot.rigid import Chain, link_frames
from stopset.simulation.stop import simulate_stop
from stopset.types import Array

CHANGES = 6  # of a failing joint's speed before power is taken
HORIZON = 0.6  # [s] simulated after power-off, at most


class Failed(NamedTuple):
    """Worst of the sampled failures: how many left the bound, and angle [rad], time [s], TCP displacement [m]."""

    stops: int
    escaped: int
    angle: Array
    time: float
    tcp: float


def failing_shares(ramp: Ramp, dq: Array, rng: np.random.Generator) -> Array:
    """(K, n) share of the request's speed of each joint, constant over each `DT` until power is taken: of the programmed motion's, which
    changes by its pace as it is run through."""
    shares = _of_the_motion(ramp, dq, rng)
    pace = rng.choice([*ramp.pace, 0.0])
    return np.asarray(shares * np.maximum(1.0 + pace * DT * np.vstack([0.0 * shares[:1], np.cumsum(shares, axis=0)[:-1]]), 0.0))


def _of_the_motion(ramp: Ramp, dq: Array, rng: np.random.Generator) -> Array:
    n, top = len(dq), ramp.share
    lasts = float(np.max(ramp.value.hi if ramp.kind == "time" else np.abs(dq) / ramp.value.lo))
    control = float(np.max(ramp.control.hi))
    if ramp.monitored:
        left = rng.choice([0.0, 1.0, rng.random()]) * (control + lasts)
        count = max(1, round((left + ramp.reaction) / DT))
    else:
        assert ramp.off_after is not None
        left = ramp.off_after
        count = max(1, int(ramp.off_after / DT))
    wild = np.where(rng.random((CHANGES, n)) < 0.5, rng.integers(0, 2, (CHANGES, n)), rng.random((CHANGES, n)))
    style = rng.integers(0, 3)
    if style == 0:  # all at the most they may, or one of them alone
        wild[:] = 1.0
        wild[:, rng.random(n) < 0.3] = 0.0
    if ramp.together:
        wild[:] = wild[:, :1]
    shares = wild[np.minimum(np.arange(count) * CHANGES // count, CHANGES - 1)]
    if not ramp.monitored:
        return np.asarray(top * shares)
    t = (np.arange(count) + 1.0) * DT  # the line at the end of each piece, where it is lowest
    line = np.minimum(top, 1.0 - np.clip((np.minimum(t, left) - control) / lasts, 0.0, 1.0) + ramp.tolerance)
    shares = shares * line[:, None]
    if top > 1.0:
        shares[t > left] = top * wild[-1]
    return np.asarray(shares)


def sample_failed_ramps(bounds: StopBounds, bound: StopBound, q: Array, dq: Array, count: int, seed: int) -> Failed:
    """Simulate ``count`` failures from the measured state (q, dq) and hold each against ``bound``."""
    s, ramp = bounds.setting, bounds.ramp
    assert s is not None and ramp is not None and bound.forward is not None and bound.back is not None
    assert bound.time is not None and bound.speed is not None and bound.tcp is not None and bound.tcp_box is not None
    rng = np.random.default_rng(seed)
    n, plant, chain = len(q), s.plant, s.plant.chain
    stops = draws(plant, Measured(q, dq, s.noise.radius[:n], s.noise.radius[n:]), np.arange(count) % 5, rng)
    angle, time, tcp, escaped = np.zeros(n), 0.0, 0.0, 0
    steps = int(np.ceil(min(HORIZON, float(bound.time.max())) / DT)) + 2
    for k in range(count):
        arm, q0, v0, u = stops.one(k)
        shares = failing_shares(ramp, dq, rng)
        before = np.vstack([np.zeros(n), np.cumsum(shares * v0 * DT, axis=0)])
        qs, vs = simulate_stop(arm, q0 + before[-1], shares[-1] * v0, DT, steps, u)
        d = np.vstack([before, qs - q0])
        v = np.vstack([shares * v0, vs])
        moving = np.any(np.abs(vs) > SPEED_ERROR, axis=1)
        ended = len(shares) * DT + (DT * (len(moving) - 1 - int(np.argmax(moving[::-1]))) if moving.any() else 0.0)
        R0, o0 = link_frames(chain, q0)
        p0 = o0[-1] + R0[-1] @ s.payload_com
        travel = np.array([_tool(chain, q0 + row, s.payload_com) for row in d[:: max(1, len(d) // 40)]]) - p0
        far = float(np.linalg.norm(travel, axis=1).max())
        angle, time, tcp = np.maximum(angle, np.abs(d).max(axis=0)), max(time, ended), max(tcp, far)
        inside = (
            np.all(d.max(axis=0) <= bound.forward + ANGLE_ERROR)
            and np.all(-d.min(axis=0) <= bound.back + ANGLE_ERROR)
            and np.all(np.abs(v).max(axis=0) <= bound.speed + SPEED_ERROR)
            and ended <= float(bound.time.max()) + DT
            and far <= bound.tcp + 1e-6
            and np.all(travel <= bound.tcp_box[:, 1] + 1e-6)
            and np.all(travel >= bound.tcp_box[:, 0] - 1e-6)
        )
        escaped += not inside
    return Failed(count, escaped, angle, time, tcp)


def _tool(chain: Chain, q: Array, tool: Array) -> Array:
    R, o = link_frames(chain, q)
    return np.asarray(o[-1] + R[-1] @ tool)
