"""Everything that a `StopBound` publishes, held against simulated stops: for each of its numbers a check that says by how much a
stop goes beyond it.

`CHECKED` names the fields and methods of `StopBound` with their check, `WORDS` those that are no numbers; together they are all there are
(`test_stops_published.py` walks over the class), so a new number without a check fails.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from stop_failing import failing_shares
from stop_sampling import ANGLE_ERROR, DT, SPEED_ERROR, Measured, draws
from stopset.reach.stops import Ramp, StopBound, StopBounds
from stopset.robot import Robot
from stopset.robot.rigid import gravity_torque, link_frames
from stopset.simulation.stop import StoppingArm, simulate_stop
from stopset.types import Array

LENGTH_ERROR, PACE_ERROR = 2e-6, 2e-3  # [m], [m/s] of the simulation at an arm's reach
SHOWN = 60  # instants of a stop at which its place in space is looked at
RINGING = 20.0  # [rad/s] of the tracking error


@dataclass(frozen=True)
class Stopped:
    """One stop since its request: times (T,) [s], angles and speeds (T, n); ``rests`` (n,) [s] when each joint does.

    ``held`` (n,) [N m]: what brakes and dry friction hold more than gravity and disturbance ask where it ends; ``left``: angle [rad] and
    time [s] that the STOP 0 after a left standstill window took.
    """

    t: Array
    q: Array
    v: Array
    rests: Array
    held: Array
    left: tuple[float, float] | None = None


@dataclass(frozen=True)
class Places:
    """Where the arm is at the instants looked at: tool (S, 3), ends (S, n, 3) of links, their speeds, ends of the links' own
    capsules (S, n, 2, 3) and their radii (n,)."""

    tool: Array
    tool_speed: Array
    ends: Array
    end_speed: Array
    axes: Array
    radii: Array


def places(robot: Robot, tool: Array, x: Stopped) -> Places:
    """Of `SHOWN` instants, the fastest and the last among them; the first is the request."""
    chain, n = robot.chain, robot.n
    at = np.unique(np.r_[np.linspace(0, len(x.t) - 1, SHOWN).astype(int), np.argmax(np.abs(x.v), axis=0)])
    R, o = link_frames(chain, x.q[at])
    tips = np.array([chain.p[i + 1] if i + 1 < n else robot.tip for i in range(n)])
    ends = o + np.einsum("tnij,nj->tni", R, tips)
    held = o[:, -1] + np.einsum("tij,j->ti", R[:, -1], tool)
    turning = np.einsum("tnij,nj->tni", R, chain.axis) * x.v[at][:, :, None]
    own = robot.arm.capsules
    axes = np.stack([o + np.einsum("tnij,nj->tni", R, own[:, c : c + 3]) for c in (0, 3)], axis=2)

    def speed(p: Array, last: int) -> Array:
        return np.asarray(np.cross(turning[:, : last + 1], p[:, None] - o[:, : last + 1]).sum(axis=1))

    return Places(held, speed(held, n - 1), ends, np.stack([speed(ends[:, i], i) for i in range(n)], axis=1), axes, own[:, 6])


# ---- by how much a stop goes beyond a number ----------------------------------------------------------------------------------


def _beyond_capsules(b: StopBound, p: Places) -> float:
    """[m] how far any link's capsule, both ends and the middle of its axis, sticks out of all that it is said to sweep."""
    assert b.capsules is not None
    worst = -np.inf
    for i, own in enumerate(p.radii):
        points = np.stack([p.axes[:, i, 0], p.axes[:, i].mean(axis=1), p.axes[:, i, 1]], axis=1)  # (S, 3, 3)
        begin, along = b.capsules[:, i, :3], b.capsules[:, i, 3:6] - b.capsules[:, i, :3]
        s = np.einsum("stpx,px->stp", points[:, :, None] - begin, along) / np.maximum((along**2).sum(axis=1), 1e-15)
        gap = points[:, :, None] - begin - np.clip(s, 0.0, 1.0)[..., None] * along
        out = np.linalg.norm(gap, axis=3) + own - b.capsules[:, i, 6]
        worst = max(worst, float(out.max(axis=1).min(axis=1).max()))  # all of it in one of them, at every instant
    return worst - LENGTH_ERROR


def _directions(seed: int = 1) -> Array:
    d = np.vstack([np.eye(3), -np.eye(3), np.random.default_rng(seed).normal(size=(8, 3))])
    return np.asarray(d / np.linalg.norm(d, axis=1)[:, None])


def _over(found: Array | float, said: Array | float | None, error: float) -> float:
    assert said is not None
    return float(np.max(np.asarray(found) - np.asarray(said))) - error


def _moved(p: Places) -> Array:
    return np.asarray(p.tool - p.tool[0])


def _closing(b: StopBound, p: Places) -> float:
    found = []
    for place in (*(1.5 * _directions(2)[:6]), np.array([0.4, 0.1, 0.5])):
        toward = place - p.tool
        pace = np.einsum("sx,sx->s", toward, p.tool_speed) / np.linalg.norm(toward, axis=1)
        found.append(_over(pace, b.speed_towards(place), PACE_ERROR))
    return max(found)


def _sides(b: StopBound, p: Places) -> float:
    assert b.tcp_box is not None
    return max(_over(_moved(p), b.tcp_box[:, 1], LENGTH_ERROR), _over(-_moved(p), -b.tcp_box[:, 0], LENGTH_ERROR))


def _length(x: Array) -> Array:
    return np.asarray(np.linalg.norm(x, axis=-1))


Check = Callable[[StopBound, Stopped, Places], float]
CHECKED: dict[str, Check] = {
    "time": lambda b, x, p: _over(x.rests, b.time, 2 * DT),
    "forward": lambda b, x, p: _over((x.q - x.q[0]).max(axis=0), b.forward, ANGLE_ERROR),
    "back": lambda b, x, p: _over(-(x.q - x.q[0]).min(axis=0), b.back, ANGLE_ERROR),
    "angle": lambda b, x, p: _over(np.abs(x.q - x.q[0]).max(axis=0), b.angle, ANGLE_ERROR),
    "speed": lambda b, x, p: _over(np.abs(x.v).max(axis=0), b.speed, SPEED_ERROR),
    "tcp": lambda b, x, p: _over(_length(_moved(p)), b.tcp, LENGTH_ERROR),
    "tcp_speed": lambda b, x, p: _over(_length(p.tool_speed), b.tcp_speed, PACE_ERROR),
    "tcp_box": lambda b, x, p: _sides(b, p),
    "links": lambda b, x, p: _over(_length(p.ends - p.ends[0]), b.links, LENGTH_ERROR),
    "link_speed": lambda b, x, p: _over(_length(p.end_speed), b.link_speed, PACE_ERROR),
    "holding_margin": lambda b, x, p: _over(np.zeros(1) if b.holding_margin is None else b.holding_margin, x.held, 1e-6),
    "fallback": lambda b, x, p: -1.0 if x.left is None or b.fallback is None else _over(np.array(x.left), b.fallback, 2 * DT),
    "capsules": lambda b, x, p: _beyond_capsules(b, p),
    "directed_speed": lambda b, x, p: max(
        _over(p.tool_speed @ d, b.directed_speed(d), PACE_ERROR) for d in _directions()
    ),
    "directed_distance": lambda b, x, p: max(
        _over(_moved(p) @ d, b.directed_distance(d), LENGTH_ERROR) for d in _directions()
    ),
    "speed_towards": lambda b, x, p: _closing(b, p),
}  # fmt: skip
WORDS = {"category", "certified", "why", "assumptions", "layer", "extrapolated", "end_stops", "here"}
ASKED_BY = {"motion": ("directed_speed", "directed_distance", "speed_towards")}  # a field that only these read
NOT_ALONG_A_PATH = {"capsules", "directed_speed", "directed_distance", "speed_towards"}  # not published there


def beyond(bounds: StopBounds, b: StopBound, x: Stopped, without: set[str] = frozenset()) -> set[str]:  # type: ignore[assignment]
    """Names of the numbers that the stop contradicts."""
    assert bounds.setting is not None
    p = places(bounds.model.robot, bounds.setting.payload_com, x)
    return {name for name, check in CHECKED.items() if name not in without and check(b, x, p) > 0.0}


# ---- stops of every category --------------------------------------------------------------------------------------------------


def _rested(t: Array, v: Array, band: Array | float) -> Array:
    """(n,) [s] from which on each joint stays slower than ``band``."""
    moves = np.abs(v) > band
    last = np.where(moves.any(axis=0), len(t) - 1 - np.argmax(moves[::-1], axis=0), 0)
    return np.asarray(t[last])


def _held(bounds: StopBounds, arm: StoppingArm, q: Array) -> Array:
    p = bounds.setting.plant  # type: ignore[union-attr]
    g = gravity_torque(p.chain, arm.pi, q)
    return np.asarray(arm.brake_torque + arm.fc - np.maximum(np.abs(g - p.u_lo), np.abs(g - p.u_hi)))


def _cut(arm: StoppingArm, u: Array, q: Array, v: Array, lasts: float) -> tuple[Array, Array]:
    return simulate_stop(arm, q, v, DT, int(lasts / DT) + 2, u)


def _draws(
    bounds: StopBounds, q: Array, dq: Array, radii: tuple[Array, Array], count: int, seed: int
) -> Iterator[tuple[np.random.Generator, StoppingArm, Array, Array, Array]]:
    """Arms, disturbances, and true states behind measured ones at the corners of a box ``radii`` around (q, dq)."""
    s, n = bounds.setting, len(q)
    assert s is not None
    rng = np.random.default_rng(seed)
    for k in range(count):
        corner = [r * (2.0 * rng.integers(0, 2, n) - 1.0) for r in radii]
        at = Measured(q + corner[0], dq + corner[1], s.noise.radius[:n], s.noise.radius[n:])
        arm, q0, v0, u = draws(s.plant, at, np.array([k % 5]), rng).one(0)
        yield rng, arm, u, q0, v0


def power_off(
    bounds: StopBounds, q: Array, dq: Array, radii: tuple[Array, Array], lasts: float, count: int, seed: int
) -> Iterator[Stopped]:
    """STOP 0, from every corner of the box of measured states."""
    for _, arm, u, q0, v0 in _draws(bounds, q, dq, radii, count, seed):
        qs, vs = _cut(arm, u, q0, v0, lasts)
        t = np.arange(len(qs)) * DT
        yield Stopped(t, qs, vs, _rested(t, vs, SPEED_ERROR), _held(bounds, arm, qs[-1]))


def failed_ramp(
    bounds: StopBounds, q: Array, dq: Array, radii: tuple[Array, Array], lasts: float, count: int, seed: int
) -> Iterator[Stopped]:
    """STOP 1 whose ramp fails, joint by joint, until power is taken."""
    assert bounds.ramp is not None
    for rng, arm, u, q0, v0 in _draws(bounds, q, dq, radii, count, seed):
        shares = failing_shares(bounds.ramp, v0, rng)  # a fixed deceleration takes the longer, the faster the arm truly is
        before = np.vstack([np.zeros(len(q)), np.cumsum(shares * v0 * DT, axis=0)])
        qs, vs = _cut(arm, u, q0 + before[-1], shares[-1] * v0, lasts)
        t = np.arange(len(before) - 1 + len(qs)) * DT
        v = np.vstack([shares * v0, vs])
        yield Stopped(t, np.vstack([q0 + before[:-1], qs]), v, _rested(t, v, SPEED_ERROR), _held(bounds, arm, qs[-1]))


def ramp_motion(ramp: Ramp, v0: Array, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Times, displacements and speeds of a ramp that works, its values at the ends of what is known and its errors full."""
    n = len(v0)

    def one(lo: Array, hi: Array) -> Array:
        return np.asarray(np.where(rng.integers(0, 2, n), lo, hi))

    control, value = one(ramp.control.lo, ramp.control.hi), one(ramp.value.lo, ramp.value.hi)
    lasts = value if ramp.kind == "time" else np.maximum(np.abs(v0), 1e-9) / value
    pace, settle = float(rng.choice([*ramp.pace, 0.0])), ramp.after or 0.0
    end = control + lasts
    t = np.arange(int((end.max() + settle + 0.05) / DT)) * DT
    s = np.clip((t[:, None] - control) / lasts, 0.0, 1.0)
    run = np.minimum(t[:, None], control) + lasts * (s - 0.5 * s * s)
    d, v = v0 * (run + 0.5 * pace * run * run), v0 * (1.0 - s) * (1.0 + pace * run)
    off = np.minimum(ramp.q_error, ramp.dq_error / RINGING) * rng.choice([-1.0, 1.0], n)
    until = np.minimum(t[:, None], end + 0.9 * settle)  # the error rings until the joint has settled, and stays
    d, ring = d + off * np.sin(RINGING * until), off * RINGING * np.cos(RINGING * until)
    return t, d, v + ring * (t[:, None] < end + 0.9 * settle)


def working_ramp(
    bounds: StopBounds, q: Array, dq: Array, radii: tuple[Array, Array], window: float, count: int, seed: int
) -> Iterator[Stopped]:
    """STOP 1 and 2; with a ``window`` [rad] the arm drifts to its edge, leaves it, and power is taken."""
    ramp, n = bounds.ramp, len(q)
    assert ramp is not None
    for rng, arm, u, q0, v0 in _draws(bounds, q, dq, radii, count, seed):
        t, moved, v = ramp_motion(ramp, v0, rng)
        rests, left = _rested(t, v, ramp.band), None
        if window:
            side, slow = rng.choice([-1.0, 1.0], n), 0.9 * ramp.band.min()
            steps = int(window / slow / DT)
            drift = np.linspace(0.0, window, steps)[:, None] * side
            t = np.arange(len(t) + steps) * DT
            moved, v = np.vstack([moved, moved[-1] + drift]), np.vstack([v, np.tile(side * window / steps / DT, (steps, 1))])
            rests = np.maximum(rests, _rested(t, v, ramp.band))
            crept = q0 + moved[-1] + side * ramp.creep * ramp.reaction
            # what is shed after power-off is what the drives may still give on top of creeping
            qs, vs = _cut(arm, u, crept, side * ramp.creep, 0.6)
            gone = np.arange(len(qs)) * DT
            left = float(np.abs(qs - q0 - moved[-1]).max()), float(ramp.reaction + _rested(gone, vs, SPEED_ERROR).max())
        yield Stopped(t, q0 + moved, v, rests, _held(bounds, arm, q0 + moved[-1]), left)


def weakened(b: StopBound, name: str, share: float = 0.5) -> StopBound:
    """The bound with one number a ``share`` of what it is."""
    if name == "holding_margin":
        assert b.holding_margin is not None
        return replace(b, holding_margin=b.holding_margin / share)
    if name == "angle":
        assert b.forward is not None and b.back is not None
        return replace(b, forward=share * b.forward, back=share * b.back)
    if name == "capsules":
        assert b.capsules is not None
        thin = b.capsules.copy()
        thin[:, :, 6] *= share
        return replace(b, capsules=thin)
    if name in ASKED_BY["motion"]:
        m = b.motion
        assert m is not None
        small = {
            "travel": share * m.travel,
            "travel_ball": 0 * m.travel_ball,
            "pace": share * m.pace,
            "pace_ball": 0 * m.pace_ball,
        }
        return replace(b, motion=replace(m, **small))
    value = getattr(b, name)
    return replace(b, **{name: tuple(share * x for x in value) if isinstance(value, tuple) else share * value})
